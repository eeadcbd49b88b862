//! The board's tick and its learning, in the order in which the board does them.

use super::PERIOD_S;
use super::setup::{N, P, Set};
use foretorque::arm::ur5::Ur5;
use foretorque::feedforward::{FeedForward, FeedForwardConfig, Torque, evaluate};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample};
use foretorque::learning::{
    ConfigError, Exchange, Learner, LearnerConfig, LearnerReport, LearnerState,
};
use foretorque_link::bank::NETWORK_SEED;
use foretorque_link::safety::{ARM_SAMPLES, Safety, SafetyLimits, SafetyReason};
use foretorque_link::wire::SampleFrame;

/// Safety, feed-forward, learner and the mailbox between them.
///
/// The session of the firmware calls these functions in this order too; the soak compares the bits of its answers.
pub(super) struct Controller {
    safety: Safety<N>,
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
        let booted = Set::nominal::<Ur5>(NETWORK_SEED);
        let period_s = PERIOD_S as f32;
        let mut exchange = Exchange::new();
        let mut feedforward =
            FeedForward::new(FeedForwardConfig::for_arm::<Ur5, P>(period_s), booted)?;
        feedforward.load(*set, &mut exchange);
        feedforward.set_learning(learning);
        let limits = SafetyLimits::for_arm::<Ur5, P>((PERIOD_S * 1e6).round() as u32);
        Ok(Self {
            safety: Safety::new(limits, SafetyReason::None),
            feedforward,
            learner: Learner::new(config, booted)?,
            exchange,
            learning,
        })
    }

    /// The sample that arms the board at rest in `desired`: shown until the board accepts it.
    pub(super) fn arming_sample(&self, desired: JointMotion<N>) -> JointSample<N> {
        let tau = evaluate::<Ur5, N, P>(&self.active(), &desired).total;
        JointSample {
            measured: Some(JointMeasurement { q: desired.q, tau }),
            desired,
        }
    }

    /// Shows the board `sample` and arms it, as [`foretorque_workbench::board::Client::arm`] does.
    ///
    /// Errors: why the board must not be armed.
    pub(super) fn arm(&mut self, sample: &JointSample<N>) -> Result<(), SafetyReason> {
        for _ in 0..ARM_SAMPLES {
            self.tick(Some(sample));
        }
        self.safety.arm()
    }

    /// One tick; neither desired motion nor measurement arrives when `sample` is none. The sample is rounded as the link
    /// rounds it.
    pub(super) fn tick(&mut self, sample: Option<&JointSample<N>>) -> Torque<N> {
        self.feedforward.adopt(&mut self.exchange);
        let received = sample.map(|sample| SampleFrame::new(sample).sample(&[0.0; N]));
        self.safety.period();
        let sample = self.safety.admit(received, 1, SafetyReason::None);
        let mut torque = match &sample {
            Some(sample) => self.feedforward.step(sample),
            None => self.feedforward.step_stale(),
        };
        torque.total = self.safety.release(&torque.total);
        self.feedforward.applied(&torque.total);
        if self.learning {
            let measured = sample.and_then(|sample| sample.measured);
            let learning_sample = self.feedforward.learning_sample(measured);
            self.learner.learn(&learning_sample, &mut self.exchange);
        }
        torque
    }

    /// The parameters that the torque is computed from, payload included.
    pub(super) fn active(&self) -> Set {
        self.feedforward.in_force()
    }

    /// State of the learner.
    pub(super) fn learner(&self) -> &LearnerState<N, P> {
        self.learner.state()
    }

    /// Report of the supervisor: model quality and decisions.
    pub(super) fn report(&self) -> &LearnerReport<N> {
        &self.feedforward.state().report
    }

    /// Sets that were not there in time.
    pub(super) fn late_sets(&self) -> u32 {
        self.feedforward.state().late_sets
    }
}
