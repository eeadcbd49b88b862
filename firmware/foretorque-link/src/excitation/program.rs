use super::series::{HARMONICS, JointSeries};
use core::fmt;
use foretorque::arm::{Arm, JointLimits};
use serde::{Deserialize, Serialize};

/// What the motion of one joint keeps to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionBounds {
    /// Lowest and highest position, rad.
    pub position_rad: (f32, f32),
    /// Largest speed, rad/s.
    pub velocity_rad_s: f32,
    /// Largest acceleration, rad/s².
    pub acceleration_rad_s2: f32,
}

impl MotionBounds {
    /// Everything in here lies inside `other`; false where a number is none.
    pub(super) fn within(&self, other: &Self) -> bool {
        let (low, high) = self.position_rad;
        low >= other.position_rad.0
            && high <= other.position_rad.1
            && low <= high
            && self.velocity_rad_s > 0.0
            && self.velocity_rad_s <= other.velocity_rad_s
            && self.acceleration_rad_s2 > 0.0
            && self.acceleration_rad_s2 <= other.acceleration_rad_s2
    }
}

/// An excitation as it is uploaded: coefficients, and what they were certified to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExcitationProgram<const N: usize> {
    /// Identity of the arm it was made for.
    pub arm_hash: u32,
    /// Period of the fundamental, µs.
    pub period_us: u32,
    /// Periods to play; 0 until stopped.
    pub periods: u16,
    /// Tracking error of any joint at which it is aborted, rad.
    pub tracking_rad: f32,
    /// The series, joint by joint.
    pub joints: [JointSeries; N],
    /// The certificate: what the motion keeps to, joint by joint. Left at any time, the excitation is aborted.
    pub certificate: [MotionBounds; N],
}

/// What comes before the joints on the wire.
#[derive(Serialize, Deserialize)]
struct Head {
    #[serde(with = "postcard::fixint::le")]
    arm_hash: u32,
    #[serde(with = "postcard::fixint::le")]
    period_us: u32,
    #[serde(with = "postcard::fixint::le")]
    periods: u16,
    tracking_rad: f32,
}

impl<const N: usize> ExcitationProgram<N> {
    /// Length on the wire, B.
    pub const BYTES: usize = 14 + N * 4 * (2 * HARMONICS + 1 + 4);

    /// Nothing: all joints rest in zero, and no board takes it.
    pub const EMPTY: Self = Self {
        arm_hash: 0,
        period_us: 0,
        periods: 0,
        tracking_rad: 0.0,
        joints: [JointSeries::ZERO; N],
        certificate: [MotionBounds {
            position_rad: (0.0, 0.0),
            velocity_rad_s: 0.0,
            acceleration_rad_s2: 0.0,
        }; N],
    };

    /// Writes it into `room` and returns its bytes; `None` where there are fewer than [`BYTES`](Self::BYTES).
    pub fn encode<'r>(&self, room: &'r mut [u8]) -> Option<&'r [u8]> {
        let head = Head {
            arm_hash: self.arm_hash,
            period_us: self.period_us,
            periods: self.periods,
            tracking_rad: self.tracking_rad,
        };
        let mut at = postcard::to_slice(&head, room).ok()?.len();
        for series in &self.joints {
            at += postcard::to_slice(series, room.get_mut(at..)?).ok()?.len();
        }
        for bounds in &self.certificate {
            at += postcard::to_slice(bounds, room.get_mut(at..)?).ok()?.len();
        }
        room.get(..at)
    }

    /// Reads it from all of `bytes`; `None` where they are not just one.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (head, mut rest): (Head, _) = postcard::take_from_bytes(bytes).ok()?;
        let mut program = Self {
            arm_hash: head.arm_hash,
            period_us: head.period_us,
            periods: head.periods,
            tracking_rad: head.tracking_rad,
            ..Self::EMPTY
        };
        // One by one: reading an array of structs at once leaves a branch that panics.
        for series in &mut program.joints {
            (*series, rest) = postcard::take_from_bytes(rest).ok()?;
        }
        for bounds in &mut program.certificate {
            (*bounds, rest) = postcard::take_from_bytes(rest).ok()?;
        }
        rest.is_empty().then_some(program)
    }
}

/// What the board lets any excitation do, whatever its certificate says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlayLimits<const N: usize> {
    /// Bounds of the motion.
    pub motion: [MotionBounds; N],
    /// Largest tracking error that a program may allow itself, rad.
    pub tracking_rad: f32,
    /// Ticks without a measurement before it is aborted.
    pub blind_ticks: u32,
}

