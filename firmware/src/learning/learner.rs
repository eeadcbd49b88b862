use super::conditioning::{Conditioned, MeasurementWindow};
use super::config::{ConfigError, LearnerConfig};
use super::estimator::{Estimator, torque_row};
use super::parameters::{ParameterSet, network_inputs};
use super::stacked::Stacked;
use super::{Exchange, Lesson};
use crate::arm::Arm;
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
                window: MeasurementWindow::new(),
                next_tick: 0,
                closed_round: None,
                pending: [None; N],
            },
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
        self.state.window.reset();
        self.state.next_tick = 0;
        self.state.start_from(prior);
        Ok(())
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
        if lesson.enabled {
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
            exchange.published = Some((tick, self.state.candidate));
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
    fn start_from(&mut self, prior: &ParameterSet<N, P>) {
        self.prior = *prior;
        self.candidate = *prior;
        self.estimate.reset(prior);
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
mod tests {
    use super::*;
    use crate::arm::ur5::Ur5;
    use crate::joint::{JointMeasurement, JointVector};

    const N: usize = 6;
    const P: usize = 40;

    fn learner() -> Learner<Ur5, N, P> {
        let config = LearnerConfig::for_arm::<Ur5>(1e-3);
        Learner::new(config, ParameterSet::nominal::<Ur5>(1)).unwrap()
    }

    fn measured(tick: u32, speed: f32, tau: f32) -> JointMeasurement<N> {
        let t = tick as f32 * 1e-3;
        JointMeasurement {
            q: JointVector::from_fn(|j, _| (speed * t + j as f32).sin()),
            tau: JointVector::from_element(tau),
        }
    }

    fn lesson(tick: u32, measured: Option<JointMeasurement<N>>, enabled: bool) -> Lesson<N> {
        Lesson {
            tick,
            measured,
            enabled,
        }
    }

    /// Lessons `ticks` of a moving arm that always measures 20 N·m.
    fn teach(learner: &mut Learner<Ur5, N, P>, ticks: core::ops::Range<u32>, enabled: bool) {
        for tick in ticks {
            learner.study(&lesson(tick, Some(measured(tick, 2.0, 20.0)), enabled));
        }
    }

    #[test]
    fn frozen_nothing_is_learnt_but_the_window_runs_on() {
        let mut learner = learner();
        teach(&mut learner, 0..100, false);
        assert_eq!(learner.state.candidate, learner.state.prior);
        assert_eq!(learner.state.statistics, LearnerStatistics::default());
        let before = learner.state.estimate;
        teach(&mut learner, 100..101, true);
        assert_eq!(learner.state.statistics.accepted, 1);
        assert_ne!(learner.state.estimate, before);
    }

    #[test]
    fn a_measurement_that_is_missing_or_not_finite_changes_nothing() {
        let mut bad_torque = measured(60, 2.0, 20.0);
        bad_torque.tau[0] = f32::NAN;
        let mut bad_position = measured(60, 2.0, 20.0);
        bad_position.q[5] = f32::INFINITY;
        for bad in [None, Some(bad_torque), Some(bad_position)] {
            let mut learner = learner();
            teach(&mut learner, 0..60, true);
            let before = (learner.state.estimate, learner.state.candidate);
            learner.study(&lesson(60, bad, true));
            teach(&mut learner, 61..91, true);
            assert!((learner.state.estimate, learner.state.candidate) == before);
            teach(&mut learner, 91..92, true);
            assert_ne!(learner.state.estimate, before.0);
        }
    }

    #[test]
    fn a_lost_lesson_is_a_gap() {
        let mut learner = learner();
        teach(&mut learner, 0..60, true);
        let before = learner.state.statistics;
        teach(&mut learner, 61..91, true);
        assert_eq!(learner.state.statistics.accepted, before.accepted);
        assert_eq!(learner.state.statistics.incomplete, before.incomplete + 30);
    }

    #[test]
    fn each_tick_teaches_the_network_of_its_own_joint_only() {
        let mut learner = learner();
        teach(&mut learner, 0..30, true);
        for tick in 30..36 {
            let before = learner.state.candidate;
            teach(&mut learner, tick..tick + 1, true);
            for joint in 0..N {
                let moved = learner.state.candidate.network[joint] != before.network[joint];
                assert_eq!(
                    moved,
                    joint == tick as usize % N,
                    "joint {joint} at tick {tick}"
                );
            }
        }
    }

    #[test]
    fn a_joint_that_hardly_moves_teaches_nothing() {
        let mut learner = learner();
        for tick in 0..100 {
            learner.study(&lesson(tick, Some(measured(tick, 0.04, 20.0)), true));
        }
        assert_eq!(learner.state.candidate, learner.state.prior);
        assert_eq!(learner.state.statistics.gated, 70);
    }

    #[test]
    fn an_encoder_gone_wild_or_an_impossible_torque_is_rejected() {
        let mut learner = learner();
        for tick in 0..100 {
            let mut wild = measured(tick, 2.0, 20.0);
            wild.q[4] = tick as f32;
            learner.study(&lesson(tick, Some(wild), true));
        }
        for tick in 100..200 {
            learner.study(&lesson(tick, Some(measured(tick, 2.0, 1e30)), true));
        }
        assert_eq!(learner.state.candidate, learner.state.prior);
        assert_eq!(learner.state.statistics.accepted, 0);
        assert!(learner.state.statistics.rejected > 100);
    }

    #[test]
    fn one_glitch_of_one_encoder_teaches_nothing_to_any_joint() {
        let (mut clean, mut glitched) = (learner(), learner());
        for tick in 0..200 {
            let good = measured(tick, 2.0, 20.0);
            let mut bad = good;
            if tick == 100 {
                bad.q[3] += 0.2;
            }
            clean.study(&lesson(tick, Some(good), !(100..=130).contains(&tick)));
            glitched.study(&lesson(tick, Some(bad), true));
        }
        // A few places of the window weigh nothing in the acceleration; those rows are as good as the others.
        assert!(glitched.state.statistics.rejected >= 15);
        let apart = glitched.state.candidate.rigid - clean.state.candidate.rigid;
        let moved = clean.state.candidate.rigid - clean.state.prior.rigid;
        assert!(
            apart.amax() < 0.2 * moved.amax(),
            "{} of {}",
            apart.amax(),
            moved.amax()
        );
    }

    #[test]
    fn a_lying_torque_sensor_cannot_push_the_parameters_out_of_their_box() {
        let mut learner = learner();
        teach(&mut learner, 0..60_000, true);
        let LearnerState {
            prior, candidate, ..
        } = &learner.state;
        let config = &learner.config;
        let mut at_the_edge = 0;
        for i in 0..P {
            let moved = (candidate.rigid[i] - prior.rigid[i]).abs() / config.rigid_sigma[i];
            assert!(
                moved <= config.box_sigmas * 1.0001,
                "parameter {i} by {moved}"
            );
            at_the_edge += usize::from(moved > config.box_sigmas * 0.999);
        }
        for joint in 0..N {
            let friction = candidate.friction[joint];
            let sigma = config.friction_sigma[joint];
            assert!((0.0..=config.box_sigmas * sigma.viscous).contains(&friction.viscous));
            assert!((0.0..=config.box_sigmas * sigma.coulomb).contains(&friction.coulomb));
        }
        assert!(at_the_edge > 0, "the box was never touched");
        assert!(candidate.is_finite());
    }

    #[test]
    fn sets_are_published_when_a_round_closes_and_only_then() {
        let mut learner = learner();
        for tick in 0..60 {
            let mut exchange = Exchange::new();
            learner.learn(
                &lesson(tick, Some(measured(tick, 2.0, 20.0)), true),
                &mut exchange,
            );
            let published = exchange.published.map(|(tick, _)| tick);
            assert_eq!(published, (tick % 6 == 5).then_some(tick));
        }
        assert_eq!(learner.state.statistics.published, 10);
    }

    #[test]
    fn a_reloaded_set_is_taken_with_the_first_lesson_it_holds_for() {
        let mut learner = learner();
        let mut loaded = ParameterSet::nominal::<Ur5>(9);
        loaded.friction[0].coulomb = 3.0;
        let mut exchange = Exchange::new();
        exchange.reload = Some((42, loaded));
        for tick in 40..44 {
            learner.learn(&lesson(tick, None, true), &mut exchange);
            assert_eq!(learner.state.prior == loaded, tick >= 42, "tick {tick}");
            assert_eq!(learner.state.candidate == loaded, tick >= 42, "tick {tick}");
            assert_eq!(exchange.reload.is_none(), tick >= 42, "tick {tick}");
        }
    }

    #[test]
    fn a_configuration_that_cannot_work_is_refused() {
        let good = LearnerConfig::<N, P>::for_arm::<Ur5>(1e-3);
        let mut sigma = good;
        sigma.rigid_sigma[7] = 0.0;
        let mut rate = good;
        rate.network.learning_rate = f32::NAN;
        assert_eq!(good.validate(), Ok(()));
        assert_eq!(
            sigma.validate(),
            Err(ConfigError::NotPositive("rigid_sigma"))
        );
        assert_eq!(
            rate.validate(),
            Err(ConfigError::RateOutOfRange("network.learning_rate"))
        );
        assert!(
            LearnerConfig::<N, P>::for_arm::<Ur5>(0.0)
                .validate()
                .is_err()
        );
    }
}
