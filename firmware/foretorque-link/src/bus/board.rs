//! The drives on the buses of a board, between its session and its ports; in line, the motion in the frames that pass.

use super::config::{BusJoint, periods};
use super::drives::{BusDrives, BusPhase};
use super::joint::JointLink;
use super::{BusFault, ENABLE_S, FaultCause};
use crate::copy;
use crate::drives::{Frame, Request};
use crate::safety::{COMMAND_TIMEOUT_US, SafetyReason, SafetyState};
use crate::session::{Clock, LocalSensor, Session};
use crate::wire::CRC;
use core::marker::PhantomData;
use foretorque::arm::Arm;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use serde::{Deserialize, Serialize};

/// Place of a board among its drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// The board sends every command.
    Master,
    /// Another host sends the commands through the board, which adds its torque.
    InLine,
}

/// Ports of a board that carry the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wires {
    /// The CAN controllers.
    Can,
    /// Serial ports, in the text form of moteus.
    Uart,
}

/// Role of a board and its drives, as they are written into its flash.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wiring<const N: usize> {
    /// Hash of the arm: zeros, signs and limits are those of its joints.
    pub arm_hash: u32,
    /// Role.
    pub role: Role,
    /// Ports.
    pub wires: Wires,
    /// Bit rate of the CAN controllers, bit/s.
    pub bit_s: u32,
    /// Shortest period in which the buses carry commands and replies, µs; 0 where another host sends the commands.
    pub shortest_period_us: u32,
    /// Drives of the joints, base to tool; `None` where a joint has its drive elsewhere.
    pub joints: heapless::Vec<Option<BusJoint>, N>,
}

impl<const N: usize> Wiring<N> {
    /// Largest number of bytes of [`encode`](Self::encode), for eight joints.
    pub const BYTES: usize = 512;

    /// Bytes for the flash: postcard and its CRC-32.
    ///
    /// Errors: more bytes than `buffer` has.
    pub fn encode<'b>(&self, buffer: &'b mut [u8]) -> Result<&'b mut [u8], postcard::Error> {
        postcard::to_slice_crc32(self, buffer, CRC.digest())
    }

    /// The wiring in the flash; `None` for other bytes, another arm, or a drive whose profile contradicts itself.
    pub fn decode<A: Arm<N, P>, const P: usize>(bytes: &[u8]) -> Option<Self> {
        let wiring: Self = postcard::from_bytes_crc32(bytes, CRC.digest()).ok()?;
        let own = wiring.arm_hash == A::hash() && wiring.joints.len() == N;
        let mut drives = wiring.joints.iter().flatten();
        let sound = own && drives.all(|joint| joint.drive.check().is_ok());
        sound.then_some(wiring)
    }
}

enum Side<const N: usize> {
    Master(BusDrives<N>),
    InLine(LineMotion<N>),
}

