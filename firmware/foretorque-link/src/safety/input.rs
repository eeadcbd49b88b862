use super::plausibility::PlausibilityState;
use super::{SafetyLimits, SafetyReason};
use foretorque::joint::JointSample;

/// Fresh, plausible samples in a row that arming requires.
pub const ARM_SAMPLES: u32 = 3;
/// Largest distance between desired and measured position at arming, rad.
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
    /// Ticks in a row without a usable sample.
    ticks_since_usable: u32,
    /// Ticks since the last sample, usable or not.
    ticks_since_sample: u32,
    /// Weighted count of implausible samples, less the plausible ones.
    implausible_score: u32,
    /// Samples of which a part was implausible.
    implausible: u32,
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
            ticks_since_usable: 0,
            ticks_since_sample: 0,
            implausible_score: 0,
            implausible: 0,
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

    /// No usable sample arrived for too long.
    pub(super) fn timed_out(&self, limits: &SafetyLimits<N>) -> bool {
        self.ticks_since_usable >= limits.timeout_ticks
    }

    /// Too many samples were implausible.
    pub(super) fn too_implausible(&self, limits: &SafetyLimits<N>) -> bool {
        self.implausible_score >= IMPLAUSIBLE_WEIGHT * limits.timeout_ticks
    }

    /// Clears the count of implausible samples.
    pub(super) fn clear_implausible(&mut self) {
        self.implausible_score = 0;
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

    /// A sample, usable or not, arrived in the last tick.
    pub(super) fn arrived(&self) -> bool {
        self.ticks_since_sample == 0
    }

    /// Takes a period without a tick while no torque flows: the samples age.
    pub(super) fn age(&mut self, limits: &SafetyLimits<N>) {
        self.ticks_since_usable = self.ticks_since_usable.saturating_add(1);
        self.forget_if_old(limits);
    }

    fn forget_if_old(&mut self, limits: &SafetyLimits<N>) {
        if self.timed_out(limits) {
            self.good_samples = 0;
        }
    }

    /// The part of `sample` that the tick may use; parameters as in [`Safety::admit`](super::Safety::admit).
    pub(super) fn take(
        &mut self,
        limits: &SafetyLimits<N>,
        sample: Option<JointSample<N>>,
        periods: u32,
        sensor: SafetyReason,
    ) -> Option<JointSample<N>> {
        let since_sample = self.ticks_since_sample.saturating_add(1);
        let (usable, admitted) = match sample {
            None => {
                self.fault = SafetyReason::None;
                self.ticks_since_sample = since_sample;
                (false, None)
            }
            Some(sample) => {
                self.ticks_since_sample = 0;
                self.check(limits, sample, periods.max(since_sample), sensor)
            }
        };
        self.ticks_since_usable = if usable {
            0
        } else {
            self.ticks_since_usable.saturating_add(1)
        };
        self.forget_if_old(limits);
        if self.fault == SafetyReason::None {
            self.implausible_score = self.implausible_score.saturating_sub(1);
        } else {
            self.implausible_score = self.implausible_score.saturating_add(IMPLAUSIBLE_WEIGHT);
            self.implausible = self.implausible.saturating_add(1);
        }
        admitted
    }

    /// Checks a sample; returns whether its desired motion is usable, and what is left of it.
    fn check(
        &mut self,
        limits: &SafetyLimits<N>,
        mut sample: JointSample<N>,
        periods: u32,
        sensor: SafetyReason,
    ) -> (bool, Option<JointSample<N>>) {
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
        if usable {
            self.near = self.plausibility.near(&sample.desired.q, ARM_DISTANCE);
        }
        self.good_samples = match &sample.measured {
            Some(_) if usable => self.good_samples.saturating_add(1),
            _ => 0,
        };
        let admitted = verdict.desired != SafetyReason::DesiredJump;
        (usable, admitted.then_some(sample))
    }
}
