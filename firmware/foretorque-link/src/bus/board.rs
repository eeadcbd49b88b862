//! The drives on the buses of a board, between its session and its ports.

use super::FaultCause;
use super::config::BusJoint;
use super::drives::{BusDrives, BusPhase};
use super::line::LineMotion;
use crate::drives::Frame;
use crate::safety::{SafetyReason, SafetyState};
use crate::session::{Clock, LocalSensor, Session};
use core::marker::PhantomData;
use foretorque::arm::Arm;
use foretorque::joint::{JointMeasurement, JointSample, JointVector};
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
    /// Role.
    pub role: Role,
    /// Ports.
    pub wires: Wires,
    /// Bit rate of the CAN controllers, bit/s.
    pub bit_s: u32,
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

    /// The wiring in the flash; `None` for other bytes, another number of joints, or a drive whose profile contradicts
    /// itself.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let wiring: Self = postcard::from_bytes_crc32(bytes, CRC.digest()).ok()?;
        let mut drives = wiring.joints.iter().flatten();
        let sound = wiring.joints.len() == N && drives.all(|joint| joint.drive.check().is_ok());
        sound.then_some(wiring)
    }
}

const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);

/// Either side of a board that has drives.
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
    arm: PhantomData<fn() -> A>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> BoardDrives<A, N, P> {
    /// Drives that are switched off, or pass all commands unchanged.
    pub fn new(wiring: &Wiring<N>) -> Self {
        const PERIOD_US: u32 = 1000;
        let mut joints = [None; N];
        for (slot, joint) in joints.iter_mut().zip(&wiring.joints) {
            *slot = *joint;
        }
        Self {
            side: match wiring.role {
                Role::Master => {
                    Side::Master(BusDrives::new::<A, P>(&joints, 1e-6 * PERIOD_US as f32))
                }
                Role::InLine => Side::InLine(LineMotion::new(&joints)),
            },
            period_us: PERIOD_US,
            ticked: false,
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

    /// A tick has run since the last call of [`follow`](Self::follow).
    pub fn ticked(&self) -> bool {
        self.ticked
    }

    /// Fault of the drives, as far as the board has found one.
    pub fn fault(&self) -> Option<super::BusFault> {
        match &self.side {
            Side::Master(drives) => drives.fault(),
            Side::InLine(_) => None,
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
                for (joint, celsius) in line.temperatures() {
                    session.note_temperature(joint, celsius);
                }
                if line.failed() && session.torque_enabled() {
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
        }
        if off {
            drives.fail(None, FaultCause::BusOff);
        }
        let mut failed = drives.supervise();
        let enabled = session.torque_enabled();
        match drives.phase() {
            BusPhase::Off if enabled => {
                if let Err(fault) = drives.arm() {
                    drives.fail(fault.joint, fault.cause);
                }
            }
            BusPhase::Enabling(_) if !enabled => drives.stop(),
            _ => {}
        }
        drives.follow(session.desired());
        drives.advance(enabled, || enabled);
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
    fn measure(&mut self, sample: &mut Option<JointSample<N>>, at_rest: bool) -> SafetyReason {
        self.ticked = true;
        match &mut self.side {
            Side::Master(drives) => {
                let given = sample.and_then(|sample| sample.measured);
                let mut measured = given.unwrap_or(JointMeasurement::zero());
                let whole = drives.measure(&mut measured) && (given.is_some() || drives.complete());
                if let Some(sample) = sample {
                    sample.measured = whole.then_some(measured);
                }
                // No torque before every drive is switched on.
                if !at_rest && !matches!(drives.phase(), BusPhase::Running(_)) {
                    *sample = None;
                }
            }
            Side::InLine(line) => *sample = line.sample(sample.as_ref(), self.period_us),
        }
        SafetyReason::None
    }
}
