use crate::arm::Arm;
use crate::dynamics::BaseParameters;
use crate::learning::conditioning::{Conditioned, MeasurementWindow};
use crate::learning::config::{ConfigError, LearnerConfig};
use crate::learning::decision::{Decision, Reason};
use crate::learning::estimator::{Estimator, torque_row};
use crate::learning::parameters::{ParameterSet, network_inputs};
use crate::learning::quality::{ModelQuality, Phase};
use crate::learning::stacked::Stacked;
use crate::learning::{Exchange, Lesson, MotionRange, Publication, Report, Request};
use core::marker::PhantomData;
use nalgebra::SVector;

/// What became of the rows so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LearnerStatistics {
    /// Rows that were learnt from.
    pub accepted: u32,
    /// Rows skipped because the joint moved too slowly.
    pub gated: u32,
    /// Rows refused because a number was not finite or outside anything the arm can do.
    pub rejected: u32,
    /// Ticks that found no full window of measurements.
    pub incomplete: u32,
    /// Sets laid on the desk.
    pub published: u32,
}

/// What the learner carries from lesson to lesson.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnerState<const N: usize, const P: usize> {
    /// The set that learning started from; the box lies around it.
    pub prior: ParameterSet<N, P>,
    /// The estimate of the linear parameters.
    pub estimate: Estimator<N, P>,
    /// The set on its way to the tick: linear parameters that follow the estimate, networks being trained. It becomes
    /// visible to the tick only whole, at the end of a round.
    pub candidate: ParameterSet<N, P>,
    /// What became of the rows.
    pub statistics: LearnerStatistics,
    /// What the guard tells.
    pub report: Report<N>,
    kept: Option<ParameterSet<N, P>>,
    commit: bool,
    window: MeasurementWindow<N>,
    next_tick: u32,
    closed_round: Option<u32>,
    /// By how much the estimate would change each joint's torque in this round, in units of the torque limit; `None`
    /// where that is not known.
    pending: [Option<f32>; N],
}

