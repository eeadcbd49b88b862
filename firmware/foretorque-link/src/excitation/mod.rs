//! Excitation played by the board, as a commissioning step: the finite Fourier series of eq. 17 in f32. The board checks an
//! upload against its certificate and aborts it at limits of its own.
//!
//! ```text
//! q(t)   = q0 + Σ_l a_l / (ω l) sin(ω l t) − b_l / (ω l) cos(ω l t)          ω = 2 π / period, l = 1 … 5
//! qd(t)  =      Σ_l a_l cos(ω l t) + b_l sin(ω l t)
//! qdd(t) =      Σ_l ω l (b_l cos(ω l t) − a_l sin(ω l t))
//! ```
//! The position line is eq. 17 as printed; velocity and acceleration are its derivatives, which the printed ones are not.
//!
//! ```text
//!            load            start, check passed      at q(0)          stop, end, or a limit
//!   Empty ────────► Loaded ─────────────────► Approaching ──► Playing ────────────────► Holding / Aborted
//!                     │ check failed                              (path speed ramped to zero)     │ start: from the beginning
//!                     └────────► Refused                                                          └ release: Loaded
//! ```
//! A host runs this code through a board in its own process, so both give the same bits.

mod check;
mod path;
mod player;

use foretorque::arm::{Arm, JointLimits};
pub use path::{HARMONICS, JointSeries, PreparedSeries};
pub use player::Player;
use serde::{Deserialize, Serialize};

/// State of an excitation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ExcitationState {
    /// None is loaded.
    Empty,
    /// The check runs, some points a tick.
    Checking,
    /// It may be started.
    Ready,
    /// It failed the check.
    Refused(ExcitationError),
    /// Moves from the position of the arm to the start of the series.
    Approaching,
    /// Plays the series.
    Playing,
    /// Comes to rest on the path, after a stop.
    Stopping,
    /// At rest; still decides the desired motion.
    Holding,
    /// A limit was exceeded: comes to rest, or is at rest; still decides the desired motion.
    Aborted(AbortReason),
}

impl ExcitationState {
    /// The player decides the desired motion.
    pub const fn is_active(self) -> bool {
        matches!(
            self,
            Self::Approaching | Self::Playing | Self::Stopping | Self::Holding | Self::Aborted(_)
        )
    }
}

/// Commands to the player.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExcitationCommand {
    /// Report the state.
    Status,
    /// Start after the check, from where the host holds the arm, in the next tick with a measurement.
    Start,
    /// Come to rest on the path.
    Stop,
    /// Return the desired motion to the host. Only at rest.
    Release,
}

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
    fn within(&self, other: &Self) -> bool {
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
    use super::path::tests::SWING;
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
