//! The learner: one lesson a tick.

mod guarding;
mod row;
mod slices;

use crate::arm::Arm;
use crate::learning::conditioning::MeasurementWindow;
use crate::learning::config::{ConfigError, LearnerConfig};
use crate::learning::decision::{Decision, Reason};
use crate::learning::estimator::Estimator;
use crate::learning::guard::Guard;
use crate::learning::monitor::Monitor;
use crate::learning::parameters::ParameterSet;
use crate::learning::quality::{ModelQuality, Phase};
use crate::learning::stacked::LinearParameters;
use crate::learning::trainer::NetworkTrainer;
use crate::learning::{Exchange, LearnerReport, LearningSample, MotionRange, Publication};
use core::marker::PhantomData;

/// What became of the rows so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LearnerStatistics {
    /// Rows that were learnt from.
    pub accepted: u32,
    /// Rows skipped because the joint moved too slowly.
    pub gated: u32,
    /// Rows refused because a number was not finite or outside anything the arm can do.
    pub rejected: u32,
    /// Rows not learnt from because the guard had frozen the estimate.
    pub frozen: u32,
    /// Ticks without a row: no full window of measurements, or none in its middle or at its end.
    pub incomplete: u32,
    /// Sets laid on the desk.
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

/// What the learner carries from lesson to lesson.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnerState<const N: usize, const P: usize> {
    /// The set that learning started from.
    pub prior: ParameterSet<N, P>,
    /// The estimate of the linear parameters.
    pub estimate: Estimator<N, P>,
    /// The set on its way to the tick: linear parameters that follow the estimate while the guard lets them, networks
    /// that have proved themselves. It becomes visible to the tick only whole, at the end of a round.
    pub active: ParameterSet<N, P>,
    /// The motion for which the estimate has been learnt.
    pub range: MotionRange<N>,
    /// What became of the rows.
    pub statistics: LearnerStatistics,
    /// What the guard tells.
    pub report: LearnerReport<N>,
    guard: Guard<N, P>,
    trainer: NetworkTrainer<N>,
    monitor: Monitor<N>,
    kept: Option<ParameterSet<N, P>>,
    commit: bool,
    window: MeasurementWindow<N>,
    next_tick: u32,
    closed_round: Option<u32>,
    /// Number of the load that `prior` comes from; that of the first lesson after a restart.
    generation: Option<u32>,
    /// Why lessons are not learnt from at present.
    frozen: Option<Reason>,
    /// Ticks for which a freeze lasts on: its measurements are still in the window.
    thaw_in: u32,
    /// By how much the estimate would change each joint's torque in this round, in units of the torque limit; `None`
    /// where that is not known.
    pending: [Option<f32>; N],
    /// Variance of each joint's last innovation, in units of the configured noise.
    innovation_variance: [f32; N],
}

/// Learns the parameters of an arm from the lessons of the ticks, one torque row a tick, joint `tick % N`.
///
/// Linear parameters (rigid body, friction) by a recursive estimator ([`Estimator`]); the joint's network by
/// back-propagation on what remains. A guard decides what of it reaches the torque: the published set follows the estimate
/// once that has proved better on rows it had not seen, as fast as a bound on the torque step lets it; a change of the
/// arm freezes it until the change has been explained.
///
/// Lessons decide everything: the same lessons give the same bits, whenever they are worked through.
pub struct Learner<A: Arm<N, P>, const N: usize, const P: usize> {
    config: LearnerConfig<N, P>,
    state: LearnerState<N, P>,
    /// The only joint whose rows count, if not all do.
    own: Option<usize>,
    arm: PhantomData<A>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// A learner that starts from `prior`.
    ///
    /// Errors: the first field of `config` that cannot work.
    pub fn new(
        config: LearnerConfig<N, P>,
        prior: ParameterSet<N, P>,
    ) -> Result<Self, ConfigError> {
        let mut learner = Self::empty(config);
        learner.restart(config, &prior)?;
        Ok(learner)
    }

    /// A learner that knows nothing, for a static: [`restart`](Self::restart) it before its first lesson. It is too large
    /// to be built on the stack of a board.
    pub const fn empty(config: LearnerConfig<N, P>) -> Self {
        let nothing = ParameterSet::nothing();
        Self {
            config,
            state: LearnerState {
                prior: nothing,
                estimate: Estimator::idle(),
                active: nothing,
                range: MotionRange::NONE,
                statistics: LearnerStatistics::NONE,
                report: LearnerReport::new(),
                guard: Guard::new(&config.supervisor, &LinearParameters::filled(0.0)),
                trainer: NetworkTrainer::new(&nothing.network),
                monitor: Monitor::new(),
                kept: None,
                commit: false,
                window: MeasurementWindow::new(),
                next_tick: 0,
                closed_round: None,
                generation: None,
                frozen: None,
                thaw_in: 0,
                pending: [None; N],
                innovation_variance: [1.0; N],
            },
            own: None,
            arm: PhantomData,
        }
    }

    /// Starts over from `prior`, as [`new`](Self::new) does, but in place: the learner is too large to be copied where a
    /// tick waits for it. Lessons of ticks before the restart must not follow.
    ///
    /// Errors: the first field of `config` that cannot work; then nothing has changed.
    #[inline(never)]
    pub fn restart(
        &mut self,
        config: LearnerConfig<N, P>,
        prior: &ParameterSet<N, P>,
    ) -> Result<(), ConfigError> {
        config.validate()?;
        self.config = config;
        self.state.statistics = LearnerStatistics::NONE;
        self.state.report = LearnerReport::new();
        self.state.window.reset();
        self.state.next_tick = 0;
        self.state.generation = None;
        self.start_from(prior);
        Ok(())
    }

