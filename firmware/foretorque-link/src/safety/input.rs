use super::{JUMP_MARGIN, SafetyLimits, SafetyReason};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::limits::cut;

/// Fresh, plausible samples in a row that arming requires.
pub const ARM_SAMPLES: u32 = 3;
/// Largest distance between desired and measured position at arming and while armed, rad.
pub const ARM_DISTANCE: f32 = 0.2;
/// Weight of an implausible sample; a plausible one takes back 1. So one in five is too many.
const IMPLAUSIBLE_WEIGHT: u32 = 4;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct InputState<const N: usize> {
    /// Fault of the input of this tick.
    pub(super) fault: SafetyReason,
    /// Plausible samples in a row, without a time-out between them.
    good_samples: u32,
    /// Periods since the last usable sample.
    since_usable: u32,
    /// Periods since the last sample, usable or not.
    since_sample: u32,
    /// Periods since the last plausible measurement.
    since_measured: u32,
    /// Weighted count of implausible samples, less the plausible ones.
    implausible_score: u32,
    /// Samples of which a part was implausible.
    pub(super) implausible: u32,
    /// Samples in a row whose desired position is far from the one measured.
    far_samples: u32,
    /// The desired position of the last usable sample is near the one measured last.
    near: bool,
    /// Desired position that follows those of the samples no faster than a joint moves, N × rad.
    desired: Option<JointVector<N>>,
    /// Position measured last, likewise.
    measured: Option<JointVector<N>>,
    /// Position of the last plausible measurement, N × rad.
    pub(super) plausible: Option<JointVector<N>>,
}

impl<const N: usize> InputState<N> {
    /// No usable sample arrived for too long.
    pub(super) fn timed_out(&self, limits: &SafetyLimits<N>) -> bool {
        self.since_usable >= limits.timeout_ticks
    }

    /// Reason of the input to end a torque that flows, and whether it latches.
    pub(super) fn ends_torque(&self, limits: &SafetyLimits<N>) -> Option<(SafetyReason, bool)> {
        if self.implausible_score >= IMPLAUSIBLE_WEIGHT * limits.timeout_ticks {
            Some((self.fault, true))
        } else if self.timed_out(limits) {
            Some((SafetyReason::CommandTimeout, false))
        } else if self.since_measured >= limits.measurement_ticks {
            Some((SafetyReason::MeasurementTimeout, false))
        } else if self.far_samples >= limits.timeout_ticks {
            Some((SafetyReason::FollowingError, true))
        } else {
            None
        }
    }

    pub(super) fn clear_counts(&mut self) {
        self.implausible_score = 0;
        self.far_samples = 0;
    }

    /// Errors: the reason against arming on the samples so far.
    pub(super) fn allows_arming(&self) -> Result<(), SafetyReason> {
        if self.fault == SafetyReason::None && self.good_samples < ARM_SAMPLES {
            return Err(SafetyReason::NoSample);
        }
        self.allows_torque()
    }

    /// Errors: the reason against torque after the last sample.
    pub(super) fn allows_torque(&self) -> Result<(), SafetyReason> {
        if self.fault != SafetyReason::None {
            Err(self.fault)
        } else if !self.near {
            Err(SafetyReason::TooFar)
        } else {
            Ok(())
        }
    }

    /// A sample, usable or not, arrived in this period.
    pub(super) fn arrived(&self) -> bool {
        self.since_sample == 0
    }

    /// Takes periods of time: the samples age.
    pub(super) fn age(&mut self, limits: &SafetyLimits<N>, periods: u32) {
        for age in [
            &mut self.since_usable,
            &mut self.since_sample,
            &mut self.since_measured,
        ] {
            *age = age.saturating_add(periods);
        }
        if self.timed_out(limits) {
            self.good_samples = 0;
        }
    }

