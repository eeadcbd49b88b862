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
//!         load            check passed         start               at q(0)            stop           at rest
//! Empty ───────► Checking ────────────► Ready ───────► Approaching ───────► Playing ──────► Stopping ───────► Holding
//!                   │ check failed
//!                   └────────────► Refused
//!
//! Approaching, Playing, Stopping ── a limit is exceeded ──► Aborted, which comes to rest on the path
//! Playing ── the last period ends ──► Holding
//! Holding, Aborted at rest ── start ──► Approaching      ── release ──► Ready
//! ```
//! A host runs this code through a board in its own process, so both give the same bits.

mod path;
mod player;

use crate::safety::follow;
use foretorque::arm::{Arm, JointLimits};
use foretorque::joint::{JointMotion, JointVector};
pub use path::{HARMONICS, JointSeries, PreparedSeries};
use path::{STOP_S, STOP_SHARE, stop_s};
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
    /// Certified bounds of the motion, joint by joint: those of its approach and its stop. The arm's own limits abort it.
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
    /// Ticks without a measurement that abort it.
    pub blind_ticks: u32,
}

impl<const N: usize> PlayLimits<N> {
    /// Largest acceleration of any joint, rad/s².
    const ACCELERATION_RAD_S2: f32 = 20.0;
    /// Largest tracking error of a program: half the clearance of a hand between arm and fixture, rad.
    pub const TRACKING_RAD: f32 = 0.1;
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

/// Points of one period that are checked.
const CHECK_POINTS: u32 = 1024;
/// Points a tick: 256 ticks for all of them.
const CHECK_POINTS_A_TICK: u32 = 4;
/// Relative tolerance of the certificate: rounding, and a certificate with six digits.
const SLACK: f32 = 1e-3;
/// Speed, rad/s, and acceleration, rad/s², that count as rest.
const REST: (f32, f32) = (1e-3, 1e-2);

/// Checks everything but the series.
fn check_at_once<const N: usize>(
    program: &ExcitationProgram<N>,
    limits: &PlayLimits<N>,
    arm_hash: u32,
    tick_us: u32,
) -> Result<(), ExcitationError> {
    if program.arm_hash != arm_hash {
        return Err(ExcitationError::WrongArm);
    }
    let most = PlayLimits::<N>::TRACKING_RAD;
    let tracking = program.tracking_rad > 0.0 && program.tracking_rad <= most;
    // A hundred ticks a period: the fifth harmonic needs some of them for its velocity to hold between them.
    if !tracking || program.period_us / 100 < tick_us {
        return Err(ExcitationError::Number(0));
    }
    let joints = program.joints.iter().zip(&program.certificate);
    for (joint, ((series, bounds), allowed)) in joints.zip(&limits.motion).enumerate() {
        if !series.coefficients().all(f32::is_finite) {
            return Err(ExcitationError::Number(joint as u8));
        }
        // A stop within the certified acceleration must not take longer than a host waits for it.
        let stops = stop_s(core::array::from_ref(bounds)) <= STOP_S.1;
        if !(bounds.within(allowed) && stops) {
            return Err(ExcitationError::CertificateBeyondLimits(joint as u8));
        }
    }
    Ok(())
}

/// Checks that the joints rest at the start of the period.
fn check_start<const N: usize>(
    program: &ExcitationProgram<N>,
    series: &PreparedSeries,
) -> Result<(), ExcitationError> {
    let start = series.at(&program.joints, 0);
    for (joint, (qd, qdd)) in start.qd.iter().zip(start.qdd.iter()).enumerate() {
        if !(qd.abs() <= REST.0 && qdd.abs() <= REST.1) {
            return Err(ExcitationError::NotAtRest(joint as u8));
        }
    }
    Ok(())
}

/// Checks point `point` of [`CHECK_POINTS`] and the motion up to the next one against the certificate.
///
/// Between two samples h apart, a function with second derivative ≤ K exceeds the larger one by at most K h² / 8.
fn check_point<const N: usize>(
    program: &ExcitationProgram<N>,
    series: &PreparedSeries,
    point: u32,
) -> Result<(), ExcitationError> {
    let motion = series.at(
        &program.joints,
        point.wrapping_mul(u32::MAX / CHECK_POINTS + 1),
    );
    let between = |joint: &JointSeries| {
        let step_s = program.period_us as f32 * (1e-6 / CHECK_POINTS as f32);
        let part = step_s * step_s / 8.0;
        let swings = joint.a_rad_s.iter().zip(&joint.b_rad_s);
        let mut bound = [0.0; 3];
        for ((a, b), rate) in swings.zip(series.rate) {
            // Bounds of acceleration, jerk and snap, times h² / 8.
            let size = (a.abs() + b.abs()) * part;
            let [qdd, jerk, snap] = &mut bound;
            *qdd += size * rate;
            *jerk += size * rate * rate;
            *snap += size * rate * rate * rate;
        }
        bound
    };
    let joints = program.joints.iter().zip(&program.certificate);
    for (joint, (coefficients, bounds)) in joints.enumerate() {
        if !inside(&motion, joint, bounds, between(coefficients)) {
            return Err(ExcitationError::CertificateBroken(joint as u8));
        }
    }
    Ok(())
}

/// The motion of `joint`, widened by `more`, lies inside `bounds`; false where a value is not finite.
fn inside<const N: usize>(
    motion: &JointMotion<N>,
    joint: usize,
    bounds: &MotionBounds,
    more: [f32; 3],
) -> bool {
    let (Some(q), Some(qd), Some(qdd)) = (
        motion.q.get(joint),
        motion.qd.get(joint),
        motion.qdd.get(joint),
    ) else {
        return false;
    };
    let (low, high) = bounds.position_rad;
    let slack = SLACK * (high - low);
    q - more[0] >= low - slack
        && q + more[0] <= high + slack
        && qd.abs() + more[1] <= bounds.velocity_rad_s * (1.0 + SLACK)
        && qdd.abs() + more[2] <= bounds.acceleration_rad_s2 * (1.0 + SLACK)
}

/// Speed that aborts, parts of the joint's limit.
const OVERSPEED: f32 = 1.2;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Supervision<const N: usize> {
    /// Ticks in a row without a measurement.
    blind: u32,
    /// Position that follows the measured one no faster than [`OVERSPEED`], N × rad. Up to
    /// [`JUMP_MARGIN`](crate::safety::JUMP_MARGIN) between the two is no speed: an encoder has steps.
    followed: Option<JointVector<N>>,
}

impl<const N: usize> Supervision<N> {
    /// The first limit that measured or desired motion exceeds.
    ///
    /// * `desired` desired motion of the tick that is measured
    /// * `tracking` largest tracking error, rad      * `tick_us` period of the tick, µs
    fn exceeded(
        &mut self,
        limits: &PlayLimits<N>,
        desired: &JointMotion<N>,
        measured: Option<&JointVector<N>>,
        tracking: f32,
        tick_us: u32,
    ) -> Option<AbortReason> {
        let Some(measured) = measured else {
            self.blind = self.blind.saturating_add(1);
            self.followed = None;
            return (self.blind > limits.blind_ticks).then_some(AbortReason::Blind);
        };
        self.blind = 0;
        let speeds = limits.motion.iter().map(|bounds| bounds.velocity_rad_s);
        let speeds = JointVector::from_iterator(speeds);
        let tick_s = tick_us as f32 * 1e-6;
        let steps = (&speeds, OVERSPEED * tick_s);
        let fast = follow(steps, &mut self.followed, measured);
        let motion = desired
            .q
            .iter()
            .zip(desired.qd.iter())
            .zip(desired.qdd.iter());
        let joints = measured.iter().zip(motion).zip(&limits.motion);
        for (joint, ((q, ((desired, qd), qdd)), bounds)) in joints.enumerate() {
            let index = joint as u8;
            let (low, high) = bounds.position_rad;
            let inside = |q: f32| q >= low - tracking && q <= high + tracking;
            if !q.is_finite() || !desired.is_finite() {
                return Some(AbortReason::NotFinite(index));
            }
            if !(inside(*q) && inside(*desired)) {
                return Some(AbortReason::Position(index));
            }
            if (q - desired).abs() > tracking {
                return Some(AbortReason::Tracking(index));
            }
            if fast == Some(index) || qd.abs() > OVERSPEED * bounds.velocity_rad_s {
                return Some(AbortReason::Velocity(index));
            }
            if qdd.abs() > (1.0 + STOP_SHARE) * bounds.acceleration_rad_s2 {
                return Some(AbortReason::Acceleration(index));
            }
        }
        None
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