    /// From now on learns from the rows of `joint` alone, one tick in `N`: for a board that drives that joint only. The
    /// other joints keep their friction and network; rigid-body parameters are still those of the whole arm, as far as
    /// this joint sees them. A restart leaves it so.
    pub fn learn_only(&mut self, joint: usize) {
        self.own = Some(joint);
    }

    /// What the learner knows.
    pub fn state(&self) -> &LearnerState<N, P> {
        &self.state
    }

    /// The parameters on their way to the tick, for tests that put others in their place.
    #[cfg(test)]
    pub(crate) fn active_mut(&mut self) -> &mut ParameterSet<N, P> {
        &mut self.state.active
    }

    /// Works through one lesson: [`collect`](Self::collect), [`study`](Self::study), [`publish`](Self::publish).
    pub fn learn(&mut self, lesson: &LearningSample<N>, exchange: &mut Exchange<N, P>) {
        self.collect(lesson, exchange);
        self.study(lesson);
        self.publish(exchange);
    }

    /// Takes over a reloaded set or a request if it holds for `lesson`. Touches the desk for one copy at most.
    #[inline(never)]
    pub fn collect(&mut self, lesson: &LearningSample<N>, exchange: &mut Exchange<N, P>) {
        // Lessons older than either may still be in the queue. Ticks half the range of their counter apart have no order,
        // so numbers are compared, and for equality alone.
        let reload = &mut exchange.reload;
        if let Some((generation, set)) = reload.take_if(|(number, _)| *number == lesson.generation)
        {
            self.start_from(&set);
            self.state.generation = Some(generation);
        }
        let request = &mut exchange.request;
        if let Some((_, request)) = request.take_if(|(number, _)| *number == lesson.requests) {
            self.answer(lesson.tick, request);
        }
    }

    /// Learns from one lesson. Does not touch the desk, so the tick may run in the middle of it.
    ///
    /// Cost: the filter of all joints, the torque of the estimate, two regressor rows, one row of the estimator; the
    /// joint's network three times.
    #[inline(never)]
    pub fn study(&mut self, lesson: &LearningSample<N>) {
        if lesson.tick != self.state.next_tick {
            self.state.window.reset();
        }
        self.state.next_tick = lesson.tick.wrapping_add(1);
        self.state.window.push(lesson.measured.as_ref());
        let joint = lesson.tick as usize % N;
        let mut step = None;
        let prepared = self.state.estimate.prepare::<A>();
        let generation = lesson.generation;
        let current = *self.state.generation.get_or_insert(generation) == generation;
        let learns = current && self.may_learn(lesson);
        if learns && self.own.is_some_and(|own| own != joint) {
            // Who learns for one joint drives that one: how the torques of the others step binds nobody.
            step = Some(0.0);
        } else if learns {
            match self.state.window.conditioned(self.config.inv_period) {
                Some(seen) if prepared => step = self.work_through(lesson.tick, joint, &seen),
                Some(_) => count(&mut self.state.statistics.incomplete),
                None => {
                    if !self.state.window.is_whole() {
                        self.state.guard.forget_slices();
                    }
                    count(&mut self.state.statistics.incomplete);
                }
            }
        }
        if let Some(pending) = self.state.pending.get_mut(joint) {
            *pending = step;
        }
        if current && joint == N - 1 {
            self.close_round(lesson.tick);
        }
    }

    /// Lays the set of a round that has just closed on the desk. Touches the desk for one copy at most.
    pub fn publish(&mut self, exchange: &mut Exchange<N, P>) {
        let state = &mut self.state;
        if let (Some(tick), Some(generation)) = (state.closed_round.take(), state.generation) {
            // A commit that the tick has not taken yet must not get lost when a newer set takes its place.
            let before = exchange.published.as_ref();
            let waiting = before.is_some_and(|it| it.commit && it.generation == generation);
            exchange.published = Some(Publication {
                closed: tick,
                generation,
                set: state.active,
                payload: state.guard.payload_base,
                range: state.range,
                commit: core::mem::take(&mut state.commit) || waiting,
                report: state.report,
            });
            count(&mut state.statistics.published);
        }
    }

    #[inline(never)]
    fn start_from(&mut self, prior: &ParameterSet<N, P>) {
        let state = &mut self.state;
        state.prior = *prior;
        state.active = *prior;
        state.estimate.reset(prior);
        state.range = MotionRange::NONE;
        state.innovation_variance = [1.0; N];
        state.guard = Guard::new(&self.config.supervisor, &LinearParameters::of(prior));
        state.trainer = NetworkTrainer::new(&prior.network);
        state.monitor = Monitor::new();
        state.kept = None;
        state.commit = false;
        state.report.quality = ModelQuality::new();
        state.closed_round = None;
        state.frozen = None;
        state.thaw_in = 0;
        state.pending = [None; N];
    }
}

impl<const N: usize, const P: usize> LearnerState<N, P> {
    /// What the guard is doing.
    fn phase(&self) -> Phase {
        self.report.quality.phase
    }

    fn note(&mut self, tick: u32, reason: Reason, joint: Option<usize>, figure: f32) {
        self.report.decisions.note(Decision {
            tick,
            reason,
            joint: joint.map(|joint| joint as u8),
            figure,
        });
    }
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

#[cfg(test)]
mod tests;
