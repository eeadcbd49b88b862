//! Desired and measured motion of an arm, from the frames that pass a board in line.

use super::config::{BusJoint, periods};
use super::joint::JointLink;
use crate::drives::{DriveState, Frame, Request};
use crate::safety::COMMAND_TIMEOUT_US;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample};

/// Weight of a command over that of the next one. The filter remembers ten commands: positions of 16 bits over ±12.5 rad
/// at 500 Hz then give accelerations with a standard deviation of 0.04 rad/s².
const MEMORY: f32 = 0.9;

/// Position, velocity and acceleration of successive commanded positions: fading-memory polynomial of degree two.
/// [Morrison 1969, table 13.1] The estimate has no lag at constant acceleration.
#[derive(Clone, Copy, Default)]
struct MotionFilter {
    /// Position, velocity and acceleration, rad and seconds.
    state: Option<[f32; 3]>,
    /// Time since the last command, µs.
    age_us: u32,
    /// Command of this period, rad.
    command: Option<f32>,
}

impl MotionFilter {
    /// Closes a period: the motion at its end; `None` without a young command.
    fn step(&mut self, period_us: u32) -> Option<[f32; 3]> {
        const LEFT: f32 = 1.0 - MEMORY;
        const GAINS: [f32; 3] = [
            1.0 - MEMORY * MEMORY * MEMORY,
            1.5 * LEFT * LEFT * (1.0 + MEMORY),
            LEFT * LEFT * LEFT,
        ];
        self.age_us = self.age_us.saturating_add(period_us);
        let command = self.command.take();
        if command.is_some() {
            self.age_us = 0;
        } else if self.age_us > COMMAND_TIMEOUT_US {
            self.state = None;
        }
        let t = 1e-6 * period_us as f32;
        let Some([q, qd, qdd]) = self.state else {
            self.state = command.map(|q| [q, 0.0, 0.0]);
            return self.state;
        };
        let ahead = [q + t * (qd + 0.5 * t * qdd), qd + t * qdd, qdd];
        let error = command.map_or(0.0, |command| command - ahead[0]);
        let [g, h, k] = GAINS;
        self.state = Some([
            ahead[0] + g * error,
            ahead[1] + h * error / t,
            ahead[2] + k * error / (t * t),
        ]);
        // The position itself is known.
        self.state
            .map(|[q, qd, qdd]| [command.unwrap_or(q), qd, qdd])
    }
}

/// One joint on the line.
struct LineJoint {
    link: JointLink,
    filter: MotionFilter,
}

/// Motion of the joints whose commands and replies pass.
pub(super) struct LineMotion<const N: usize> {
    joints: [Option<LineJoint>; N],
    failed: bool,
}

impl<const N: usize> LineMotion<N> {
    pub(super) fn new(joints: &[Option<BusJoint>; N]) -> Self {
        let of = |joint| LineJoint {
            link: JointLink::new(joint),
            filter: MotionFilter::default(),
        };
        Self {
            joints: joints.map(|joint| joint.map(of)),
            failed: false,
        }
    }

    /// In the last period a drive was off, or its replies showed a fault.
    pub(super) fn failed(&self) -> bool {
        self.failed
    }

    /// Takes a frame from the host, port 0, or from the drives.
    pub(super) fn receive(&mut self, port: u8, frame: &Frame) {
        for slot in self.joints.iter_mut().flatten() {
            let drive = &slot.link.joint.drive;
            if port == 0 {
                if let Some(Request::Command(command)) = drive.accept(frame) {
                    slot.filter.command = Some(command.position);
                }
            } else if let Some(event) = drive.decode(frame) {
                slot.link.take(event);
            }
        }
    }

    pub(super) fn temperatures(&self) -> impl Iterator<Item = (usize, i8)> {
        let joints = self.joints.iter().enumerate();
        joints
            .filter_map(|(joint, slot)| Some((joint, slot.as_ref()?.link.reply.temperature? as i8)))
    }

    /// Closes a period: the sample of what has passed. Joints without a drive here take their part of `given`.
    pub(super) fn sample(
        &mut self,
        given: Option<&JointSample<N>>,
        period_us: u32,
    ) -> Option<JointSample<N>> {
        let mut desired = given.map_or(JointMotion::zero(), |given| given.desired);
        let known = given.and_then(|given| given.measured);
        let mut measured = known.unwrap_or(JointMeasurement::zero());
        let (mut commanded, mut replied) = (true, true);
        let silence = periods(1e-6 * COMMAND_TIMEOUT_US as f32, 1e-6 * period_us as f32);
        self.failed = false;
        let motion = desired
            .q
            .iter_mut()
            .zip(desired.qd.iter_mut())
            .zip(desired.qdd.iter_mut());
        let slots = measured.q.iter_mut().zip(measured.tau.iter_mut());
        for ((slot, ((q, qd), qdd)), (position, torque)) in
            self.joints.iter_mut().zip(motion).zip(slots)
        {
            let Some(slot) = slot else {
                commanded &= given.is_some();
                replied &= known.is_some();
                continue;
            };
            match slot.filter.step(period_us) {
                Some(now) => {
                    [*q, *qd, *qdd] = now;
                    let off = slot.link.reply.state == Some(DriveState::Disabled);
                    // Two clocks: a period may have two replies, or none.
                    match slot.link.close(f32::INFINITY) {
                        Some(now) => (*position, *torque) = now,
                        None => replied = false,
                    }
                    self.failed |= slot.link.fault(*q, silence).is_some() || off;
                }
                None => commanded = false,
            }
        }
        let measured = replied.then_some(measured);
        commanded.then_some(JointSample { desired, measured })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_filter_follows_a_parabola_without_lag_and_forgets_after_the_timeout() {
        let mut filter = MotionFilter::default();
        let path = |t: f32| 0.3 + 0.5 * t - t * t;
        let mut seen = None;
        for k in 0..600 {
            // Every fifth command is lost.
            filter.command = (k % 5 != 4).then(|| path(k as f32 * 2e-3));
            seen = filter.step(2000);
        }
        let [q, qd, qdd] = seen.unwrap();
        let t = 599.0 * 2e-3;
        assert!((q - path(t)).abs() < 1e-4, "{q}");
        assert!((qd - (0.5 - 2.0 * t)).abs() < 1e-3, "{qd}");
        assert!((qdd + 2.0).abs() < 0.05, "{qdd}");
        // The last command was lost; 50 ms are 25 periods.
        let silent = (0..30).find(|_| filter.step(2000).is_none());
        assert_eq!(silent, Some(24));
    }
}
