//! Content of the messages of a tick.

use super::{Acceleration, Effort, Position, Velocity};
use crate::excitation::ExcitationState;
use crate::safety::SafetyStatus;
use core::hint::black_box;
use foretorque::feedforward::{Shares, Torque};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::limits::Flags;
use serde::{Deserialize, Serialize};

/// Flags of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampleFlags(pub u8);

impl SampleFlags {
    /// Position and effort were measured in this cycle.
    pub const MEASURED: Self = Self(1 << 0);
    /// The effort is motor current in A; the board multiplies it by the drive gain of its bank.
    pub const CURRENT: Self = Self(1 << 1);
    /// The reply waits for the learning step of this tick: for a host without a clock, which sends the next sample as soon
    /// as it has the reply.
    pub const AFTER_LEARNING: Self = Self(1 << 2);
    const PERIOD_SHIFT: u32 = 3;
    /// Modulus of the period numbers.
    pub const PERIODS: u8 = 1 << (u8::BITS - Self::PERIOD_SHIFT);

    /// True if every flag of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Number of the host's period, modulo [`PERIODS`](Self::PERIODS); constant where the host does not count.
    pub const fn period(self) -> u8 {
        self.0 >> Self::PERIOD_SHIFT
    }

    const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Input of one tick.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SampleFrame<const N: usize> {
    /// Flags and period number.
    pub flags: SampleFlags,
    /// Motor temperature of joint `flags.period() % N`, °C, or [`NO_TEMPERATURE`](Self::NO_TEMPERATURE).
    pub temperature_c: i8,
    /// Desired positions for the tick in which the torque takes effect.
    #[serde(with = "super::array")]
    pub desired_q: [Position; N],
    /// Desired velocities.
    #[serde(with = "super::array")]
    pub desired_qd: [Velocity; N],
    /// Desired accelerations.
    #[serde(with = "super::array")]
    pub desired_qdd: [Acceleration; N],
    /// Measured positions.
    #[serde(with = "super::array")]
    pub q: [Position; N],
    /// Measured torques in N·m, or currents in A.
    #[serde(with = "super::array")]
    pub effort: [Effort; N],
}

impl<const N: usize> SampleFrame<N> {
    /// Code of an unknown temperature.
    pub const NO_TEMPERATURE: i8 = i8::MIN;

    /// The frame of a sample whose effort is a torque. Values out of range saturate, NaN stays NaN.
    pub fn new(sample: &JointSample<N>) -> Self {
        let JointSample { desired, measured } = sample;
        let mut frame = Self {
            flags: SampleFlags::default(),
            temperature_c: Self::NO_TEMPERATURE,
            desired_q: encoded(desired.q.as_slice(), Position::encode),
            desired_qd: encoded(desired.qd.as_slice(), Velocity::encode),
            desired_qdd: encoded(desired.qdd.as_slice(), Acceleration::encode),
            q: [Position::default(); N],
            effort: [Effort::default(); N],
        };
        if let Some(measured) = measured {
            frame.flags = SampleFlags::MEASURED;
            frame.q = encoded(measured.q.as_slice(), Position::encode);
            frame.effort = encoded(measured.tau.as_slice(), Effort::encode);
        }
        frame
    }

    /// Replaces the measured torques by motor currents, A.
    pub fn with_current(mut self, current: &JointVector<N>) -> Self {
        self.flags = self.flags.with(SampleFlags::CURRENT);
        self.effort = encoded(current.as_slice(), Effort::encode);
        self
    }

    /// Sets the number of the host's period, modulo [`SampleFlags::PERIODS`].
    pub fn in_period(mut self, number: u8) -> Self {
        let others = self.flags.0 & ((1 << SampleFlags::PERIOD_SHIFT) - 1);
        self.flags = SampleFlags(others | number << SampleFlags::PERIOD_SHIFT);
        self
    }

    /// Requests the reply [after the learning step](SampleFlags::AFTER_LEARNING).
    pub fn answered_after_learning(mut self) -> Self {
        self.flags = self.flags.with(SampleFlags::AFTER_LEARNING);
        self
    }

