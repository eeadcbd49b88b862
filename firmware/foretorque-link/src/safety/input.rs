use super::plausibility::PlausibilityState;
use super::{SafetyLimits, SafetyReason};
use foretorque::joint::{JointSample, JointVector};

/// Fresh, plausible samples in a row that arming requires.
pub const ARM_SAMPLES: u32 = 3;
/// Largest distance between desired and measured position at arming and while armed, rad.
pub const ARM_DISTANCE: f32 = 0.2;
/// Weight of an implausible sample; a plausible one takes back 1. So one in five is too many.
const IMPLAUSIBLE_WEIGHT: u32 = 4;

/// Plausibility and age of the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct InputState<const N: usize> {
    plausibility: PlausibilityState<N>,
    /// Fault of the input of this tick.
    fault: SafetyReason,
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
    implausible: u32,
    /// Samples in a row whose desired position is far from the one measured.
    far_samples: u32,
    /// The desired position of the last usable sample is near the one measured last.
    near: bool,
}

impl<const N: usize> InputState<N> {
    /// Before the first sample.
    pub(super) const fn new() -> Self {
        Self {
            plausibility: PlausibilityState::new(),
            fault: SafetyReason::None,
            good_samples: 0,
            since_usable: 0,
            since_sample: 0,
            since_measured: 0,
            implausible_score: 0,
            implausible: 0,
            far_samples: 0,
            near: false,
        }
    }

    /// Fault of the input of this tick.
    pub(super) fn fault(&self) -> SafetyReason {
        self.fault
    }

    /// Samples of which a part was implausible.
    pub(super) fn implausible(&self) -> u32 {
        self.implausible
    }

    /// Position measured last, N × rad.
    pub(super) fn measured_q(&self) -> Option<&JointVector<N>> {
        self.plausibility.measured_q()
    }

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

    /// Clears the counts of samples that end a torque.
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

    /// Takes one period of time: the samples age.
    pub(super) fn age(&mut self, limits: &SafetyLimits<N>) {
        for age in [
            &mut self.since_usable,
            &mut self.since_sample,
            &mut self.since_measured,
        ] {
            *age = age.saturating_add(1);
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
        let periods = periods.max(self.since_sample);
        self.since_sample = 0;
        let mut verdict = self.plausibility.check(limits, &sample, periods);
        if sensor != SafetyReason::None {
            verdict.measured = sensor;
        }
        let usable = verdict.desired == SafetyReason::None;
        self.fault = if usable {
            verdict.measured
        } else {
            verdict.desired
        };
        if verdict.measured != SafetyReason::None {
            sample.measured = None;
        }
        self.good_samples = match &sample.measured {
            Some(_) if usable => self.good_samples.saturating_add(1),
            _ => 0,
        };
        if usable {
            self.since_usable = 0;
            self.near = self.plausibility.near(&sample, ARM_DISTANCE);
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
        let admitted = verdict.desired != SafetyReason::DesiredJump;
        admitted.then_some(sample)
    }
}
