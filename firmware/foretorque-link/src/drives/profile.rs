//! Profile of one drive: protocol, scales, and the place of its joint.

use super::{JointCommand, TURN};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Symmetric full scales of a frame with packed integers, in the coordinates of the drive: a field covers ± its scale.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ranges {
    /// Position, rad.
    pub position: f32,
    /// Velocity, rad/s.
    pub velocity: f32,
    /// Torque, N·m.
    pub torque: f32,
    /// Largest stiffness, N·m/rad; the field begins at 0.
    pub kp: f32,
    /// Largest damping, N·m·s/rad; the field begins at 0.
    pub kd: f32,
}

/// Protocol of a drive, with the scales of its fields.
///
/// Each scale must equal the one configured in the drive; an order of the kind `ReadScale` asks the drive for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Protocol {
    /// MIT frame of eight bytes; reply of bgkatz/motorcontrol: identifier, position, velocity, torque in six bytes.
    MiniCheetah(Ranges),
    /// MIT frame of eight bytes; reply of Damiao with status and two temperatures; the registers hold the ranges.
    Damiao(Ranges),
    /// CyberGear: extended identifier with the torque in bits 8 to 23.
    CyberGear(Ranges),
    /// RobStride: the frames of CyberGear, other ranges.
    #[serde(rename = "robstride", alias = "rob-stride")]
    RobStride(Ranges),
    /// moteus registers over CAN-FD or its UART text form.
    Moteus(Moteus),
    /// ODrive CANSimple.
    Odrive(Odrive),
    /// CiA 402 process data (EtherCAT, CANopen).
    Cia402(Cia402),
}

impl Protocol {
    /// Scales of a frame with packed integers.
    pub(crate) const fn ranges(&self) -> Option<&Ranges> {
        match self {
            Self::MiniCheetah(ranges)
            | Self::Damiao(ranges)
            | Self::CyberGear(ranges)
            | Self::RobStride(ranges) => Some(ranges),
            Self::Moteus(_) | Self::Odrive(_) | Self::Cia402(_) => None,
        }
    }

    /// The drive controls velocity or torque alone, and needs a position loop elsewhere.
    pub fn is_without_position(&self) -> bool {
        match self {
            Self::Odrive(odrive) => odrive.mode != ControlMode::Position,
            Self::Cia402(cia402) => cia402.mode != ControlMode::Position,
            _ => false,
        }
    }

    /// Largest values of a command, in the coordinates of the drive: what its frame carries.
    pub(crate) fn largest(&self) -> Ranges {
        const SHORT: f32 = i16::MAX as f32;
        const LONG: f32 = i32::MAX as f32;
        let unlimited = Ranges {
            position: f32::MAX,
            velocity: f32::MAX,
            torque: 1e4,
            kp: f32::MAX,
            kd: f32::MAX,
        };
        match *self {
            Self::MiniCheetah(ranges)
            | Self::Damiao(ranges)
            | Self::CyberGear(ranges)
            | Self::RobStride(ranges) => ranges,
            Self::Moteus(moteus) => {
                let counts = match moteus.resolution {
                    Resolution::Int16 => SHORT,
                    Resolution::Int32 => LONG,
                    Resolution::F32 => 0.0,
                };
                let steps = moteus.resolution.steps();
                let [position, velocity, torque] = steps.map(|step| match counts * step {
                    0.0 => f32::MAX,
                    most => most,
                });
                let gain = moteus.resolution.largest_scale() / TURN;
                Ranges {
                    position: position * TURN,
                    velocity: velocity * TURN,
                    torque: torque.min(unlimited.torque),
                    kp: gain * moteus.kp,
                    kd: gain * moteus.kd,
                }
            }
            Self::Odrive(odrive) if odrive.mode == ControlMode::Position => Ranges {
                velocity: SHORT / odrive.velocity_scale * TURN,
                torque: SHORT / odrive.torque_scale,
                ..unlimited
            },
            Self::Odrive(_) => unlimited,
            Self::Cia402(cia402) => Ranges {
                position: LONG / cia402.counts_per_turn * TURN,
                velocity: LONG / cia402.counts_per_turn * TURN,
                torque: SHORT * 1e-3 * cia402.rated_torque,
                ..unlimited
            },
        }
    }
}

/// Scales of a moteus drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Moteus {
    /// Stiffness at a scale of 1 (`servo.pid_position.kp`), N·m per turn.
    pub kp: f32,
    /// Damping at a scale of 1 (`servo.pid_position.kd`), N·m·s per turn.
    pub kd: f32,
    /// Time without a command until the drive times out (register 0x027), s.
    pub watchdog_s: f32,
    /// Form of position, velocity, torque and gain scales, in commands and replies.
    pub resolution: Resolution,
}