    /// The sample in the units of the tick. With a measured position or effort at the end of its range, beyond which values
    /// saturate, nothing counts as measured.
    ///
    /// * `gains` drive gains, N × N·m/A; where a required one is not positive, nothing counts as measured, either
    pub fn sample(&self, gains: &[f32; N]) -> JointSample<N> {
        let current = self.flags.contains(SampleFlags::CURRENT);
        let known = !current || gains.iter().all(|&gain| gain > 0.0);
        let effort = decoded(&self.effort, Effort::decode);
        let q = decoded(&self.q, Position::decode);
        let within = |values: &JointVector<N>, most: f32| {
            let values = black_box(values.as_slice());
            !values.iter().any(|value| value.abs() >= most)
        };
        let known = known && within(&effort, Effort::MAX) && within(&q, Position::MAX);
        let measured =
            (self.flags.contains(SampleFlags::MEASURED) && known).then(|| JointMeasurement {
                q,
                tau: if current {
                    effort.component_mul(&JointVector::from(*gains))
                } else {
                    effort
                },
            });
        JointSample {
            desired: JointMotion {
                q: decoded(&self.desired_q, Position::decode),
                qd: decoded(&self.desired_qd, Velocity::decode),
                qdd: decoded(&self.desired_qdd, Acceleration::decode),
            },
            measured,
        }
    }
}

/// A motion in full precision.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionFrame<const N: usize> {
    /// Positions, rad.
    #[serde(with = "super::array")]
    pub q: [f32; N],
    /// Velocities, rad/s.
    #[serde(with = "super::array")]
    pub qd: [f32; N],
    /// Accelerations, rad/s².
    #[serde(with = "super::array")]
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
    /// Safety state and reason.
    pub safety: SafetyStatus,
    /// The torque within the hard limits, N·m.
    #[serde(with = "super::array")]
    pub total: [f32; N],
    /// Rigid-body, friction and network share of joint `tick % N`, N·m.
    pub shares: [f32; 3],
}

impl<const N: usize> TorqueFrame<N> {
    /// The frame of a torque with its status.
    pub fn new(torque: &Torque<N>, safety: SafetyStatus) -> Self {
        let joint = torque.tick as usize % N;
        let shares = &torque.shares;
        Self {
            tick: torque.tick,
            flags: torque.flags.0,
            safety,
            total: array(&torque.total),
            shares: [&shares.rigid, &shares.friction, &shares.network]
                .map(|share| share.get(joint).copied().unwrap_or(0.0)),
        }
    }
}

/// Torque of one tick of an excitation, with its desired motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExcitedFrame<const N: usize> {
    /// The torque, and the shares of one joint.
    pub torque: TorqueFrame<N>,
    /// State of the excitation.
    pub state: ExcitationState,
    /// Desired positions of the tick in which the torque takes effect.
    #[serde(with = "super::array")]
    pub q: [Position; N],
    /// Desired velocities.
    #[serde(with = "super::array")]
    pub qd: [Velocity; N],
    /// Desired accelerations.
    #[serde(with = "super::array")]
    pub qdd: [Acceleration; N],
}

impl<const N: usize> ExcitedFrame<N> {
    /// The frame of `torque` and its desired motion.
    pub fn new(torque: TorqueFrame<N>, state: ExcitationState, desired: &JointMotion<N>) -> Self {
        Self {
            torque,
            state,
            q: encoded(desired.q.as_slice(), Position::encode),
            qd: encoded(desired.qd.as_slice(), Velocity::encode),
            qdd: encoded(desired.qdd.as_slice(), Acceleration::encode),
        }
    }

    /// The desired motion, at the resolution of the frame.
    pub fn desired(&self) -> JointMotion<N> {
        JointMotion {
            q: decoded(&self.q, Position::decode),
            qd: decoded(&self.qd, Velocity::decode),
            qdd: decoded(&self.qdd, Acceleration::decode),
        }
    }
}

/// Torque of one tick with all shares.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FullTorqueFrame<const N: usize> {
    /// Counter of the tick.
    #[serde(with = "postcard::fixint::le")]
    pub tick: u32,
    /// Safety state and reason.
    pub safety: SafetyStatus,
    /// The torque and its shares.
    pub torque: EvaluatedFrame<N>,
}

impl<const N: usize> FullTorqueFrame<N> {
    /// The frame of a torque with its status.
    pub fn new(torque: &Torque<N>, safety: SafetyStatus) -> Self {
        Self {
            tick: torque.tick,
            safety,
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
    #[serde(with = "super::array")]
    pub total: [f32; N],
    /// Rigid-body share.
    #[serde(with = "super::array")]
    pub rigid: [f32; N],
    /// Friction share.
    #[serde(with = "super::array")]
    pub friction: [f32; N],
    /// Network share.
    #[serde(with = "super::array")]
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

fn array<const N: usize>(vector: &JointVector<N>) -> [f32; N] {
    (*vector).into()
}

/// Codes of a vector. A function of its own, because `array::map` is inlined everywhere.
#[inline(never)]
fn encoded<T: Copy + Default, const N: usize>(values: &[f32], encode: impl Fn(f32) -> T) -> [T; N] {
    let mut codes = [T::default(); N];
    for (code, &value) in codes.iter_mut().zip(values) {
        *code = encode(value);
    }
    codes
}

#[inline(never)]
fn decoded<T: Copy, const N: usize>(codes: &[T; N], decode: impl Fn(T) -> f32) -> JointVector<N> {
    let mut values = JointVector::<N>::zeros();
    // Hides the length from the compiler, which would unroll the loop into 1 kB of flash.
    for (value, &code) in values
        .as_mut_slice()
        .iter_mut()
        .zip(black_box(codes.as_slice()))
    {
        *value = decode(code);
    }
    values
}
