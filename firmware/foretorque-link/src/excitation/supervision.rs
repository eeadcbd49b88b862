use super::path_speed::STOP_SHARE;
use super::program::{AbortReason, PlayLimits};
use foretorque::joint::{JointMotion, JointVector};

/// Measured speed that aborts, parts of the joint's limit: encoder noise adds to the speed.
const OVERSPEED: f32 = 1.2;

/// Supervision of the measured and desired motion while an excitation plays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Supervision<const N: usize> {
    /// Ticks in a row without a measurement.
    blind: u32,
    /// Measured position of the tick before.
    before: Option<JointVector<N>>,
}

impl<const N: usize> Supervision<N> {
    /// Before the first measurement.
    pub(super) const fn new() -> Self {
        Self {
            blind: 0,
            before: None,
        }
    }

    /// Restarts the count of ticks without a measurement.
    pub(super) fn restart(&mut self) {
        self.blind = 0;
    }

    /// Keeps the measured position for the next tick.
    pub(super) fn record(&mut self, measured: Option<JointVector<N>>) {
        self.before = measured;
    }

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
