use super::{SafetyLimits, SafetyReason};
use foretorque::joint::{JointSample, JointVector};

/// Positions of the last sample, for the check of the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlausibilityState<const N: usize> {
    desired: Option<JointVector<N>>,
    measured: Option<JointVector<N>>,
}

/// Faults of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Verdict {
    /// Of the desired motion; the sample is then not usable.
    pub(super) desired: SafetyReason,
    /// Of the measurement, which is then dropped.
    pub(super) measured: SafetyReason,
}

impl<const N: usize> PlausibilityState<N> {
    /// Before the first sample.
    pub(super) const fn new() -> Self {
        Self {
            desired: None,
            measured: None,
        }
    }

    /// Checks a sample that arrived `periods` after the one before.
    ///
    /// A position is compared with the last one received, plausible or not: one that jumps and stays is refused once,
    /// one that alternates at every jump.
    pub(super) fn check(
        &mut self,
        limits: &SafetyLimits<N>,
        sample: &JointSample<N>,
        periods: u32,
    ) -> Verdict {
        // After a second any position is plausible; the product stays small enough to be exact.
        let periods = periods.clamp(1, 10_000) as f32;
        let desired = &sample.desired;
        let finite = all_finite(&desired.q) && all_finite(&desired.qd) && all_finite(&desired.qdd);
        let jumped = finite && jumps(limits, &self.desired, &desired.q, periods);
        if finite {
            self.desired = Some(desired.q);
        }
        Verdict {
            desired: first(&[
                (!finite, SafetyReason::DesiredNotFinite),
                (jumped, SafetyReason::DesiredJump),
            ]),
            measured: self.check_measured(limits, sample, periods),
        }
    }

    /// The last measured position of every joint lies within `distance`, rad, of `desired`.
    pub(super) fn near(&self, desired: &JointVector<N>, distance: f32) -> bool {
        self.measured.is_some_and(|measured| {
            let mut joints = desired.iter().zip(measured.iter());
            joints.all(|(desired, measured)| (desired - measured).abs() <= distance)
        })
    }

    fn check_measured(
        &mut self,
        limits: &SafetyLimits<N>,
        sample: &JointSample<N>,
        periods: f32,
    ) -> SafetyReason {
        let Some(measured) = &sample.measured else {
            return SafetyReason::None;
        };
        let finite = all_finite(&measured.q) && all_finite(&measured.tau);
        if !finite {
            return SafetyReason::MeasuredNotFinite;
        }
        let outside = measured
            .q
            .iter()
            .zip(limits.lowest.iter().zip(limits.highest.iter()))
            .any(|(q, (lowest, highest))| q < lowest || q > highest);
        let jumped = jumps(limits, &self.measured, &measured.q, periods);
        let strong = measured
            .tau
            .iter()
            .zip(limits.effort.iter())
            .any(|(tau, most)| tau.abs() > *most);
        self.measured = Some(measured.q);
        first(&[
            (outside, SafetyReason::PositionRange),
            (jumped, SafetyReason::PositionJump),
            (strong, SafetyReason::EffortRange),
        ])
    }
}

fn jumps<const N: usize>(
    limits: &SafetyLimits<N>,
    before: &Option<JointVector<N>>,
    now: &JointVector<N>,
    periods: f32,
) -> bool {
    let Some(before) = before else { return false };
    now.iter()
        .zip(before.iter())
        .zip(limits.step_per_tick.iter())
        .any(|((now, before), step)| (now - before).abs() > step * periods + limits.jump_margin)
}

fn all_finite<const N: usize>(vector: &JointVector<N>) -> bool {
    vector.iter().all(|value| value.is_finite())
}

/// The first reason whose condition holds.
fn first(conditions: &[(bool, SafetyReason)]) -> SafetyReason {
    let found = conditions.iter().find(|(holds, _)| *holds);
    found.map_or(SafetyReason::None, |(_, reason)| *reason)
}
