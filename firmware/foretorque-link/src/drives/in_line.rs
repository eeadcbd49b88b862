//! Board in line between a host and its drives: passes every frame and adds a torque to the motion commands of its drives.
//!
//! Only the torque field of a motion command changes, and only while a torque is set that is younger than the time-out.
//! Otherwise, and for every other frame, the bytes that leave are the bytes that came. The torque field is that of MIT,
//! CyberGear, RobStride, ODrive and moteus, there where the host sends one; moteus' needs a position too. Commands of CiA 402
//! pass unchanged.

use super::frame::carried;
use super::{DriveProfile, Frame, JointCommand, Protocol, Request, cybergear, mit, moteus, odrive};
use heapless::Deque;

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
            if added != 0.0 {
                add(profile, frame, added, carry);
            }
        }
        Some((joint, command))
    }
}

/// Adds a torque, N·m at the joint, to a motion command.
fn add(profile: &DriveProfile, frame: &mut Frame, torque: f32, carry: &mut f32) {
    let torque = torque / (profile.sign * profile.gear);
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
}

/// Controller of one bus.
pub trait Port {
    /// Oldest received frame.
    fn receive(&mut self) -> Option<Frame>;
    /// Gives a frame to the controller that waits since the count `since`. `false`: it has no room now.
    fn send(&mut self, frame: &Frame, since: u32) -> bool;
    /// Takes every frame back that has waited for more than `timeout`, in counts of the clock of `now`.
    ///
    /// Number of frames that the controller has lost since the last call: taken back, or overrun as they arrived.
    fn expire(&mut self, now: u32, timeout: u32) -> u32;
}

/// Both ports of a board. In line, port 0 is that of the host and port 1 that of the drives.
///
/// A frame leaves once it has arrived as a whole: that delays it by its own time on the bus, and by one [`Self::pass`]. One
/// that has waited too long is dropped: without a drive that acknowledges, a controller repeats its frames for ever, and a
/// drive that comes back must not take an order or a torque of before.
#[derive(Debug)]
pub struct Bridge<P, const N: usize> {
    ports: [P; 2],
    /// Frames with the counts since which they wait.
    queues: [Queue; 2],
    timeout: u32,
    /// Torques to add in line; `None` where the board is the master and no frame passes.
    in_line: Option<InLine<N>>,
    lost: u32,
}

/// Frames that wait for a busy bus, each way: three of each drive of an arm with eight joints.
const QUEUE: usize = 24;
type Queue = Deque<(u32, Frame), QUEUE>;
/// Frames taken from a port in one call.
const TAKEN: usize = 16;

impl<P: Port, const N: usize> Bridge<P, N> {
    /// A bridge between two started ports. A frame waits for at most `timeout`, in counts of the clock of [`InLine`], and one
    /// time between two calls of [`pass`](Self::pass).
    pub const fn new(ports: [P; 2], in_line: Option<InLine<N>>, timeout: u32) -> Self {
        Self {
            ports,
            timeout,
            queues: [const { Deque::new() }; 2],
            in_line,
            lost: 0,
        }
    }

    /// Queues a frame of the board itself.
    pub fn send(&mut self, port: u8, frame: Frame, now: u32) {
        if let Some(queue) = self.queues.get_mut(usize::from(port)) {
            self.lost = self.lost.wrapping_add(append(queue, (now, frame)));
        }
    }

    /// Sets the torques to add, N × N·m, or passes all frames unchanged.
    pub fn add(&mut self, torques: Option<&[f32; N]>, now: u32) {
        match (&mut self.in_line, torques) {
            (Some(in_line), Some(torques)) => in_line.set(torques, now),
            (Some(in_line), None) => in_line.clear(),
            (None, _) => {}
        }
    }

    /// Takes and passes what has arrived; calls `seen` with port and frame as it arrived. Called when a frame has arrived
    /// or a mailbox is empty again, and at least once a period: frames that wait grow old.
    ///
    /// * `now` count of the clock of [`InLine`]
    ///
    /// Cost: at most 16 frames in and 24 out each way.
    pub fn pass(&mut self, now: u32, mut seen: impl FnMut(u8, &Frame)) {
        let [host, drives] = &mut self.ports;
        let [to_host, to_drives] = &mut self.queues;
        let ways = [(host, to_drives), (drives, to_host)];
        for (way, (port, queue)) in ways.into_iter().enumerate() {
            for _ in 0..TAKEN {
                let Some(mut frame) = port.receive() else {
                    break;
                };
                seen(way as u8, &frame);
                if let Some(in_line) = &mut self.in_line {
                    if way == 0 {
                        in_line.to_drives(&mut frame, now);
                    }
                    self.lost = self.lost.wrapping_add(append(queue, (now, frame)));
                }
            }
        }
        for (queue, port) in self.queues.iter_mut().zip(&mut self.ports) {
            self.lost = self.lost.wrapping_add(port.expire(now, self.timeout));
            for _ in 0..QUEUE {
                let Some(&(since, ref frame)) = queue.front() else {
                    break;
                };
                if now.wrapping_sub(since) > self.timeout {
                    self.lost = self.lost.wrapping_add(1);
                } else if !port.send(frame, since) {
                    break;
                }
                queue.pop_front();
            }
        }
    }

    /// Number of frames lost because a bus stood still or a controller overran, modulo 2³².
    pub const fn lost(&self) -> u32 {
        self.lost
    }

    /// The ports.
    pub const fn ports(&mut self) -> &mut [P; 2] {
        &mut self.ports
    }
}

/// Appends a frame; drops the oldest one, which is late, where the queue is full. Number of frames dropped.
fn append(queue: &mut Queue, frame: (u32, Frame)) -> u32 {
    let dropped = queue.is_full() && queue.pop_front().is_some();
    let room = queue.push_back(frame);
    debug_assert!(room.is_ok(), "a place was made");
    dropped.into()
}

#[cfg(test)]
mod tests;
