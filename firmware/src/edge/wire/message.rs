//! What is said on the link, in both directions.

use super::{Acceleration, Effort, Position, Velocity};
use crate::edge::bank::BankError;
use crate::edge::telemetry::Statistics;
use crate::feedforward::{Shares, Torque};
use crate::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use crate::limits::Flags;
use core::fmt;
use serde::{Deserialize, Serialize};
use serde_big_array::BigArray;

/// Bank bytes that one frame carries.
pub const CHUNK: usize = 64;
/// A piece of a parameter bank.
pub type Chunk = heapless::Vec<u8, CHUNK>;
/// A short name in ASCII.
pub type Name = heapless::String<24>;

/// From the host to the board. Variants are only ever appended: their index is the tag on the wire.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HostMessage<const N: usize> {
    /// Who is there? Restarts the count of sequence numbers. Answer: [`BoardMessage::Hello`].
    Hello,
    /// Input of one tick. Answer, at once or at the next timer tick: torque in the reply mode chosen.
    Sample(SampleFrame<N>),
    /// Shares of the active set for one motion, without state. Answer: [`BoardMessage::Evaluated`].
    Evaluate(MotionFrame<N>),
    /// Period, pacing and reply mode; restarts the tick at 0. Refused while learning is on. Answer: ack.
    Configure(Configuration),
    /// Learning on or off (frozen). Answer: ack.
    Learning {
        /// Learn from the next tick on.
        on: bool,
    },
    /// A piece of a bank; offset 0 begins an upload, the pieces follow in order. Answer: ack.
    BankWrite {
        /// Place of the first byte in the bank.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
        /// The bytes.
        bytes: Chunk,
    },
    /// The upload is complete and shall be taken over. Answer: ack, and the set is in force in the next tick.
    BankCommit {
        /// Length of the bank in bytes.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// CRC-32 over the whole bank, its own checksum included.
        #[serde(with = "postcard::fixint::le")]
        crc: u32,
    },
    /// A piece of the bank in force; offset 0 takes the snapshot that the further pieces come from. Answer: chunk.
    BankRead {
        /// Place of the first byte wanted.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
    },
    /// Counters. Answer: [`BoardMessage::Statistics`].
    Statistics,
    /// Back to the state after boot: the bank of the firmware, learning off, tick 0, counters 0. Answer: ack.
    Reset,
}

/// From the board to the host. A frame carries the sequence number of the host's frame that it answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum BoardMessage<const N: usize> {
    /// Who the board is; also sent unasked after boot, with sequence number 0.
    Hello(BoardHello),
    /// Torque of one tick, shares of one joint.
    Torque(TorqueFrame<N>),
    /// Torque of one tick, all shares.
    FullTorque(FullTorqueFrame<N>),
    /// Shares for one motion.
    Evaluated(EvaluatedFrame<N>),
    /// Done.
    Ack,
    /// Not done, and nothing has changed.
    Nack(NackReason),
    /// A piece of the bank in force; empty behind its end.
    BankChunk {
        /// Place of the first byte in the bank.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
        /// Length of the whole bank.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// The bytes.
        bytes: Chunk,
    },
    /// Counters since boot or reset.
    Statistics(Statistics),
}

/// What a sample carries besides the desired motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampleFlags(pub u8);

impl SampleFlags {
    /// Position and effort were measured in this cycle.
    pub const MEASURED: Self = Self(1 << 0);
    /// The effort is motor current in A; the board multiplies by the drive gain of its bank.
    pub const CURRENT: Self = Self(1 << 1);

    /// Every flag of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// Input of one tick.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SampleFrame<const N: usize> {
    /// What is in it.
    pub flags: SampleFlags,
    /// Motor temperature of joint `sequence % N`, °C; [`NO_TEMPERATURE`](Self::NO_TEMPERATURE) where not known.
    pub temperature_c: i8,
    /// Desired positions for the tick in which the torque takes effect.
    #[serde(with = "BigArray")]
    pub desired_q: [Position; N],
    /// Desired velocities.
    #[serde(with = "BigArray")]
    pub desired_qd: [Velocity; N],
    /// Desired accelerations.
    #[serde(with = "BigArray")]
    pub desired_qdd: [Acceleration; N],
    /// Measured positions.
    #[serde(with = "BigArray")]
    pub q: [Position; N],
    /// Measured torques in N·m, or currents in A.
    #[serde(with = "BigArray")]
    pub effort: [Effort; N],
}

impl<const N: usize> SampleFrame<N> {
    /// Temperature that says "not known".
    pub const NO_TEMPERATURE: i8 = i8::MIN;

