use super::series::{HARMONICS, JointSeries};
use foretorque::arm::{Arm, JointLimits};
use serde::{Deserialize, Serialize};

/// Bounds of the motion of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionBounds {
    /// Lowest and highest position, rad.
    pub position_rad: (f32, f32),
    /// Largest speed, rad/s.
    pub velocity_rad_s: f32,
    /// Largest acceleration, rad/s².
    pub acceleration_rad_s2: f32,
}

impl MotionBounds {
    /// All bounds lie inside `other`; false where one is not finite.
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

/// Uploaded excitation: coefficients and their certificate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExcitationProgram<const N: usize> {
    /// Identity of its arm.
    #[serde(with = "postcard::fixint::le")]
    pub arm_hash: u32,
    /// Period of the fundamental, µs.
    #[serde(with = "postcard::fixint::le")]
    pub period_us: u32,
    /// Periods to play; 0 until stopped.
    #[serde(with = "postcard::fixint::le")]
    pub periods: u16,
    /// Tracking error at which any joint aborts it, rad.
    pub tracking_rad: f32,
    /// The series, joint by joint.
    #[serde(with = "crate::wire::array")]
    pub joints: [JointSeries; N],
    /// Certified bounds of the motion, joint by joint; leaving them aborts the excitation.
    #[serde(with = "crate::wire::array")]
    pub certificate: [MotionBounds; N],
}

impl<const N: usize> ExcitationProgram<N> {
    /// Length on the wire, B.
    pub const BYTES: usize = 14 + N * 4 * (2 * HARMONICS + 1 + 4);

    /// Encodes it into `buffer` and returns its bytes; `None` where the buffer is shorter than [`BYTES`](Self::BYTES).
    pub fn encode<'r>(&self, buffer: &'r mut [u8]) -> Option<&'r [u8]> {
        postcard::to_slice(self, buffer).ok().map(|bytes| &*bytes)
    }

    /// Decodes one from all of `bytes`.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (program, rest) = postcard::take_from_bytes(bytes).ok()?;
        rest.is_empty().then_some(program)
    }
}

/// Limits of the board for any excitation, whatever its certificate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlayLimits<const N: usize> {
    /// Bounds of the motion.
    pub motion: [MotionBounds; N],
    /// Largest tracking error of a program, rad.
    pub tracking_rad: f32,
    /// Ticks without a measurement that abort it.
    pub blind_ticks: u32,
}

impl<const N: usize> PlayLimits<N> {
    /// Largest acceleration of any joint, rad/s².
    const ACCELERATION_RAD_S2: f32 = 20.0;
    /// Half the clearance of a hand between arm and fixture, rad.
    const TRACKING_RAD: f32 = 0.1;
    /// Time for which the tick holds its torque without samples, s.
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
            motion: A::limits().each_ref().map(bounds),
            tracking_rad: Self::TRACKING_RAD,
            blind_ticks: (Self::BLIND_S * 1e6 / tick_us as f32) as u32 + 1,
        }
    }
}

errors! {
    /// Reason why an excitation is not played.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    pub enum ExcitationError {
        WrongArm = "the excitation belongs to another arm";
        Number of joint = "joint {joint}: coefficient, bound or period cannot be played";
        CertificateBeyondLimits of joint = "joint {joint}: certificate exceeds the arm's limits";
        CertificateBroken of joint = "joint {joint}: series does not keep its certificate";
        NotAtRest of joint = "joint {joint}: series does not start at rest";
        NotLoaded = "no excitation is loaded";
        Running = "an excitation is running: stop it first";
    }
}

errors! {
    /// Reason why an excitation was aborted: a limit of measured or desired motion.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    pub enum AbortReason {
        Position of joint = "joint {joint}: outside its range";
        Velocity of joint = "joint {joint}: too fast";
        /// (Of the desired motion.)
        Acceleration of joint = "joint {joint}: acceleration too high";
        Tracking of joint = "joint {joint}: does not follow";
        /// (For too long.)
        Blind = "no measurements";
        NotFinite of joint = "joint {joint}: a position is not finite";
    }
}

#[cfg(test)]
mod tests {
    use super::super::series::tests::SWING;
    use super::*;

    #[test]
    fn a_program_survives_encoding_and_no_other_length_decodes() {
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
        let mut buffer = [0; 400];
        let bytes = program.encode(&mut buffer).unwrap().to_vec();
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