impl<const N: usize> PlayLimits<N> {
    /// No arm is excited harder than this, rad/s².
    const ACCELERATION_RAD_S2: f32 = 20.0;
    /// Half of what a hand between arm and fixture needs.
    const TRACKING_RAD: f32 = 0.1;
    /// As long as the tick holds its torque without samples.
    const BLIND_S: f32 = 0.01;

    /// Data-sheet limits of position and speed, 20 rad/s², 0.1 rad of tracking error, 10 ms without a measurement.
    ///
    /// * `tick_us` period of the tick, µs
    pub fn for_arm<A: Arm<N, P>, const P: usize>(tick_us: u32) -> Self {
        let bounds = |limits: &JointLimits| MotionBounds {
            position_rad: limits.position,
            velocity_rad_s: limits.velocity,
            acceleration_rad_s2: Self::ACCELERATION_RAD_S2,
        };
        Self {
            motion: A::LIMITS.each_ref().map(bounds),
            tracking_rad: Self::TRACKING_RAD,
            blind_ticks: (Self::BLIND_S * 1e6 / tick_us as f32) as u32 + 1,
        }
    }
}

/// Why an excitation is not played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ExcitationError {
    /// It was made for another arm.
    WrongArm,
    /// A coefficient, bound or period is no number that can be played; joint from 0.
    Number(u8),
    /// The certificate exceeds what this board lets the joint do.
    CertificateBeyondLimits(u8),
    /// The series does not keep what its certificate says.
    CertificateBroken(u8),
    /// The series does not rest at its beginning.
    NotAtRest(u8),
    /// There is none.
    NotLoaded,
    /// One is being played: stop it first.
    Running,
}

impl fmt::Display for ExcitationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let joint = |joint: &u8| u16::from(*joint) + 1;
        match self {
            Self::WrongArm => f.write_str("the excitation was made for another arm"),
            Self::Number(j) => write!(
                f,
                "joint {}: coefficient, bound or period cannot be played",
                joint(j)
            ),
            Self::CertificateBeyondLimits(j) => {
                write!(
                    f,
                    "joint {}: certificate exceeds the arm's limits",
                    joint(j)
                )
            }
            Self::CertificateBroken(j) => {
                write!(
                    f,
                    "joint {}: series does not keep its certificate",
                    joint(j)
                )
            }
            Self::NotAtRest(j) => write!(f, "joint {}: series does not begin at rest", joint(j)),
            Self::NotLoaded => f.write_str("no excitation is loaded"),
            Self::Running => f.write_str("an excitation is running: stop it first"),
        }
    }
}

impl core::error::Error for ExcitationError {}

/// Why an excitation was broken off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AbortReason {
    /// A joint was measured outside the limits of its position, or asked there; joint from 0.
    Position(u8),
    /// A joint was faster than its limit, or asked to be.
    Velocity(u8),
    /// A joint was asked to accelerate beyond its limit.
    Acceleration(u8),
    /// A joint did not follow.
    Tracking(u8),
    /// No measurement came for too long.
    Blind,
    /// A measurement was not a number.
    NotFinite(u8),
}

impl fmt::Display for AbortReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let joint = |joint: &u8| u16::from(*joint) + 1;
        match self {
            Self::Position(j) => write!(f, "joint {} left its range", joint(j)),
            Self::Velocity(j) => write!(f, "joint {} was too fast", joint(j)),
            Self::Acceleration(j) => write!(f, "joint {} accelerated too hard", joint(j)),
            Self::Tracking(j) => write!(f, "joint {} did not follow", joint(j)),
            Self::Blind => f.write_str("no measurements"),
            Self::NotFinite(j) => write!(f, "joint {} was measured as no number", joint(j)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::series::tests::SWING;
    use super::*;

    #[test]
    fn a_program_comes_back_and_a_byte_more_or_less_does_not() {
        let bounds = MotionBounds {
            position_rad: (-1.0, 2.0),
            velocity_rad_s: 3.0,
            acceleration_rad_s2: 4.0,
        };
        let program = ExcitationProgram {
            arm_hash: 0xdead_beef,
            period_us: 10_000_000,
            periods: 3,
            tracking_rad: 0.05,
            joints: [SWING; 6],
            certificate: [bounds; 6],
        };
        let mut room = [0; 400];
        let bytes = program.encode(&mut room).unwrap().to_vec();
        assert_eq!(bytes.len(), ExcitationProgram::<6>::BYTES);
        assert_eq!(ExcitationProgram::decode(&bytes), Some(program));
        assert_eq!(ExcitationProgram::<7>::decode(&bytes), None);
        let longer = [&bytes[..], &[0]].concat();
        for wrong in [&bytes[1..], &bytes[..bytes.len() - 1], &longer] {
            assert_eq!(ExcitationProgram::<6>::decode(wrong), None);
        }
        assert_eq!(program.encode(&mut [0; 373]), None);
    }
}
