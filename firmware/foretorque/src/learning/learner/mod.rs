mod block;
mod row;
mod transitions;

use crate::arm::Arm;
use crate::learning::ConfigError;
use crate::learning::conditioning::{MAX_BRIDGED, MeasurementWindow};
use crate::learning::config::{LearnerConfig, PERIODS_S};
use crate::learning::decision::{Decision, Reason};
use crate::learning::estimator::Estimator;
use crate::learning::exchange::{
    Exchange, LearnerReport, LearningSample, MotionRange, Publication,
};
use crate::learning::parameters::{JointNetwork, LinearParameters, ParameterSet, StartDeviations};
use crate::learning::quality::{ModelQuality, Monitor, Phase};
use crate::learning::shares::LearntShare;
use crate::learning::supervisor::{Learnt, Supervisor};
use crate::learning::trainer::NetworkTrainer;
use core::marker::PhantomData;

/// Number of rows by outcome, and of published sets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LearnerStatistics {
    /// Rows used.
    pub accepted: u32,
    /// Rows skipped: the joint moves too slowly.
    pub gated: u32,
    /// Rows rejected: not finite, or beyond the limits of the arm.
    pub rejected: u32,
    /// Rows not used because the supervisor pauses the estimate.
    pub frozen: u32,
    /// Ticks without row: the window is incomplete, or repeats a sample for the joint.
    pub incomplete: u32,
    /// Sets published.
    pub published: u32,
}

impl LearnerStatistics {
    const NONE: Self = Self {
        accepted: 0,
        gated: 0,
        rejected: 0,
        frozen: 0,
        incomplete: 0,
        published: 0,
    };
}

/// Torque changes of a joint at the motion of a row, in units of its limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct TorqueChanges {
    /// From the loaded set to the learnt one.
    learnt: f32,
    /// From the learnt set to the estimate.
    estimate: f32,
}

/// State of the learner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnerState<const N: usize, const P: usize> {
    /// Estimate of the linear parameters.
    pub estimate: Estimator<N, P>,
    /// Friction and networks in the torque at the end of the round; the rigid body is the loaded one.
    pub active: ParameterSet<N, P>,
    /// Range of motion of the used rows.
    pub range: MotionRange<N>,
    /// Outcome of the rows.
    pub statistics: LearnerStatistics,
    /// Report, as published.
    pub report: LearnerReport<N>,
    supervisor: Supervisor<N, P>,
    trainer: NetworkTrainer<N>,
    monitor: Monitor<N>,
    snapshot: Option<(Learnt<N, P>, [JointNetwork; N])>,
    commit_due: bool,
    /// True if parameters were restored in this round; the round publishes them as they are.
    restored: bool,
    /// True if a row was learnt in this round.
    moves: bool,
    window: MeasurementWindow<N>,
    next_tick: u32,
    closed_round: Option<u32>,
    /// Number of the load; after a restart that of the first sample.
    generation: Option<u32>,
    /// Cause of a freeze.
    frozen: Option<Reason>,
    /// Ticks until a freeze ends: its measurements have to leave the window.
    resume_in: u32,
    /// Torques of the newest row of each joint since the last round in which all were known.
    round_changes: [Option<TorqueChanges>; N],
    /// Ticks since that round.
    round_ticks: u32,
    /// Expected variance of each joint's last innovation, in units of the configured noise.
    innovation_variance: [f32; N],
}

/// Learner of an arm's parameters from the learning samples of the ticks: one torque row a tick, of joint `tick % N`.
///
/// An [`Estimator`] learns the linear parameters, back-propagation the network candidate of each joint. The supervisor
/// decides which of them enter the torque; its state diagram is in `docs/learning.md`.
///
/// The result depends on the samples alone: the same samples give the same bits, however late they are processed.
pub struct Learner<A: Arm<N, P>, const N: usize, const P: usize> {
    config: LearnerConfig<N, P>,
    state: LearnerState<N, P>,
    /// Only joint whose rows are used, if not all are.
    only_joint: Option<usize>,
    arm: PhantomData<A>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// Learner that starts from the prior set `prior`. On a board a static [`EMPTY`](Self::EMPTY) one is restarted in place:
    /// this one takes tens of kilobytes of the stack.
    ///
    /// Errors: the first invalid field of `config`.
    pub fn new(
        config: LearnerConfig<N, P>,
        prior: ParameterSet<N, P>,
    ) -> Result<Self, ConfigError> {
        let mut learner = Self::EMPTY;
        learner.restart(config, &prior)?;
        Ok(learner)
    }

