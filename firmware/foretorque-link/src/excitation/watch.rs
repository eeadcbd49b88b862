use super::path_speed::STOP_SHARE;
use super::program::{AbortReason, PlayLimits};
use foretorque::joint::{JointMotion, JointVector};

/// Measured speed that is too fast, in units of the joint's limit: encoder noise sits on top of it.
const OVERSPEED: f32 = 1.2;

/// Watches the arm, and what is asked of it, while an excitation is played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Watch<const N: usize> {
    /// Ticks in a row without a measurement.
    blind: u32,
    /// What was measured in the tick before.
    before: Option<JointVector<N>>,
}

impl<const N: usize> Watch<N> {
    /// Has seen nothing.
    pub(super) const fn new() -> Self {
        Self {
            blind: 0,
            before: None,
        }
    }

    /// A new excitation has had no tick without a measurement.
    pub(super) fn restart(&mut self) {
        self.blind = 0;
    }

    /// Remembers what was measured in this tick for the next one.
    pub(super) fn note(&mut self, measured: Option<JointVector<N>>) {
        self.before = measured;
    }

    /// The first limit that measurement or motion breaks.
    ///
    /// * `asked` what was asked of the arm for the tick that is measured
    /// * `tracking` largest tracking error, rad      * `tick_us` period of the tick, µs
    pub(super) fn broken(
        &mut self,
        limits: &PlayLimits<N>,
        asked: &JointMotion<N>,
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
        let motion = asked.q.iter().zip(asked.qd.iter()).zip(asked.qdd.iter());
        let joints = measured.iter().zip(motion).zip(&limits.motion);
        for (joint, ((q, ((asked, qd), qdd)), bounds)) in joints.enumerate() {
            let index = joint as u8;
            let (low, high) = bounds.position_rad;
            let inside = |q: f32| q >= low - tracking && q <= high + tracking;
            if !q.is_finite() || !asked.is_finite() {
                return Some(AbortReason::NotFinite(index));
            }
            if !(inside(*q) && inside(*asked)) {
                return Some(AbortReason::Position(index));
            }
            if (q - asked).abs() > tracking {
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
