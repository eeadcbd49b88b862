use super::plausibility::PlausibilityState;
use super::{SafetyLimits, SafetyReason};
use foretorque::joint::JointSample;

/// Fresh, plausible samples in a row without which a board cannot be armed.
pub const ARM_SAMPLES: u32 = 3;
/// Largest distance between desired and measured position with which a board can be armed, rad.
pub const ARM_DISTANCE: f32 = 0.2;
/// An implausible sample counts as many doubts as this many plausible ones take back: one in five is too many.
const DOUBT: u32 = 4;

/// What the board was sent, and how far it can be believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct InputState<const N: usize> {
    plausibility: PlausibilityState<N>,
    /// What is wrong with the input of this tick.
    wrong: SafetyReason,
    /// Plausible samples in a row, without a time-out between them.
    good_samples: u32,
    /// Ticks in a row without a usable sample.
    silent_ticks: u32,
    /// Ticks since the last sample, usable or not.
    unheard_ticks: u32,
    doubt: u32,
    /// Samples of which a part was not plausible.
    implausible: u32,
    /// The desired position of the last usable sample is near the one measured last.
    near: bool,
}

impl<const N: usize> InputState<N> {
    /// Nothing was heard yet.
    pub(super) const fn new() -> Self {
        Self {
            plausibility: PlausibilityState::new(),
            wrong: SafetyReason::None,
            good_samples: 0,
            silent_ticks: 0,
            unheard_ticks: 0,
            doubt: 0,
            implausible: 0,
            near: false,
        }
    }

    /// What is wrong with the input of this tick.
    pub(super) fn wrong(&self) -> SafetyReason {
        self.wrong
    }

    /// Samples of which a part was not plausible.
    pub(super) fn implausible(&self) -> u32 {
        self.implausible
    }

    /// No usable sample came for too long.
    pub(super) fn timed_out(&self, limits: &SafetyLimits<N>) -> bool {
        self.silent_ticks >= limits.timeout_ticks
    }

    /// Too many samples were implausible.
    pub(super) fn doubtful(&self, limits: &SafetyLimits<N>) -> bool {
        self.doubt >= DOUBT * limits.timeout_ticks
    }

    /// Doubts from before are over.
    pub(super) fn trust(&mut self) {
        self.doubt = 0;
    }

    /// The board can be armed with what was heard.
    ///
    /// Errors: why not.
    pub(super) fn allows_arming(&self) -> Result<(), SafetyReason> {
        if self.wrong == SafetyReason::None && self.good_samples < ARM_SAMPLES {
            return Err(SafetyReason::NoSample);
        }
        self.allows_torque()
    }

    /// Torque may follow the last sample.
    ///
    /// Errors: why not.
    pub(super) fn allows_torque(&self) -> Result<(), SafetyReason> {
        if self.wrong != SafetyReason::None {
            Err(self.wrong)
        } else if !self.near {
            Err(SafetyReason::TooFar)
        } else {
            Ok(())
        }
    }

    /// A sample, usable or not, came in the last tick.
    pub(super) fn fresh(&self) -> bool {
        self.unheard_ticks == 0
    }

    /// A period without a tick while no torque flows: what was heard grows old.
    pub(super) fn age(&mut self, limits: &SafetyLimits<N>) {
        self.silent_ticks = self.silent_ticks.saturating_add(1);
        self.forget_if_old(limits);
    }

    fn forget_if_old(&mut self, limits: &SafetyLimits<N>) {
        if self.timed_out(limits) {
            self.good_samples = 0;
        }
    }

    /// One tick: what it may use of `sample`.
    ///
    /// * `periods` periods since the sample before, as far as the link knows
    /// * `sensor` what is wrong with the measurement by the board's own sensor
    pub(super) fn take(
        &mut self,
        limits: &SafetyLimits<N>,
        sample: Option<JointSample<N>>,
        periods: u32,
        sensor: SafetyReason,
    ) -> Option<JointSample<N>> {
        let unheard = self.unheard_ticks.saturating_add(1);
        let (usable, admitted) = match sample {
            None => {
                self.wrong = SafetyReason::None;
                self.unheard_ticks = unheard;
                (false, None)
            }
            Some(sample) => {
                self.unheard_ticks = 0;
                self.judge(limits, sample, periods.max(unheard), sensor)
            }
        };
        self.silent_ticks = if usable {
            0
        } else {
            self.silent_ticks.saturating_add(1)
        };
        self.forget_if_old(limits);
        if self.wrong == SafetyReason::None {
            self.doubt = self.doubt.saturating_sub(1);
        } else {
            self.doubt = self.doubt.saturating_add(DOUBT);
            self.implausible = self.implausible.saturating_add(1);
        }
        admitted
    }

    /// Judges a sample; whether its desired motion can be used, and what is left of it.
    fn judge(
        &mut self,
        limits: &SafetyLimits<N>,
        mut sample: JointSample<N>,
        periods: u32,
        sensor: SafetyReason,
    ) -> (bool, Option<JointSample<N>>) {
        let mut verdict = self.plausibility.judge(limits, &sample, periods);
        if sensor != SafetyReason::None {
            verdict.measured = sensor;
        }
        let usable = verdict.desired == SafetyReason::None;
        self.wrong = if usable {
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