    /// The frame of a sample whose effort is a torque. Values out of range saturate, NaN stays NaN.
    pub fn new(sample: &JointSample<N>) -> Self {
        let still = JointMeasurement {
            q: JointVector::zeros(),
            tau: JointVector::zeros(),
        };
        let measured = sample.measured.unwrap_or(still);
        let desired = &sample.desired;
        Self {
            flags: match sample.measured {
                Some(_) => SampleFlags::MEASURED,
                None => SampleFlags::default(),
            },
            temperature_c: Self::NO_TEMPERATURE,
            desired_q: array(&desired.q).map(Position::encode),
            desired_qd: array(&desired.qd).map(Velocity::encode),
            desired_qdd: array(&desired.qdd).map(Acceleration::encode),
            q: array(&measured.q).map(Position::encode),
            effort: array(&measured.tau).map(Effort::encode),
        }
    }

    /// The same with motor currents, A, in the place of the measured torques.
    pub fn with_current(mut self, current: &JointVector<N>) -> Self {
        self.flags = SampleFlags(self.flags.0 | SampleFlags::CURRENT.0);
        self.effort = array(current).map(Effort::encode);
        self
    }

    /// The same with the motor temperature of joint `sequence % N`, °C.
    pub fn with_temperature(mut self, temperature_c: i8) -> Self {
        self.temperature_c = temperature_c;
        self
    }

    /// The sample as the tick wants it.
    ///
    /// * `gains` drive gains, N × N·m/A; where one that is needed is not positive, nothing counts as measured
    pub fn sample(&self, gains: &[f32; N]) -> JointSample<N> {
        let current = self.flags.contains(SampleFlags::CURRENT);
        let known = !current || gains.iter().all(|&gain| gain > 0.0);
        let effort = JointVector::from(self.effort.map(Effort::decode));
        let measured =
            (self.flags.contains(SampleFlags::MEASURED) && known).then(|| JointMeasurement {
                q: self.q.map(Position::decode).into(),
                tau: if current {
                    effort.component_mul(&JointVector::from(*gains))
                } else {
                    effort
                },
            });
        JointSample {
            desired: JointMotion {
                q: self.desired_q.map(Position::decode).into(),
                qd: self.desired_qd.map(Velocity::decode).into(),
                qdd: self.desired_qdd.map(Acceleration::decode).into(),
            },
            measured,
        }
    }
}

/// A motion in full precision.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionFrame<const N: usize> {
    /// Positions, rad.
    #[serde(with = "BigArray")]
    pub q: [f32; N],
    /// Velocities, rad/s.
    #[serde(with = "BigArray")]
    pub qd: [f32; N],
    /// Accelerations, rad/s².
    #[serde(with = "BigArray")]
    pub qdd: [f32; N],
}

impl<const N: usize> From<&JointMotion<N>> for MotionFrame<N> {
    fn from(motion: &JointMotion<N>) -> Self {
        Self {
            q: array(&motion.q),
            qd: array(&motion.qd),
            qdd: array(&motion.qdd),
        }
    }
}

impl<const N: usize> From<&MotionFrame<N>> for JointMotion<N> {
    fn from(frame: &MotionFrame<N>) -> Self {
        Self {
            q: frame.q.into(),
            qd: frame.qd.into(),
            qdd: frame.qdd.into(),
        }
    }
}

/// Torque of one tick with the shares of joint `tick % N`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TorqueFrame<const N: usize> {
    /// Counter of the tick.
    #[serde(with = "postcard::fixint::le")]
    pub tick: u32,
    /// [`Flags`] of the tick.
    #[serde(with = "postcard::fixint::le")]
    pub flags: u16,
    /// The torque, N·m, every bit of it.
    #[serde(with = "BigArray")]
    pub total: [f32; N],
    /// Rigid-body, friction and network share of joint `tick % N`, N·m.
    pub shares: [f32; 3],
}

impl<const N: usize> From<&Torque<N>> for TorqueFrame<N> {
    fn from(torque: &Torque<N>) -> Self {
        let joint = torque.tick as usize % N;
        let Shares {
            rigid,
            friction,
            network,
        } = &torque.shares;
        Self {
            tick: torque.tick,
            flags: torque.flags.0,
            total: array(&torque.total),
            shares: [rigid, friction, network]
                .map(|share| share.get(joint).copied().unwrap_or(0.0)),
        }
    }
}

/// Torque of one tick with all shares.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FullTorqueFrame<const N: usize> {
    /// Counter of the tick.
    #[serde(with = "postcard::fixint::le")]
    pub tick: u32,
    /// The torque and its shares.
    pub torque: EvaluatedFrame<N>,
}

impl<const N: usize> From<&Torque<N>> for FullTorqueFrame<N> {
    fn from(torque: &Torque<N>) -> Self {
        Self {
            tick: torque.tick,
            torque: torque.into(),
        }
    }
}

impl<const N: usize> From<&FullTorqueFrame<N>> for Torque<N> {
    fn from(frame: &FullTorqueFrame<N>) -> Self {
        Self {
            tick: frame.tick,
            ..Self::from(&frame.torque)
        }
    }
}

/// A torque and its shares in full precision, N·m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluatedFrame<const N: usize> {
    /// [`Flags`].
    #[serde(with = "postcard::fixint::le")]
    pub flags: u16,
    /// Sum of the shares, after limits where there is a tick.
    #[serde(with = "BigArray")]
    pub total: [f32; N],
    /// Rigid-body share.
    #[serde(with = "BigArray")]
    pub rigid: [f32; N],
    /// Friction share.
    #[serde(with = "BigArray")]
    pub friction: [f32; N],
    /// Network share.
    #[serde(with = "BigArray")]
    pub network: [f32; N],
}