/// Form of a moteus register on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resolution {
    /// 10⁻⁴ turns, 0.00025 turns/s, 0.01 N·m.
    Int16,
    /// 10⁻⁵ turns, 10⁻⁵ turns/s, 0.001 N·m.
    Int32,
    /// Without a step.
    F32,
}

impl Resolution {
    /// Largest scale of stiffness and damping: integers end at 1.
    pub(super) const fn largest_scale(self) -> f32 {
        match self {
            Self::Int16 | Self::Int32 => 1.0,
            Self::F32 => 1e3,
        }
    }

    /// Steps of position, velocity and torque in turns, turns/s and N·m; 0 for f32.
    pub(super) const fn steps(self) -> [f32; 3] {
        match self {
            Self::Int16 => [1e-4, 2.5e-4, 1e-2],
            Self::Int32 => [1e-5, 1e-5, 1e-3],
            Self::F32 => [0.0; 3],
        }
    }
}

/// Scales of an ODrive axis. Its gains are configured in the drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Odrive {
    /// Input that commands set: position and torque, velocity and torque, or torque alone.
    pub mode: ControlMode,
    /// Counts of `Vel_FF` per turn/s (`input_vel_scale`; 1000 as shipped).
    pub velocity_scale: f32,
    /// Counts of `Torque_FF` per N·m (`input_torque_scale`; 1000 as shipped).
    pub torque_scale: f32,
    /// Endpoint of `input_torque_scale` in the firmware's `flat_endpoints.json`; 0 = not asked.
    pub torque_scale_endpoint: u16,
    /// Commands ask for the estimates by remote frames; otherwise the drive sends them at its own rate.
    pub polled: bool,
}

/// Scales of a CiA 402 drive. Its gains are configured in the drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cia402 {
    /// Mode of operation.
    pub mode: ControlMode,
    /// Counts of position per turn; of velocity per turn/s.
    pub counts_per_turn: f32,
    /// Rated torque (6076h), N·m; the frames carry thousandths of it.
    pub rated_torque: f32,
}

/// Controlled quantity; in the first two the torque of a command is a feed-forward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlMode {
    /// Position. CiA 402: cyclic synchronous position mode, 8.
    Position,
    /// Velocity. CiA 402: cyclic synchronous velocity mode, 9.
    Velocity,
    /// Torque. CiA 402: cyclic synchronous torque mode, 10.
    Torque,
}

/// Drive of one joint.
///
/// Coordinates: `drive position = sign·gear·(joint position − zero)`, `drive torque = sign·torque/gear`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveProfile {
    /// Protocol, with the scales of its fields.
    pub protocol: Protocol,
    /// Identifier of the drive on its bus (moteus and CyberGear: 1 to 127; ODrive: node, 0 to 62).
    pub id: u16,
    /// Identifier of the host, to which replies go: Damiao's master, CyberGear's host, moteus' source.
    pub host_id: u16,
    /// +1, or −1 where the drive counts against the joint.
    pub sign: f32,
    /// Position of the joint at position 0 of the drive, rad.
    pub zero: f32,
    /// Turns of the drive's coordinate per turn of the joint: 1 where the drive counts at its output.
    pub gear: f32,
    /// Largest torque commanded, N·m at the joint.
    pub torque_limit: f32,
}

/// Two values that contradict each other, or a value out of its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contradiction {
    /// Joint, from 0; `None` for a field of the whole arm, or of a drive that has no joint yet.
    pub joint: Option<u8>,
    /// Field.
    pub field: &'static str,
    /// Its value.
    pub value: f32,
    /// Contradicting quantity.
    pub against: &'static str,
    /// Its value.
    pub bound: f32,
}

impl Contradiction {
    /// `value` of `field` contradicts `bound`, which is `against`.
    pub const fn new(field: &'static str, value: f32, against: &'static str, bound: f32) -> Self {
        Self {
            joint: None,
            field,
            value,
            against,
            bound,
        }
    }

    /// Contradiction of a joint, from 0.
    pub const fn of(self, joint: usize) -> Self {
        Self {
            joint: Some(joint as u8),
            ..self
        }
    }
}

impl fmt::Display for Contradiction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(joint) = self.joint {
            write!(f, "joint {}: ", joint + 1)?;
        }
        let Self { field, value, .. } = self;
        let Self { against, bound, .. } = self;
        write!(f, "{field} {value} contradicts {against} {bound}")
    }
}

impl core::error::Error for Contradiction {}