    /// Learner without configuration, for a static: one on the stack is too large for a board.
    ///
    /// Assumes: [`restart`](Self::restart) before the first sample.
    pub const EMPTY: Self = {
        let config = LearnerConfig::ZERO;
        let zero = ParameterSet::zero();
        Self {
            config,
            state: LearnerState {
                estimate: Estimator::empty(),
                active: zero,
                range: MotionRange::NONE,
                statistics: LearnerStatistics::NONE,
                report: LearnerReport::new(),
                supervisor: Supervisor::new(&config.supervisor),
                trainer: NetworkTrainer::new(&zero.network),
                monitor: Monitor::new(),
                snapshot: None,
                commit_due: false,
                restored: false,
                moves: false,
                window: MeasurementWindow::new(config.decimation, config.delay),
                next_tick: 0,
                closed_round: None,
                generation: None,
                frozen: None,
                resume_in: 0,
                round_changes: [None; N],
                round_ticks: 0,
                innovation_variance: [1.0; N],
            },
            only_joint: None,
            arm: PhantomData,
        }
    };

    /// Restart from `prior` with prior deviations, as [`new`](Self::new), in place.
    ///
    /// Errors: as [`restart_with`](Self::restart_with).
    pub fn restart(
        &mut self,
        config: LearnerConfig<N, P>,
        prior: &ParameterSet<N, P>,
    ) -> Result<(), ConfigError> {
        self.restart_with(config, prior, &StartDeviations::PRIOR)
    }

    /// Restart from `prior` with the deviations `start`, in place.
    ///
    /// Assumes: no sample of a tick before the restart follows.
    /// Errors: the first invalid field of `config`, with the learner unchanged.
    pub fn restart_with(
        &mut self,
        config: LearnerConfig<N, P>,
        prior: &ParameterSet<N, P>,
        start: &StartDeviations<N, P>,
    ) -> Result<(), ConfigError> {
        config.validate()?;
        self.config = config;
        self.restart_configured(prior, start);
        Ok(())
    }

    /// Restart with the [defaults of the arm](LearnerConfig::for_arm) for a tick of `period_s`, s, in place.
    ///
    /// These are valid for every described arm, so a board needs no code that checks each field.
    ///
    /// Errors: the period is not between 10 µs and 0.1 s; the learner is unchanged.
    pub fn restart_for_arm(
        &mut self,
        period_s: f32,
        prior: &ParameterSet<N, P>,
        start: &StartDeviations<N, P>,
    ) -> Result<(), ConfigError> {
        if !PERIODS_S.contains(&period_s) {
            return Err(ConfigError::TooLarge("period_s"));
        }
        self.config = LearnerConfig::for_arm::<A>(period_s);
        self.restart_configured(prior, start);
        Ok(())
    }

    #[inline(never)]
    fn restart_configured(&mut self, prior: &ParameterSet<N, P>, start: &StartDeviations<N, P>) {
        self.state.statistics = LearnerStatistics::NONE;
        self.state.report = LearnerReport::new();
        self.state.window = MeasurementWindow::new(self.config.decimation, self.config.delay);
        self.state.next_tick = 0;
        self.state.generation = None;
        self.start_from(prior, start);
    }

    /// Use only the rows of `joint`, one tick in `N`, for a board that drives one joint; a restart does not change this.
    ///
    /// Friction and networks of the other joints stay. Rigid-body parameters remain those of the whole arm, as far as the
    /// joint's torque contains them.
    pub fn learn_only(&mut self, joint: usize) {
        self.only_joint = Some(joint);
    }

    /// State of the learner.
    pub fn state(&self) -> &LearnerState<N, P> {
        &self.state
    }

    /// Replace the active set.
    #[cfg(test)]
    pub(crate) fn set_active(&mut self, set: &ParameterSet<N, P>) {
        self.state.active = *set;
        self.state.supervisor.learnt.set = LinearParameters::of(set);
        self.state.supervisor.learnt.share = LearntShare::FULL;
    }

    /// Process one sample: [`collect`](Self::collect), [`study`](Self::study), [`publish`](Self::publish).
    pub fn learn(&mut self, sample: &LearningSample<N>, exchange: &mut Exchange<N, P>) {
        self.collect(sample, exchange);
        self.study(sample);
        self.publish(exchange);
    }

    /// Take a loaded set or a request from the mailbox if it takes effect with `sample`.
    ///
    /// Cost: one copy of a set at most, with the mailbox locked.
    #[inline(never)]
    pub fn collect(&mut self, sample: &LearningSample<N>, exchange: &mut Exchange<N, P>) {
        // Older samples may still be queued. Counters wrap, so numbers are compared for equality only.
        let reload = &mut exchange.reload;
        let due = reload.take_if(|(number, ..)| *number == sample.generation);
        if let Some((generation, set, start)) = due {
            self.start_from(&set, &start);
            self.state.generation = Some(generation);
        }
        let request = &mut exchange.request;
        if let Some((_, request)) = request.take_if(|(number, _)| *number == sample.requests) {
            self.execute(sample.tick, request);
        }
    }