impl<const N: usize> From<&Torque<N>> for EvaluatedFrame<N> {
    fn from(torque: &Torque<N>) -> Self {
        Self {
            flags: torque.flags.0,
            total: array(&torque.total),
            rigid: array(&torque.shares.rigid),
            friction: array(&torque.shares.friction),
            network: array(&torque.shares.network),
        }
    }
}

impl<const N: usize> From<&EvaluatedFrame<N>> for Torque<N> {
    fn from(frame: &EvaluatedFrame<N>) -> Self {
        Self {
            total: frame.total.into(),
            shares: Shares {
                rigid: frame.rigid.into(),
                friction: frame.friction.into(),
                network: frame.network.into(),
            },
            flags: Flags(frame.flags),
            tick: 0,
        }
    }
}

/// What starts a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pacing {
    /// A sample runs a tick and is answered at once.
    Link,
    /// The board's timer runs the tick on the newest sample.
    SysTick,
}

/// How much of the torque is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ReplyMode {
    /// The shares of one joint a tick: [`TorqueFrame`].
    Decimated,
    /// All shares: [`FullTorqueFrame`].
    Full,
}

/// How the board runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configuration {
    /// Period of the tick, µs.
    #[serde(with = "postcard::fixint::le")]
    pub period_us: u32,
    /// What starts a tick.
    pub pacing: Pacing,
    /// How much is answered.
    pub reply: ReplyMode,
}

impl Configuration {
    /// Shortest and longest period, µs: 10 kHz to 10 Hz.
    pub const PERIODS_US: core::ops::RangeInclusive<u32> = 100..=100_000;
}

impl Default for Configuration {
    /// 1 kHz, paced by the link, decimated shares.
    fn default() -> Self {
        Self {
            period_us: 1000,
            pacing: Pacing::Link,
            reply: ReplyMode::Decimated,
        }
    }
}

/// What the cost counter of a board counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CounterKind {
    /// Nothing: costs are zero.
    None,
    /// Cycles of the core.
    Cycles,
    /// Instructions, in an emulator that counts them.
    Instructions,
}

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetReason {
    /// Not known.
    Unknown,
    /// Power came on.
    PowerOn,
    /// The reset pin.
    Pin,
    /// A request in software.
    Software,
    /// The watchdog bit.
    Watchdog,
    /// A panic, kept over the reset.
    Panic,
    /// A fault of the core, kept over the reset.
    Fault,
}

/// What a board can do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capabilities(pub u8);

impl Capabilities {
    /// The board has a timer of its own: [`Pacing::SysTick`] works.
    pub const TIMER: Self = Self(1 << 0);
    /// The board learns.
    pub const LEARNING: Self = Self(1 << 1);

    /// Every capability of `other` is there.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl core::ops::BitOr for Capabilities {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Who a board is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoardHello {
    /// Identity of the arm the firmware was built for.
    #[serde(with = "postcard::fixint::le")]
    pub arm_hash: u32,
    /// Its name.
    pub arm: Name,
    /// Number of joints.
    pub joints: u8,
    /// Number of base parameters.
    pub base_columns: u8,
    /// Version of the firmware.
    pub firmware: Name,
    /// What the board can do.
    pub capabilities: Capabilities,
    /// What its cost counter counts.
    pub counter: CounterKind,
    /// Counts per second.
    #[serde(with = "postcard::fixint::le")]
    pub counter_hz: u32,
    /// How it runs.
    pub configuration: Configuration,
    /// Why it started.
    pub reset_reason: ResetReason,
}

/// Why something was not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum NackReason {
    /// Only while learning is off.
    LearningOn,
    /// The board has no such capability.
    NotCapable,
    /// The period is outside [`Configuration::PERIODS_US`].
    Period,
    /// The chunk does not follow the one before; the next byte wanted is this one.
    Gap {
        /// Offset of the next byte.
        #[serde(with = "postcard::fixint::le")]
        expected: u16,
    },
    /// The bank is longer than the board's room.
    TooLong,
    /// The bytes received are not those that were announced.
    Checksum,
    /// The bank is not one for this board.
    Bank(BankError),
}

impl fmt::Display for NackReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LearningOn => f.write_str("only while learning is off"),
            Self::NotCapable => f.write_str("the board cannot do that"),
            Self::Period => f.write_str("period out of range"),
            Self::Gap { expected } => write!(f, "chunk out of order, byte {expected} is next"),
            Self::TooLong => f.write_str("parameter bank too long"),
            Self::Checksum => f.write_str("parameter bank damaged or incomplete"),
            Self::Bank(error) => write!(f, "{error}"),
        }
    }
}

fn array<const N: usize>(vector: &JointVector<N>) -> [f32; N] {
    (*vector).into()
}