impl DriveProfile {
    /// Check of every field. Errors: the first field that is not finite, out of range, or whose torque the frame cannot
    /// carry.
    pub fn check(&self) -> Result<(), Contradiction> {
        const POSITIVE: (f32, f32) = (1e-6, 1e6);
        // A turn must fit into the target of a frame, an i32.
        const COUNTS: (f32, f32) = (1.0, 2_147_483_648.0);
        let (ids, hosts) = match self.protocol {
            // A reply has one byte for the id.
            Protocol::MiniCheetah(_) => ((1.0, 255.0), (0.0, 2047.0)),
            // 0x7FF belongs to the registers of all Damiao drives.
            Protocol::Damiao(_) => ((1.0, 2046.0), (0.0, 2046.0)),
            Protocol::CyberGear(_) | Protocol::RobStride(_) => ((1.0, 127.0), (0.0, 255.0)),
            Protocol::Moteus(_) => ((1.0, 127.0), (0.0, 127.0)),
            Protocol::Odrive(_) => ((0.0, 62.0), (0.0, 2047.0)),
            Protocol::Cia402(_) => ((1.0, 127.0), (0.0, 2047.0)),
        };
        let place = [
            ("id", self.id.into(), ids),
            ("host_id", self.host_id.into(), hosts),
            ("sign", self.sign, (-1.0, 1.0)),
            ("size of sign", self.sign * self.sign, (1.0, 1.0)),
            ("zero", self.zero, (-1e3, 1e3)),
            ("gear", self.gear, (1e-3, 1e4)),
        ];
        let scales: &[(&'static str, f32)] = match self.protocol {
            Protocol::MiniCheetah(r)
            | Protocol::Damiao(r)
            | Protocol::CyberGear(r)
            | Protocol::RobStride(r) => &[
                ("position", r.position),
                ("velocity", r.velocity),
                ("torque", r.torque),
                ("kp", r.kp),
                ("kd", r.kd),
            ],
            Protocol::Moteus(m) => &[("kp", m.kp), ("kd", m.kd), ("watchdog_s", m.watchdog_s)],
            Protocol::Odrive(o) => &[
                ("velocity_scale", o.velocity_scale),
                ("torque_scale", o.torque_scale),
            ],
            Protocol::Cia402(c) => &[("rated_torque", c.rated_torque)],
        };
        let scales = scales
            .iter()
            .map(|&(field, value)| (field, value, POSITIVE));
        let counts = match self.protocol {
            Protocol::Cia402(c) => Some(("counts_per_turn", c.counts_per_turn, COUNTS)),
            _ => None,
        };
        let refused = |field, value, (least, most): (f32, f32)| {
            let (against, bound) = if value < least {
                ("the least value", least)
            } else {
                ("the largest value", most)
            };
            Err(Contradiction::new(field, value, against, bound))
        };
        for (field, value, range) in place.into_iter().chain(scales).chain(counts) {
            if !(value >= range.0 && value <= range.1) {
                return refused(field, value, range);
            }
        }
        let (limit, most) = (self.torque_limit, self.largest_torque());
        if !(limit > 0.0 && limit <= most) {
            return refused("torque_limit", limit, (0.0, most));
        }
        Ok(())
    }

    /// Largest torque at the joint that a frame carries, N·m.
    pub fn largest_torque(&self) -> f32 {
        self.protocol.largest().torque * self.gear
    }

    /// Step of the reported torque at the joint, N·m: the reply's quantum. Rounding adds noise of this over √12.
    pub fn torque_resolution(&self) -> f32 {
        let drive = match self.protocol {
            Protocol::MiniCheetah(r) | Protocol::Damiao(r) => 2.0 * r.torque / 4095.0,
            Protocol::CyberGear(r) | Protocol::RobStride(r) => 2.0 * r.torque / 65535.0,
            Protocol::Moteus(m) => m.resolution.steps()[2],
            Protocol::Odrive(_) => 0.0,
            Protocol::Cia402(c) => 1e-3 * c.rated_torque,
        };
        drive * self.gear
    }

    /// The frames carry stiffness and damping; elsewhere they are configured in the drive.
    pub const fn carries_gains(&self) -> bool {
        !matches!(self.protocol, Protocol::Odrive(_) | Protocol::Cia402(_))
    }

    /// A command in the coordinates of the drive.
    pub(super) fn in_drive(&self, joint: &JointCommand) -> JointCommand {
        let turn = self.sign * self.gear;
        let square = self.gear * self.gear;
        JointCommand {
            position: (joint.position - self.zero) * turn,
            velocity: joint.velocity * turn,
            torque: joint.torque / turn,
            kp: joint.kp / square,
            kd: joint.kd / square,
        }
    }

    /// A command in the coordinates of the joint.
    pub(super) fn in_joint(&self, drive: &JointCommand) -> JointCommand {
        let turn = self.sign * self.gear;
        let square = self.gear * self.gear;
        JointCommand {
            position: drive.position / turn + self.zero,
            velocity: drive.velocity / turn,
            torque: drive.torque * turn,
            kp: drive.kp * square,
            kd: drive.kd * square,
        }
    }
}
