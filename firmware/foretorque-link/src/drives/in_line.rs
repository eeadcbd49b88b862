//! Board in line between a host and its drives: passes every frame and adds a torque to the motion commands of its drives.
//!
//! Only the torque field of a motion command changes, and only while a torque is set that is younger than the time-out.
//! Otherwise, and for every other frame, the bytes that leave are the bytes that came. The torque field is that of MIT,
//! CyberGear, RobStride, ODrive and moteus, there where the host sends one. Commands of CiA 402 pass unchanged.

mod bridge;

pub use bridge::{Bridge, Port};

use super::frame::carried;
use super::{DriveProfile, Frame, JointCommand, Protocol, Request, cybergear, mit, moteus, odrive};

/// Torque added to the commands that pass, one per joint.
#[derive(Clone, Debug)]
pub struct InLine<const N: usize> {
    profiles: [Option<DriveProfile>; N],
    timeout: u32,
    /// Torques to add, N·m at the joint; `None` passes all frames unchanged.
    torques: Option<[f32; N]>,
    set_at: u32,
    /// Rounding errors of the added torques, in steps of their fields.
    carry: [f32; N],
    altered: u32,
}

impl<const N: usize> InLine<N> {
    /// Passes all frames unchanged until a torque is set. A torque is added for at most `timeout`, in counts of the clock
    /// that gives `now` elsewhere: free running, 32 bits.
    pub const fn new(profiles: [Option<DriveProfile>; N], timeout: u32) -> Self {
        Self {
            profiles,
            timeout,
            torques: None,
            set_at: 0,
            carry: [0.0; N],
            altered: 0,
        }
    }

    /// Sets the torques to add, N·m at the joints. A value that is not finite passes all frames unchanged.
    pub fn set(&mut self, torques: &[f32; N], now: u32) {
        let finite = torques.iter().all(|torque| torque.is_finite());
        self.torques = finite.then_some(*torques);
        self.set_at = now;
    }

    /// Passes all frames unchanged until the next [`Self::set`].
    pub fn clear(&mut self) {
        self.torques = None;
        self.carry = [0.0; N];
    }

    /// Number of frames changed, modulo 2³².
    pub const fn altered(&self) -> u32 {
        self.altered
    }

    /// Frame from the host on its way to the drives: adds the torque where it is a motion command.
    ///
    /// Joint and command as the host sent it; `None` for any other frame.
    pub fn to_drives(&mut self, frame: &mut Frame, now: u32) -> Option<(usize, JointCommand)> {
        let (joint, profile, command) =
            self.profiles
                .iter()
                .enumerate()
                .find_map(|(joint, profile)| {
                    let profile = profile.as_ref()?;
                    match profile.accept(frame)? {
                        Request::Command(command) => Some((joint, profile, command)),
                        Request::Order(_) => None,
                    }
                })?;
        if now.wrapping_sub(self.set_at) > self.timeout {
            // Stays off when the clock comes round again.
            self.torques = None;
        }
        let torque = self.torques.and_then(|torques| torques.get(joint).copied());
        if let Some((torque, carry)) = torque.zip(self.carry.get_mut(joint)) {
            // The sum stays within the limit; what the host itself sends beyond it is not reduced.
            let (low, high) = (-profile.torque_limit, profile.torque_limit);
            let room = (
                (low - command.torque).min(0.0),
                (high - command.torque).max(0.0),
            );
            let added = torque.max(room.0).min(room.1);
            if added != 0.0 && add(profile, frame, added, carry) {
                self.altered = self.altered.wrapping_add(1);
            }
        }
        Some((joint, command))
    }
}

/// Adds a torque, N·m at the joint, to a motion command. `false`: the frame is unchanged.
fn add(profile: &DriveProfile, frame: &mut Frame, torque: f32, carry: &mut f32) -> bool {
    let torque = torque / (profile.sign * profile.gear);
    let before = *frame;
    let steps = |size: f32, carry: &mut f32| carried(torque / size, carry, -0xffff, 0xffff);
    match &profile.protocol {
        Protocol::MiniCheetah(ranges) | Protocol::Damiao(ranges) => {
            mit::add_torque(frame, steps(2.0 * ranges.torque / 4095.0, carry));
        }
        Protocol::CyberGear(ranges) | Protocol::RobStride(ranges) => {
            cybergear::add_torque(frame, steps(2.0 * ranges.torque / 65535.0, carry));
        }
        Protocol::Odrive(scales) => {
            odrive::add_torque(frame, torque, steps(1.0 / scales.torque_scale, carry));
        }
        Protocol::Moteus(_) => moteus::add_torque(frame, torque, carry),
        Protocol::Cia402(_) => {}
    }
    *frame != before
}

#[cfg(test)]
mod tests;