/// Drives on the buses of a board: sensor of the ticks, and sender of their torques.
///
/// The owner passes in the frames as they arrive, runs the session with this as its sensor, then calls
/// [`follow`](Self::follow).
pub struct BoardDrives<A: Arm<N, P>, const N: usize, const P: usize> {
    side: Side<N>,
    period_us: u32,
    /// A tick has run since the last frames were sent.
    ticked: bool,
    /// This period has no sample.
    silent: bool,
    /// Periods for which arming has waited for replies and scales.
    waited: u16,
    arm: PhantomData<fn() -> A>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> BoardDrives<A, N, P> {
    /// Drives that are switched off, or pass all commands unchanged.
    pub fn new(wiring: &Wiring<N>) -> Self {
        const PERIOD_US: u32 = 1000;
        let mut joints = [None; N];
        copy(&mut joints, &wiring.joints);
        Self {
            side: match wiring.role {
                Role::Master => {
                    Side::Master(BusDrives::new::<A, P>(&joints, 1e-6 * PERIOD_US as f32))
                }
                Role::InLine => Side::InLine(LineMotion::new(&joints)),
            },
            period_us: PERIOD_US,
            ticked: false,
            silent: false,
            waited: 0,
            arm: PhantomData,
        }
    }

    /// Takes a frame as it arrived at a port: that of a bus, or 0 for the host's and 1 for that of the drives.
    pub fn receive(&mut self, port: u8, frame: &Frame) {
        match &mut self.side {
            Side::Master(drives) => drives.receive(port, frame),
            Side::InLine(line) => line.receive(port, frame),
        }
    }

    /// Torque limits of the drives, N × N·m; infinite for joints without a drive here.
    pub fn torque_limits(&self) -> [f32; N] {
        let limit = |joint: Option<&BusJoint>| {
            joint.map_or(f32::INFINITY, |joint| joint.drive.torque_limit)
        };
        core::array::from_fn(|index| match &self.side {
            Side::Master(drives) => limit(drives.joint(index)),
            Side::InLine(line) => limit(line.joint(index)),
        })
    }

    /// A tick has run since the last call of [`follow`](Self::follow).
    pub fn ticked(&self) -> bool {
        self.ticked
    }

    /// The drives need their supply: torque may flow, or those of a master damp. An emergency stop takes it at once.
    pub fn powered<C: Clock>(&self, session: &Session<A, N, P, C>) -> bool {
        session.torque_enabled() || !self.is_off() && !session.stopped()
    }

    /// Lets the drives of a master damp where they follow, or after an emergency stop switches them off. Called after each
    /// message of the host that leaves the torque off, so that an end of the torque between two ticks is seen: the drives
    /// then start softly again.
    pub fn end<C: Clock>(&mut self, session: &Session<A, N, P, C>) {
        if let Side::Master(drives) = &mut self.side {
            match drives.damp() {
                BusPhase::Off => {}
                _ if session.stopped() => _ = drives.stop(),
                _ => {}
            }
        }
    }

    /// After a tick of `session`: sends the commands of a master through `send` with the number of their bus. In line,
    /// returns the torques to add, N × N·m; `None` passes all commands unchanged.
    ///
    /// * `off` a port has left its bus
    pub fn follow<C: Clock>(
        &mut self,
        session: &mut Session<A, N, P, C>,
        off: bool,
        mut send: impl FnMut(u8, &Frame),
    ) -> Option<JointVector<N>> {
        if !core::mem::take(&mut self.ticked) {
            return None;
        }
        let period_us = session.configuration().period_us;
        let changed = core::mem::replace(&mut self.period_us, period_us) != period_us;
        let drives = match &mut self.side {
            Side::Master(drives) => drives,
            Side::InLine(line) => {
                let joints = line.joints.iter_mut().enumerate();
                for (joint, slot) in joints {
                    let celsius = slot.as_mut().and_then(|slot| slot.link.temperature());
                    if let Some(celsius) = celsius {
                        session.note_temperature(joint, celsius);
                    }
                }
                if line.failed && session.torque_enabled() {
                    session.trip(SafetyReason::Drive);
                }
                return session.torque_enabled().then(|| *session.torque_output());
            }
        };
        if changed {
            drives.set_period::<A, P>(1e-6 * period_us as f32);
        }
        for (joint, celsius) in drives.temperatures() {
            session.note_temperature(joint, celsius);
        }
        if drives.fault().is_some() && session.latched_fault() == SafetyReason::None {
            // The host has cleared it.
            drives.clear();
            self.waited = 0;
        }
        if off {
            drives.fail(None, FaultCause::BusOff);
        }
        let mut failed = drives.supervise();
        let enabled = session.torque_enabled();
        match drives.phase() {
            BusPhase::Off if enabled && drives.is_off() => match drives.arm() {
                // After a fault was cleared, scales are read again.
                Err(BusFault {
                    cause: FaultCause::Silent | FaultCause::ScaleUnknown(_),
                    ..
                }) if self.waited < periods(ENABLE_S, 1e-6 * period_us as f32) => self.waited += 1,
                Err(fault) => drives.fail(fault.joint, fault.cause),
                Ok(()) => {}
            },
            BusPhase::Enabling(_) if !enabled => _ = drives.stop(),
            BusPhase::Running(_) | BusPhase::Damping(_) if session.stopped() => {
                _ = drives.stop();
            }
            _ => {}
        }
        if drives.phase() != BusPhase::Off || !enabled {
            self.waited = 0;
        }
        drives.follow(session.desired().filter(|_| !self.silent));
        drives.advance(enabled, || Ok(()));
        failed |= drives.fault().is_some();
        if failed {
            session.trip(SafetyReason::Drive);
        }
        let armed = session.safety().state == SafetyState::Armed;
        drives.command(session.torque_output(), armed, &mut send);
        None
    }
}

impl<A: Arm<N, P>, const N: usize, const P: usize> LocalSensor<N> for BoardDrives<A, N, P> {
    fn measure(&mut self, sample: &mut Option<JointSample<N>>, _: bool) -> SafetyReason {
        self.ticked = true;
        self.silent = false;
        match &mut self.side {
            Side::Master(drives) => {
                let given = sample.and_then(|sample| sample.measured);
                let mut measured = given.unwrap_or(JointMeasurement::zero());
                let whole = drives.measure(&mut measured) && (given.is_some() || drives.complete());
                if let Some(sample) = sample {
                    sample.measured = whole.then_some(measured);
                }
            }
            Side::InLine(line) => *sample = line.sample(sample.as_ref(), self.period_us),
        }
        SafetyReason::None
    }

