//! Check of an uploaded excitation: parameters at once, the series point by point over the ticks. Supervision while it plays.

use super::path::{JointSeries, PreparedSeries, STOP_S, STOP_SHARE, stop_s};
use super::{AbortReason, ExcitationError, ExcitationProgram, MotionBounds, PlayLimits};
use foretorque::joint::{JointMotion, JointVector};

/// Points of one period that are checked.
pub(super) const POINTS: u32 = 1024;
/// Points a tick: 256 ticks for all of them.
pub(super) const POINTS_A_TICK: u32 = 4;
/// Relative tolerance of the certificate: rounding, and a certificate with six digits.
const SLACK: f32 = 1e-3;
/// Speed, rad/s, and acceleration, rad/s², that count as rest.
const REST: (f32, f32) = (1e-3, 1e-2);

/// Checks everything but the series.
pub(super) fn at_once<const N: usize>(
    program: &ExcitationProgram<N>,
    limits: &PlayLimits<N>,
    arm_hash: u32,
    tick_us: u32,
) -> Result<(), ExcitationError> {
    if program.arm_hash != arm_hash {
        return Err(ExcitationError::WrongArm);
    }
    let tracking = program.tracking_rad > 0.0 && program.tracking_rad <= limits.tracking_rad;
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
pub(super) fn starts_at_rest<const N: usize>(
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

/// Checks point `point` of [`POINTS`] and the motion up to the next one against the certificate.
///
/// Between two samples h apart, a function with second derivative ≤ K exceeds the larger one by at most K h² / 8.
pub(super) fn point<const N: usize>(
    program: &ExcitationProgram<N>,
    series: &PreparedSeries,
    point: u32,
) -> Result<(), ExcitationError> {
    let motion = series.at(&program.joints, point.wrapping_mul(u32::MAX / POINTS + 1));
    let between = |joint: &JointSeries| {
        let step_s = program.period_us as f32 * (1e-6 / POINTS as f32);
        let part = step_s * step_s / 8.0;
        let swings = joint.a_rad_s.iter().zip(&joint.b_rad_s);
        let mut bound = [0.0; 3];
        for ((a, b), rate) in swings.zip(series.rates()) {
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
        let [q_more, qd_more, qdd_more] = between(coefficients);
        let kept = inside(&motion, joint, bounds, [q_more, qd_more, qdd_more]);
        if !kept {
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

/// Measured speed that aborts, parts of the joint's limit: encoder noise adds to the speed.
const OVERSPEED: f32 = 1.2;

/// Supervision of the measured and desired motion while an excitation plays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Supervision<const N: usize> {
    /// Ticks in a row without a measurement.
    pub(super) blind: u32,
    /// Measured position of the tick before.
    pub(super) before: Option<JointVector<N>>,
}

impl<const N: usize> Supervision<N> {
    /// The first limit that measured or desired motion exceeds.
    ///
    /// * `desired` desired motion of the tick that is measured
    /// * `tracking` largest tracking error, rad      * `tick_us` period of the tick, µs
    pub(super) fn exceeded(
        &mut self,
        limits: &PlayLimits<N>,
        desired: &JointMotion<N>,
        measured: Option<&JointVector<N>>,
        tracking: f32,
        tick_us: u32,
    ) -> Option<AbortReason> {
        let Some(measured) = measured else {
            self.blind = self.blind.saturating_add(1);
            return (self.blind > limits.blind_ticks).then_some(AbortReason::Blind);
        };
        self.blind = 0;
        let tick_s = tick_us as f32 * 1e-6;
        let before = self.before.as_ref();
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
            let moved = before.and_then(|before| before.get(joint));
            let moved = moved.map_or(0.0, |before| (q - before).abs());
            let fastest = OVERSPEED * bounds.velocity_rad_s;
            if moved > fastest * tick_s || qd.abs() > fastest {
                return Some(AbortReason::Velocity(index));
            }
            if qdd.abs() > (1.0 + STOP_SHARE) * bounds.acceleration_rad_s2 {
                return Some(AbortReason::Acceleration(index));
            }
        }
        None
    }
}
