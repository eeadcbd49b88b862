use super::conditioning::{Conditioned, MeasurementWindow};
use super::config::{ConfigError, LearnerConfig};
use super::parameters::{ParameterSet, network_inputs};
use super::{Exchange, Lesson};
use crate::arm::Arm;
use crate::dynamics::{friction_row, regressor_row};
use crate::limits::cut;
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
    /// The set being learnt. It becomes visible to the tick only whole, at the end of a round.
    pub candidate: ParameterSet<N, P>,
    /// What became of the rows.
    pub statistics: LearnerStatistics,
    window: MeasurementWindow<N>,
    next_tick: u32,
    closed_round: Option<u32>,
}

/// Learns the parameters of an arm from the lessons of the ticks, one torque row a tick, joint `tick % N`.
///
/// Linear parameters (rigid body, friction) by normalised least mean squares in units of their prior standard deviation;
/// the joint's network by back-propagation on what remains. A recursive estimator can take the place of the former
/// without a change at this door.
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
                candidate: prior,
                statistics: LearnerStatistics::default(),
                window: MeasurementWindow::new(),
                next_tick: 0,
                closed_round: None,
            },
            arm: PhantomData,
        })
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
            self.state.prior = set;
            self.state.candidate = set;
            self.state.closed_round = None;
        }
    }

    /// Learns from one lesson. Does not touch the desk, so the tick may run in the middle of it.
    ///
    /// Cost: the filter of all joints, one regressor row, and about `4 P` multiply-adds; the joint's network once.
    pub fn study(&mut self, lesson: &Lesson<N>) {
        if lesson.tick != self.state.next_tick {
            self.state.window.reset();
        }
        self.state.next_tick = lesson.tick.wrapping_add(1);
        self.state.window.push(lesson.measured.as_ref());
        let joint = lesson.tick as usize % N;
        if lesson.enabled {
            match self.state.window.conditioned(self.config.inv_period) {
                Some(seen) => self.learn_row(joint, &seen),
                None => count(&mut self.state.statistics.incomplete),
            }
        }
        if joint == N - 1 {
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

    /// One row of joint `joint`, into the candidate.
    fn learn_row(&mut self, joint: usize, seen: &Conditioned<N>) {
        let verdict = match self.row(joint, seen) {
            Verdict::Gated => &mut self.state.statistics.gated,
            Verdict::Rejected => &mut self.state.statistics.rejected,
            Verdict::Accepted => &mut self.state.statistics.accepted,
        };
        count(verdict);
    }

    /// ```text
    /// e   = clip((tau − φᵀθ) / limit)                 residual of the linear model
    /// φ'_i = φ_i σ_i / limit                          row in units of prior standard deviations
    /// θ_i ← box(θ_i + rate · σ_i φ'_i e / (noise² + |φ'|²))
    /// w   ← one step of the network towards e
    /// ```
    /// [Haykin 2002, ch. 6 (normalised LMS)], in the scaled parameters θ/σ.
    fn row(&mut self, joint: usize, seen: &Conditioned<N>) -> Verdict {
        let config = &self.config;
        let candidate = &mut self.state.candidate;
        let prior = &self.state.prior;
        let (Some(limits), Some(&qd), Some(&tau)) = (
            A::LIMITS.get(joint),
            seen.motion.qd.get(joint),
            seen.tau.get(joint),
        ) else {
            return Verdict::Rejected;
        };
        let (Some(friction), Some(friction_prior), Some(friction_sigma), Some(network)) = (
            candidate.friction.get_mut(joint),
            prior.friction.get(joint),
            config.friction_sigma.get(joint),
            candidate.network.get_mut(joint),
        ) else {
            return Verdict::Rejected;
        };
        if qd.abs() < config.velocity_gate {
            return Verdict::Gated;
        }
        let moves = seen.motion.qd.iter().zip(&A::LIMITS);
        if !moves.fold(true, |ok, (qd, limits)| {
            ok & (qd.abs() <= 2.0 * limits.velocity)
        }) || tau.abs() > 2.0 * limits.torque
        {
            return Verdict::Rejected;
        }
        let scale = 1.0 / limits.torque;
        let row = regressor_row::<A, N, P>(joint, &seen.motion);
        let [viscous, coulomb] = friction_row(qd);
        let explained =
            dot(&row, &candidate.rigid) + viscous * friction.viscous + coulomb * friction.coulomb;
        let residual = (tau - explained) * scale;
        let viscous_scaled = viscous * friction_sigma.viscous * scale;
        let coulomb_scaled = coulomb * friction_sigma.coulomb * scale;
        let mut power = config.noise * config.noise
            + viscous_scaled * viscous_scaled
            + coulomb_scaled * coulomb_scaled;
        for (&row, &sigma) in row.iter().zip(&config.rigid_sigma) {
            let scaled = row * sigma * scale;
            power += scaled * scaled;
        }
        // Infinite or not-a-number anywhere above ends up in one of these two.
        if !(residual.is_finite() && power.is_finite()) {
            return Verdict::Rejected;
        }
        let (clipped, _) = cut(residual, config.residual_clip);
        let gain = config.rate * clipped / power * scale;
        for (((theta, &row), &sigma), &prior) in candidate
            .rigid
            .iter_mut()
            .zip(row.iter())
            .zip(&config.rigid_sigma)
            .zip(prior.rigid.iter())
        {
            *theta = boxed(
                *theta + gain * sigma * sigma * row,
                prior,
                config.box_sigmas * sigma,
            );
        }
        let sigma = friction_sigma.viscous;
        let step = gain * sigma * sigma * viscous;
        friction.viscous = positive(boxed(
            friction.viscous + step,
            friction_prior.viscous,
            config.box_sigmas * sigma,
        ));
        let sigma = friction_sigma.coulomb;
        let step = gain * sigma * sigma * coulomb;
        friction.coulomb = positive(boxed(
            friction.coulomb + step,
            friction_prior.coulomb,
            config.box_sigmas * sigma,
        ));
        // The network refuses by itself what is not finite.
        network.update(
            &network_inputs(qd),
            &SVector::from([residual]),
            &config.network,
        );
        Verdict::Accepted
    }
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

fn dot<const P: usize>(a: &SVector<f32, P>, b: &SVector<f32, P>) -> f32 {
    a.iter().zip(b.iter()).map(|(a, b)| a * b).sum()
}

fn boxed(value: f32, centre: f32, reach: f32) -> f32 {
    if value > centre + reach {
        centre + reach
    } else if value < centre - reach {
        centre - reach
    } else {
        value
    }
}

fn positive(value: f32) -> f32 {
    if value > 0.0 { value } else { 0.0 }
}
