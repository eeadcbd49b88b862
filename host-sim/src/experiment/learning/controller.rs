//! The board's tick and its learning, in the order in which the board does them.

use super::world::{N, P, PERIOD_S, Set};
use foretorque::arm::ur5::Ur5;
use foretorque::feedforward::{FeedForward, FeedForwardConfig, Torque};
use foretorque::joint::JointSample;
use foretorque::learning::{ConfigError, Exchange, Learner, LearnerConfig, LearnerState, Report};

/// Feed-forward, learner and the desk between them.
///
/// The session of the firmware calls these functions in this order too; that its answers are the same bits over its
/// link, in the emulator, is what [`super::emulated`] shows.
pub(super) struct Controller {
    feedforward: FeedForward<Ur5, N, P>,
    learner: Learner<Ur5, N, P>,
    exchange: Exchange<N, P>,
    learning: bool,
}

impl Controller {
    /// The configuration of the firmware.
    pub(super) fn config() -> LearnerConfig<N, P> {
        LearnerConfig::for_arm::<Ur5>(PERIOD_S as f32)
    }

    /// A board that has booted, taken `set` and switched learning on, or not.
    pub(super) fn new(
        set: &Set,
        config: LearnerConfig<N, P>,
        learning: bool,
    ) -> Result<Self, ConfigError> {
        let period_s = PERIOD_S as f32;
        let mut feedforward =
            FeedForward::new(FeedForwardConfig::for_arm::<Ur5, P>(period_s), *set)?;
        feedforward.set_learning(learning);
        Ok(Self {
            feedforward,
            learner: Learner::new(config, *set)?,
            exchange: Exchange::new(),
            learning,
        })
    }

    /// One tick; none of the desired motion or the measurement arrives when `sample` is none.
    pub(super) fn tick(&mut self, sample: Option<&JointSample<N>>) -> Torque<N> {
        self.feedforward.adopt(&mut self.exchange);
        let torque = match sample {
            Some(sample) => self.feedforward.step(sample),
            None => self.feedforward.step_stale(),
        };
        if self.learning {
            let measured = sample.and_then(|sample| sample.measured);
            let lesson = self.feedforward.lesson(measured);
            self.learner.learn(&lesson, &mut self.exchange);
        }
        torque
    }

    /// The parameters that the torque is computed from, payload included.
    pub(super) fn active(&self) -> Set {
        self.feedforward.in_force()
    }

    /// What the learner knows.
    pub(super) fn learner(&self) -> &LearnerState<N, P> {
        self.learner.state()
    }

    /// What the guard tells: model quality and decisions.
    pub(super) fn report(&self) -> &Report<N> {
        &self.feedforward.state().report
    }

    /// Sets that were not there in time.
    pub(super) fn late_sets(&self) -> u32 {
        self.feedforward.state().late_sets
    }
}