/// Learns the parameters of an arm from the lessons of the ticks, one torque row a tick, joint `tick % N`.
///
/// Linear parameters (rigid body, friction) by a recursive estimator ([`Estimator`]); the joint's network by
/// back-propagation on what remains. The published set follows the estimate as fast as a bound on the torque step lets
/// it, at once when the estimate is calm.
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
        config.validate()?;
        Ok(Self {
            config,
            state: LearnerState {
                prior,
                estimate: Estimator::new(&prior),
                candidate: prior,
                statistics: LearnerStatistics::default(),
                report: Report::new(),
                kept: None,
                commit: false,
                window: MeasurementWindow::new(),
                next_tick: 0,
                closed_round: None,
                pending: [None; N],
            },
            own: None,
            arm: PhantomData,
        })
    }

    /// Starts over from `prior`, as [`new`](Self::new) does, but in place: the learner is too large to be copied where a
    /// tick waits for it.
    ///
    /// Errors: the first field of `config` that cannot work; then nothing has changed.
    pub fn restart(
        &mut self,
        config: LearnerConfig<N, P>,
        prior: &ParameterSet<N, P>,
    ) -> Result<(), ConfigError> {
        config.validate()?;
        self.config = config;
        self.state.statistics = LearnerStatistics::default();
        self.state.report = Report::new();
        self.state.window.reset();
        self.state.next_tick = 0;
        self.state.start_from(prior);
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

    /// Works through one lesson: [`collect`](Self::collect), [`study`](Self::study), [`publish`](Self::publish).
    pub fn learn(&mut self, lesson: &Lesson<N>, exchange: &mut Exchange<N, P>) {
        self.collect(lesson.tick, exchange);
        self.study(lesson);
        self.publish(exchange);
    }

    /// Takes over a reloaded set if it holds for the lesson of `tick`. Touches the desk for one copy at most.
    pub fn collect(&mut self, tick: u32, exchange: &mut Exchange<N, P>) {
        // Lessons older than the reload may still be in the queue; they must not learn on the new set.
        let due = exchange.reload.take_if(|(from, _)| reached(tick, *from));
        if let Some((_, set)) = due {
            self.state.start_from(&set);
        }
        if let Some((_, request)) = exchange.request.take_if(|(from, _)| reached(tick, *from)) {
            self.state.answer(tick, request);
        }
    }

    /// Learns from one lesson. Does not touch the desk, so the tick may run in the middle of it.
    ///
    /// Cost: the filter of all joints, one regressor row, one row of the estimator; the joint's network once.
    pub fn study(&mut self, lesson: &Lesson<N>) {
        if lesson.tick != self.state.next_tick {
            self.state.window.reset();
        }
        self.state.next_tick = lesson.tick.wrapping_add(1);
        self.state.window.push(lesson.measured.as_ref());
        let joint = lesson.tick as usize % N;
        let mut step = None;
        if !lesson.enabled {
            self.state.resume(lesson.tick);
        } else if self.own.is_some_and(|own| own != joint) {
            // Who learns for one joint drives that one: how the torques of the others step binds nobody.
            step = Some(0.0);
        } else if self.state.report.quality.phase != Phase::Stopped {
            match self.state.window.conditioned(self.config.inv_period) {
                Some(seen) => step = self.learn_row(joint, &seen),
                None => count(&mut self.state.statistics.incomplete),
            }
        }
        if let Some(pending) = self.state.pending.get_mut(joint) {
            *pending = step;
        }
        if joint == N - 1 {
            self.state.follow(self.config.torque_step);
            self.state.closed_round = Some(lesson.tick);
        }
    }

    /// Lays the set of a round that has just closed on the desk. Touches the desk for one copy at most.
    pub fn publish(&mut self, exchange: &mut Exchange<N, P>) {
        if let Some(tick) = self.state.closed_round.take() {
            exchange.published = Some(Publication {
                closed: tick,
                set: self.state.candidate,
                payload: BaseParameters::zeros(),
                range: MotionRange::NONE,
                commit: core::mem::take(&mut self.state.commit),
                report: self.state.report,
            });
            count(&mut self.state.statistics.published);
        }
    }

    /// One row of joint `joint`. Returns by how much the estimate would change the joint's torque, in units of its limit.
    fn learn_row(&mut self, joint: usize, seen: &Conditioned<N>) -> Option<f32> {
        let (verdict, step) = self.row(joint, seen);
        count(match verdict {
            Verdict::Gated => &mut self.state.statistics.gated,
            Verdict::Rejected => &mut self.state.statistics.rejected,
            Verdict::Accepted => &mut self.state.statistics.accepted,
        });
        step
    }

    /// The linear parameters take what they can explain; the joint's network is trained on what remained before.
    fn row(&mut self, joint: usize, seen: &Conditioned<N>) -> (Verdict, Option<f32>) {
        let (Some(limits), Some(&speed), Some(&tau)) = (
            A::LIMITS.get(joint),
            seen.motion.qd.get(joint),
            seen.tau.get(joint),
        ) else {
            return (Verdict::Rejected, None);
        };
        if !plausible::<A, N, P>(seen, self.config.acceleration_limit) {
            return (Verdict::Rejected, None);
        }
        let LearnerState {
            prior,
            estimate,
            candidate,
            ..
        } = &mut self.state;
        let row = torque_row::<A, N, P>(joint, seen);
        let mut verdict = Verdict::Gated;
        if speed.abs() >= self.config.velocity_gate {
            let residual = estimate.correct(&self.config, prior, joint, limits.torque, &row, tau);
            let Some(residual) = residual else {
                return (Verdict::Rejected, None);
            };
            if let Some(network) = candidate.network.get_mut(joint) {
                let target = SVector::from([residual]);
                network.update(&network_inputs(speed), &target, &self.config.network);
            }
            verdict = Verdict::Accepted;
        }
        let step = row.dot(estimate.parameters()) - row.dot(&Stacked::of(candidate));
        (verdict, Some(step / limits.torque))
    }
}

