use super::{SafetyLimits, SafetyReason};
use foretorque::joint::{JointSample, JointVector};
use foretorque::limits::cut;

/// Positions that follow those of the samples no faster than a joint moves, for the check of the next sample.
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
    /// A position may be [`jump_margin`](SafetyLimits::jump_margin) ahead of one that moves at the highest plausible speed:
    /// a single step uses the margin up, and a speed above that one exceeds it soon. A position that jumps and stays is
    /// refused once, one that alternates at every jump.
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
        let jumped = finite && follow(limits, &mut self.desired, &desired.q, periods);
        Verdict {
            desired: first(&[
                (!finite, SafetyReason::DesiredNotFinite),
                (jumped, SafetyReason::DesiredJump),
            ]),
            measured: self.check_measured(limits, sample, periods),
        }
    }

    /// Position measured last, N × rad, to the margin of a jump.
    pub(super) fn measured_q(&self) -> Option<&JointVector<N>> {
        self.measured.as_ref()
    }

    /// The measured position of every joint, or that measured last, lies within `distance`, rad, of the desired one.
    pub(super) fn near(&self, sample: &JointSample<N>, distance: f32) -> bool {
        let measured = sample.measured.as_ref().map(|measured| &measured.q);
        measured.or(self.measured.as_ref()).is_some_and(|measured| {
            let mut joints = sample.desired.q.iter().zip(measured.iter());
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
        let jumped = follow(limits, &mut self.measured, &measured.q, periods);
        let strong = measured
            .tau
            .iter()
            .zip(limits.effort.iter())
            .any(|(tau, most)| tau.abs() > *most);
        first(&[
            (outside, SafetyReason::PositionRange),
            (jumped, SafetyReason::PositionJump),
            (strong, SafetyReason::EffortRange),
        ])
    }
}

/// Moves `position` to `now` by no more than a joint can; true when the rest is a jump. Then it is at `now` all the same.
// Has two callers, which share one copy.
#[inline(never)]
fn follow<const N: usize>(
    limits: &SafetyLimits<N>,
    position: &mut Option<JointVector<N>>,
    now: &JointVector<N>,
    periods: f32,
) -> bool {
    let position = position.get_or_insert(*now);
    let mut jumped = false;
    let joints = position.iter_mut().zip(now.iter());
    for ((position, &now), step) in joints.zip(limits.step_per_tick.iter()) {
        let (step, behind) = cut(now - *position, step * periods);
        *position = if behind { *position + step } else { now };
        jumped |= (now - *position).abs() > limits.jump_margin;
    }
    if jumped {
        *position = *now;
    }
    jumped
}

fn all_finite<const N: usize>(vector: &JointVector<N>) -> bool {
    vector.iter().all(|value| value.is_finite())
}

/// The first reason whose condition holds.
fn first(conditions: &[(bool, SafetyReason)]) -> SafetyReason {
    let found = conditions.iter().find(|(holds, _)| *holds);
    found.map_or(SafetyReason::None, |(_, reason)| *reason)
}