    const SAMPLES_AT_ONCE: u8 = 0;

    /// Drives would keep the last torque: a master commands them in every period, in line the torque follows the safety.
    fn silence(&mut self) {
        self.measure(&mut None, false);
        self.silent = true;
    }

    /// No torque before every drive is switched on.
    fn holds(&self) -> bool {
        match &self.side {
            Side::Master(drives) => !matches!(drives.phase(), BusPhase::Running(_)),
            Side::InLine(_) => false,
        }
    }

    fn is_off(&self) -> bool {
        match &self.side {
            Side::Master(drives) => drives.is_off(),
            Side::InLine(_) => true,
        }
    }
}

/// Weight of a command over that of the next one. The memory of the filter is ten commands: positions of 16 bits over ±12.5 rad
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
        let [q, qd, qdd] = [
            ahead[0] + g * error,
            ahead[1] + h * error / t,
            ahead[2] + k * error / (t * t),
        ];
        // Beyond the range of f32 the next command starts the filter anew.
        let finite = (q + qd + qdd).is_finite();
        self.state = finite.then_some([q, qd, qdd]);
        // The position itself is known.
        Some([command.unwrap_or(q), qd, qdd])
    }
}

struct LineJoint {
    link: JointLink,
    filter: MotionFilter,
}

/// Motion of the joints whose commands and replies pass.
struct LineMotion<const N: usize> {
    joints: [Option<LineJoint>; N],
    /// In the last period a drive was off, or its replies showed a fault.
    failed: bool,
}

impl<const N: usize> LineMotion<N> {
    fn new(joints: &[Option<BusJoint>; N]) -> Self {
        let of = |joint| LineJoint {
            link: JointLink::new(joint),
            filter: MotionFilter::default(),
        };
        Self {
            joints: joints.map(|joint| joint.map(of)),
            failed: false,
        }
    }

    fn joint(&self, index: usize) -> Option<&BusJoint> {
        let slot = self.joints.get(index)?.as_ref()?;
        Some(&slot.link.joint)
    }

    /// Takes a frame from the host, port 0, or from the drives.
    fn receive(&mut self, port: u8, frame: &Frame) {
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

    /// Closes a period: the sample of what has passed. Joints without a drive here take their part of `given`.
    fn sample(&mut self, given: Option<&JointSample<N>>, period_us: u32) -> Option<JointSample<N>> {
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
                    let off = slot.link.is_off();
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
    use foretorque::arm::ur5::Ur5;

    #[test]
    fn the_wiring_of_another_arm_is_none() {
        let own = Ur5::hash();
        for (arm_hash, read) in [(own, true), (own ^ 1, false)] {
            let wiring = Wiring::<6> {
                arm_hash,
                role: Role::Master,
                wires: Wires::Can,
                bit_s: 1_000_000,
                shortest_period_us: 0,
                joints: [None; 6].into_iter().collect(),
            };
            let mut buffer = [0; Wiring::<6>::BYTES];
            let bytes = wiring.encode(&mut buffer).unwrap();
            assert_eq!(Wiring::<6>::decode::<Ur5, 40>(bytes).is_some(), read);
        }
    }

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

    #[test]
    fn a_motion_beyond_the_range_of_f32_lasts_one_period() {
        let mut filter = MotionFilter::default();
        for (k, command) in [0.1, 1e37, 0.1, 0.1, 0.1].into_iter().enumerate() {
            filter.command = Some(command);
            let motion = filter.step(1000).unwrap();
            let finite = motion.iter().all(|value| value.is_finite());
            assert_eq!(finite, k != 1, "{k} {motion:?}");
        }
    }
}