    /// The part of `sample` that the tick may use; parameters as in [`Safety::admit`](super::Safety::admit). Only samples
    /// count as plausible or implausible, never the time between them.
    pub(super) fn take(
        &mut self,
        limits: &SafetyLimits<N>,
        sample: Option<JointSample<N>>,
        periods: u32,
        sensor: SafetyReason,
    ) -> Option<JointSample<N>> {
        let Some(mut sample) = sample else {
            self.fault = SafetyReason::None;
            return None;
        };
        // After a second any position is plausible; its product with a speed stays small enough to be exact.
        let periods = periods.max(self.since_sample).clamp(1, 10_000) as f32;
        self.since_sample = 0;
        let desired = self.check_desired(limits, &sample.desired, periods);
        let mut measured = self.check_measured(limits, sample.measured.as_ref(), periods);
        if sensor != SafetyReason::None {
            measured = sensor;
        }
        let usable = desired == SafetyReason::None;
        self.fault = if usable { measured } else { desired };
        if measured != SafetyReason::None {
            sample.measured = None;
        }
        self.good_samples = match &sample.measured {
            Some(_) if usable => self.good_samples.saturating_add(1),
            _ => 0,
        };
        if usable {
            self.since_usable = 0;
            self.near = self.is_near(&sample);
        }
        if sample.measured.is_some() {
            self.since_measured = 0;
            self.far_samples = if usable && self.near {
                0
            } else {
                self.far_samples.saturating_add(u32::from(usable))
            };
        }
        if self.fault == SafetyReason::None {
            self.implausible_score = self.implausible_score.saturating_sub(1);
        } else {
            self.implausible_score = self.implausible_score.saturating_add(IMPLAUSIBLE_WEIGHT);
            self.implausible = self.implausible.saturating_add(1);
        }
        (desired != SafetyReason::DesiredJump).then_some(sample)
    }

    /// Fault of a desired motion that came `periods` after the one before.
    ///
    /// A position may be [`JUMP_MARGIN`] ahead of one that moves at the highest plausible speed:
    /// a single step uses the margin up, and a speed above that one exceeds it soon. A position that jumps and stays is
    /// refused once, one that alternates at every jump.
    fn check_desired(
        &mut self,
        limits: &SafetyLimits<N>,
        desired: &JointMotion<N>,
        periods: f32,
    ) -> SafetyReason {
        let finite = all_finite(&desired.q) && all_finite(&desired.qd) && all_finite(&desired.qdd);
        if !finite {
            return SafetyReason::DesiredNotFinite;
        }
        let steps = (&limits.step_per_tick, periods);
        match follow(steps, &mut self.desired, &desired.q) {
            Some(_) => SafetyReason::DesiredJump,
            None => SafetyReason::None,
        }
    }

    /// The measured position of every joint, or that measured last, is near the desired one.
    fn is_near(&self, sample: &JointSample<N>) -> bool {
        let measured = sample.measured.as_ref().map(|measured| &measured.q);
        measured.or(self.measured.as_ref()).is_some_and(|measured| {
            let mut joints = sample.desired.q.iter().zip(measured.iter());
            joints.all(|(desired, measured)| (desired - measured).abs() <= ARM_DISTANCE)
        })
    }

    /// Fault of a measurement that came `periods` after the one before, as that of a desired motion.
    fn check_measured(
        &mut self,
        limits: &SafetyLimits<N>,
        measured: Option<&JointMeasurement<N>>,
        periods: f32,
    ) -> SafetyReason {
        let Some(measured) = measured else {
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
        let steps = (&limits.step_per_tick, periods);
        let jumped = follow(steps, &mut self.measured, &measured.q);
        let strong = measured
            .tau
            .iter()
            .zip(limits.effort.iter())
            .any(|(tau, most)| tau.abs() > *most);
        match (outside, jumped.is_some(), strong) {
            (true, ..) => SafetyReason::PositionRange,
            (_, true, _) => SafetyReason::PositionJump,
            (.., true) => SafetyReason::EffortRange,
            _ => {
                self.plausible = Some(measured.q);
                SafetyReason::None
            }
        }
    }
}

/// Moves `position` to `now` by no more than `step`, and returns the first joint for which the rest exceeds
/// [`JUMP_MARGIN`]. Then it is at `now` all the same.
// Has three callers, which share one copy.
#[inline(never)]
pub(crate) fn follow<const N: usize>(
    (step, periods): (&JointVector<N>, f32),
    position: &mut Option<JointVector<N>>,
    now: &JointVector<N>,
) -> Option<u8> {
    let position = position.get_or_insert(*now);
    let mut jumped = None;
    let joints = position.iter_mut().zip(now.iter());
    for (joint, ((position, &now), step)) in joints.zip(step.iter()).enumerate() {
        let (step, behind) = cut(now - *position, step * periods);
        *position = if behind { *position + step } else { now };
        if (now - *position).abs() > JUMP_MARGIN {
            jumped = jumped.or(Some(joint as u8));
        }
    }
    if jumped.is_some() {
        *position = *now;
    }
    jumped
}

fn all_finite<const N: usize>(vector: &JointVector<N>) -> bool {
    vector.iter().all(|value| value.is_finite())
}
