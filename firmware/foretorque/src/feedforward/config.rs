use crate::arm::{Arm, JointLimits};
use crate::learning::{ConfigError, payload_bound};

/// How the tick behaves; derived from the arm's limits and the period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardConfig<const N: usize> {
    /// Limits of the joints; a desired motion outside them is cut to them, a torque too.
    pub limits: [JointLimits; N],
    /// Largest plausible desired acceleration, rad/s²; beyond it the motion is cut.
    pub acceleration_limit: f32,
    /// Largest change of the torque in one tick, N × N·m.
    pub slew_per_tick: [f32; N],
    /// Largest torque of a payload, N × N·m.
    pub payload_bound: [f32; N],
    /// Largest change in one tick of all that was learnt since the committed set, the payload included, N × N·m.
    pub learned_slew_per_tick: [f32; N],
    /// Ticks for which the torque is held when no usable sample comes; then it goes to zero at the slew limit.
    pub hold_ticks: u32,
}

/// Defaults of the tick: from zero to the torque limit in 20 ms, torque held for 10 ms without samples.
const SLEW_TIME_S: f32 = 0.02;
const HOLD_TIME_US: u32 = 10_000;
const ACCELERATION_LIMIT: f32 = 100.0;
/// Largest step of what was learnt, in units of the torque limit.
const LEARNED_STEP: f32 = 0.01;

impl<const N: usize> FeedForwardConfig<N> {
    /// Defaults for an arm: its data-sheet limits, the full torque in 20 ms, 10 ms of holding.
    ///
    /// * `period_s` period of the tick, s
    pub fn for_arm<A: Arm<N, P>, const P: usize>(period_s: f32) -> Self {
        let torques = A::limits().map(|limits| limits.torque);
        Self {
            limits: *A::limits(),
            acceleration_limit: ACCELERATION_LIMIT,
            slew_per_tick: torques.map(|torque| torque * period_s / SLEW_TIME_S),
            payload_bound: payload_bound::<A, N, P>(),
            learned_slew_per_tick: torques.map(|torque| LEARNED_STEP * torque),
            // At least one tick: a single lost sample must not make the torque dip.
            hold_ticks: HOLD_TIME_US / whole_us(period_s) + 1,
        }
    }

    /// Every field is usable.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check(&[("acceleration_limit", self.acceleration_limit)])?;
        for joint in 0..N {
            let limits = &self.limits[joint];
            check(&[
                ("limits.torque", limits.torque),
                ("limits.velocity", limits.velocity),
                ("limits.position", limits.position.1 - limits.position.0),
                ("slew_per_tick", self.slew_per_tick[joint]),
                ("payload_bound", self.payload_bound[joint]),
                ("learned_slew_per_tick", self.learned_slew_per_tick[joint]),
            ])?;
        }
        Ok(())
    }
}

/// Every value is positive and finite; the error names the first field that is not.
#[inline(never)]
fn check(fields: &[(&'static str, f32)]) -> Result<(), ConfigError> {
    let works = |value: f32| value > 0.0 && value.is_finite();
    let bad = fields.iter().find(|(_, value)| !works(*value));
    bad.map_or(Ok(()), |(field, _)| Err(ConfigError::NotPositive(field)))
}

/// `period_s`, s, in whole µs, at least 1: a quotient of seconds in f32 may lack its last tick.
const fn whole_us(period_s: f32) -> u32 {
    let us = (period_s * 1e6 + 0.5) as u32;
    if us == 0 { 1 } else { us }
}