    /// Learn from one sample, without the mailbox: the tick may preempt it.
    ///
    /// Cost: motion filter of all joints, torque of the estimate, two regressor rows, one update of the estimator, the
    /// joint's network three times.
    #[inline(never)]
    pub fn study(&mut self, sample: &LearningSample<N>) {
        // A few lost samples are missing measurements.
        for _ in 0..MAX_BRIDGED {
            if sample.tick != self.state.next_tick {
                self.state.window.push(None);
                self.state.next_tick = LearningSample::<N>::tick_after(self.state.next_tick);
            }
        }
        if sample.tick != self.state.next_tick {
            self.state.window.reset();
        }
        self.state.next_tick = LearningSample::<N>::tick_after(sample.tick);
        // A position beyond twice the velocity limit is an encoder error; over a whole sample, for steps of a coarse encoder are
        // none.
        let sample_s = self.config.decimation as f32 / self.config.inv_period;
        let steps = A::limits()
            .iter()
            .map(|limits| 2.0 * limits.velocity * sample_s);
        let window = &mut self.state.window;
        let measured = sample.measured.as_ref();
        window.push(measured.filter(|measured| window.reaches(&measured.q, steps)));
        let joint = sample.tick as usize % N;
        let (mut changes, mut waits) = (None, false);
        let prepared = self.state.estimate.add_prior_factors::<A>();
        let generation = sample.generation;
        let current = *self.state.generation.get_or_insert(generation) == generation;
        let learns = current && self.may_learn(sample);
        if learns {
            match self.state.window.conditioned(self.config.inv_period) {
                Some(conditioned) if prepared => {
                    changes = self.process_sample(sample.tick, joint, &conditioned);
                }
                Some(_) => increment(&mut self.state.statistics.incomplete),
                None => {
                    // A sensor slower than the joint's turns: its last row stands for the round.
                    waits = self.state.window.is_full();
                    if !waits {
                        self.state.supervisor.reset_blocks();
                    }
                    increment(&mut self.state.statistics.incomplete);
                }
            }
        }
        if let (Some(slot), false) = (self.state.round_changes.get_mut(joint), waits) {
            *slot = changes;
            if changes.is_none() {
                self.state.round_ticks = 0;
            }
        }
        if current && joint == N - 1 {
            self.close_round(sample.tick);
        }
    }

    /// Publish the set of a round that has just closed.
    ///
    /// Cost: one copy of a set at most, with the mailbox locked.
    pub fn publish(&mut self, exchange: &mut Exchange<N, P>) {
        let state = &mut self.state;
        if let (Some(tick), Some(generation)) = (state.closed_round.take(), state.generation) {
            // A commit that the tick has not adopted yet passes to the newer set.
            let before = exchange.published.as_ref();
            let waiting = before.is_some_and(|it| it.commit && it.generation == generation);
            exchange.published = Some(Publication {
                closed: tick,
                generation,
                set: state.learnt_set(),
                share: state.supervisor.learnt.share,
                payload: state.supervisor.payload_base,
                range: state.range,
                commit: core::mem::take(&mut state.commit_due) || waiting,
                report: state.report,
            });
            increment(&mut state.statistics.published);
        }
    }

    #[inline(never)]
    fn start_from(&mut self, prior: &ParameterSet<N, P>, start: &StartDeviations<N, P>) {
        let state = &mut self.state;
        state.active = *prior;
        state.estimate.reset(prior, start);
        state.range = MotionRange::NONE;
        state.innovation_variance = [1.0; N];
        let set = LinearParameters::of(prior);
        state.supervisor.restart(&self.config.supervisor, &set);
        state.trainer.reset(&prior.network);
        state.monitor = Monitor::new();
        state.snapshot = None;
        state.commit_due = false;
        state.restored = false;
        state.moves = false;
        state.report.quality = ModelQuality::new();
        state.closed_round = None;
        state.frozen = None;
        state.resume_in = 0;
        // Its torques are those of the gains of before.
        state.window.reset();
        state.forget_round();
    }
}

impl<const N: usize, const P: usize> LearnerState<N, P> {
    /// Share of the learnt set in the torque.
    pub fn share(&self) -> &LearntShare<N> {
        &self.supervisor.learnt.share
    }

    /// Learnt linear parameters, with the networks of the torque.
    fn learnt_set(&self) -> ParameterSet<N, P> {
        let mut set = self.active;
        self.supervisor.learnt.set.write(&mut set);
        set
    }

    /// Wait for new rows of all joints.
    fn forget_round(&mut self) {
        self.round_changes = [None; N];
        self.round_ticks = 0;
    }

    fn phase(&self) -> Phase {
        self.report.quality.phase
    }

    /// Append a decision to the log.
    fn record(&mut self, tick: u32, reason: Reason, joint: Option<usize>, figure: f32) {
        self.report.decisions.push(Decision {
            tick,
            reason,
            joint: joint.map(|joint| joint as u8),
            figure,
        });
    }
}

fn increment(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

#[cfg(test)]
mod tests;