impl<const N: usize, const P: usize> LearnerState<N, P> {
    fn answer(&mut self, tick: u32, request: Request) {
        let mut figure = 0.0;
        let reason = match (request, self.kept) {
            (Request::Snapshot, _) => {
                self.kept = Some(self.candidate);
                Reason::Kept
            }
            (Request::Rollback, Some(kept)) => {
                self.candidate = kept;
                self.estimate.move_to(&kept);
                Reason::RolledBack
            }
            (Request::Commit, _) => {
                self.commit = true;
                Reason::Committed
            }
            (Request::ZeroPayload, _) => Reason::PayloadZeroed,
            (Request::Stop, _) => {
                self.report.quality.phase = Phase::Stopped;
                Reason::FrozenStopped
            }
            (Request::Rollback, None) => {
                figure = f32::from(request as u8);
                Reason::Refused
            }
        };
        self.note(tick, reason, figure);
    }

    /// Learning has been switched off: that ends an emergency stop.
    fn resume(&mut self, tick: u32) {
        if self.report.quality.phase == Phase::Stopped {
            self.report.quality.phase = Phase::Healthy;
            self.note(tick, Reason::Thawed, 0.0);
        }
    }

    fn note(&mut self, tick: u32, reason: Reason, figure: f32) {
        self.report.decisions.note(Decision {
            tick,
            reason,
            joint: None,
            figure,
        });
    }

    fn start_from(&mut self, prior: &ParameterSet<N, P>) {
        self.prior = *prior;
        self.candidate = *prior;
        self.estimate.reset(prior);
        self.kept = None;
        self.commit = false;
        self.report.quality = ModelQuality::new();
        self.closed_round = None;
        self.pending = [None; N];
    }

    /// Moves the candidate's linear parameters towards the estimate: all the way if that changes no joint's torque by
    /// more than `bound`, else by the part that keeps to it. Torque is linear in them, so a part of the way is a part of
    /// the step. A joint whose step is not known holds everything.
    fn follow(&mut self, bound: f32) {
        let mut largest = 0.0;
        for pending in core::mem::replace(&mut self.pending, [None; N]) {
            match pending {
                Some(step) if step.is_finite() => {
                    if step.abs() > largest {
                        largest = step.abs();
                    }
                }
                _ => return,
            }
        }
        if largest <= bound {
            self.estimate.parameters().write(&mut self.candidate);
            return;
        }
        let part = bound / largest;
        let mut followed = Stacked::of(&self.candidate);
        let estimate = self.estimate.parameters();
        for (followed, estimate) in followed.iter_mut().zip(estimate.iter()) {
            *followed += part * (estimate - *followed);
        }
        followed.write(&mut self.candidate);
    }
}

/// Nothing in `seen` is beyond what the arm can do. A model fitted to the impossible is worth nothing; a wild encoder
/// shows in the acceleration first.
fn plausible<A: Arm<N, P>, const N: usize, const P: usize>(
    seen: &Conditioned<N>,
    acceleration_limit: f32,
) -> bool {
    let motion = seen.motion.qd.iter().zip(seen.motion.qdd.iter());
    let mut joints = motion.zip(seen.tau.iter()).zip(&A::LIMITS);
    joints.all(|(((qd, qdd), tau), limits)| {
        qd.abs() <= 2.0 * limits.velocity
            && qdd.abs() <= acceleration_limit
            && tau.abs() <= 2.0 * limits.torque
    })
}

/// What became of a row.
enum Verdict {
    Accepted,
    Gated,
    Rejected,
}

/// `tick` is `from` or later, on a counter that wraps.
fn reached(tick: u32, from: u32) -> bool {
    tick.wrapping_sub(from) < u32::MAX / 2
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

#[cfg(test)]
mod tests;
