//! Hundredths of a second: the detector, and the trial after an alarm.

use super::row::cogging_attenuation_at;
use super::{Learner, count};
use crate::arm::Arm;
use crate::dynamics::{
    BaseParameters, COGGING_COLUMNS, FrictionParameters, friction, friction_load, friction_row,
    regressor_row, rnea,
};
use crate::joint::JointVector;
use crate::learning::conditioning::{AVERAGED, ConditionedSample};
use crate::learning::detector::Slice;
use crate::learning::payload::{payload_base, payload_row, payload_torque};
use crate::learning::quality::Phase;
use crate::math::sqrt;

/// Range of a joint's usual mean square, in units of the configured noise: white noise leaves a tenth in a slice of ten.
const SLICE_RANGE: (f32, f32) = (0.1, 400.0);
/// A slice counts up to this many times the usual mean square in it: what the detector is there for is not usual.
const SLICE_CLIP: f32 = 4.0;
/// Slices over which the usual mean square fades; the first ones are averaged.
const SLICE_MEMORY: u32 = 256;
/// Slices in which friction is off by the same while a payload is weighed: those of a second. A doubt about it weighs as
/// much as noise of so many times its variance, because no mean over slices makes it smaller.
const LASTING: f32 = 100.0;

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// One tick of measurements: gathers the slice, works on one joint of the slice before, learns one row.
    #[inline(never)]
    pub(super) fn work_through(
        &mut self,
        tick: u32,
        joint: usize,
        seen: &ConditionedSample<N>,
    ) -> Option<f32> {
        if !plausible::<A, N, P>(seen, self.config.acceleration_limit) {
            self.state.guard.forget_slices();
            count(&mut self.state.statistics.rejected);
            return None;
        }
        let residual = self.unexplained(seen);
        let gate = self.config.velocity_gate;
        let ticks = self.config.supervisor.block_ticks;
        let guard = &mut self.state.guard;
        if let Some(slice) = guard.decimator.push(&seen.motion, &residual, gate, ticks) {
            guard.waiting = Some((slice, 0));
        }
        if let Some((slice, turn)) = guard.waiting {
            guard.waiting = (turn + 1 < N).then_some((slice, turn + 1));
            self.weigh(tick, turn, &slice);
            if turn + 1 == N {
                self.judge(tick);
            }
        }
        self.learn_row(tick, joint, seen)
    }

    /// What the estimate leaves of the torques, the payload not counted, N × N·m.
    #[inline(never)]
    fn unexplained(&self, seen: &ConditionedSample<N>) -> JointVector<N> {
        let state = &self.state;
        let estimate = state.estimate.parameters();
        let mut drives = estimate.friction.map(FrictionParameters);
        // What the filter swallows of the cogging is in the torque as far as the active set asks for it.
        let active = drives.iter_mut().zip(&state.active.friction);
        for (joint, ((drive, active), &qd)) in active.zip(seen.motion.qd.iter()).enumerate() {
            let share = cogging_attenuation_at::<A, N, P>(joint, qd, self.config.inv_period);
            for column in COGGING_COLUMNS {
                let active = active[column];
                drive[column] = active + share * (drive[column] - active);
            }
        }
        let rigid = BaseParameters::<P>::from(estimate.rigid);
        seen.tau
            - rnea::<A, N, P>(&rigid, &seen.motion)
            - friction::<A, N, P>(&drives, &seen.motion.q, &seen.motion.qd)
    }

    /// One joint of a slice.
    #[inline(never)]
    fn weigh(&mut self, tick: u32, joint: usize, slice: &Slice<N>) {
        if self.own.is_some_and(|own| own != joint) {
            // What is left of a joint whose friction is not learnt here is no news.
            return;
        }
        let weighing = self.state.phase() == Phase::PayloadTest
            || self.state.guard.weighing(&self.config.supervisor);
        // The estimator rests meanwhile: the tick has time for it.
        let doubt = if weighing {
            self.friction_doubt(joint, slice)
        } else {
            0.0
        };
        let state = &mut self.state;
        let (Some(true), Some(&left), Some(limits), Some(&measured), Some(&innovation)) = (
            slice.moving.get(joint),
            slice.residual.get(joint),
            A::LIMITS.get(joint),
            state.estimate.variance().get(joint),
            state.innovation_variance.get(joint),
        ) else {
            return;
        };
        let row = regressor_row::<A, N, P>(joint, &slice.motion).data.0[0];
        let row = payload_row::<A, N, P>(&row);
        let unit = self.config.noise * limits.torque;
        let config = &self.config.supervisor;
        // What one measurement scatters, not the mean of some: the thresholds are in these units.
        let single = AVERAGED as f32 * measured;
        let sigma = unit * sqrt(single);
        let guard = &mut state.guard;
        let Some((usual, seen)) = guard.slice_variance.get_mut(joint) else {
            return;
        };
        let inflated = unit * sqrt(config.block_inflation * *usual + LASTING * doubt);
        match state.report.quality.phase {
            Phase::PayloadTest => guard
                .trial
                .note(&guard.payload, &row, left, sigma, inflated),
            Phase::Healthy => {
                let unexplained = left - payload_torque(&guard.payload, &row);
                let spread = unexplained / unit;
                let square = spread * spread;
                let expected = *usual + innovation - measured;
                let young = *seen < SLICE_MEMORY;
                *seen += u32::from(young);
                let most = if young {
                    SLICE_RANGE.1
                } else {
                    SLICE_CLIP * *usual
                };
                let counted = if square < most { square } else { most };
                *usual += (counted - *usual) / *seen as f32;
                if *usual < SLICE_RANGE.0 {
                    *usual = SLICE_RANGE.0;
                }
                if guard.weighing(config) {
                    guard.filter.update(&row, left, inflated);
                }
                let z = spread / sqrt(expected);
                if let Some(sum) = guard.detector.push(&config.detector, joint, z) {
                    self.raise_alarm(tick, joint, sum);
                }
            }
            Phase::Relearning | Phase::Stopped => {}
        }
    }

    /// Variance of what the friction of `joint` may be off by in the motion of `slice`, in units of the configured noise.
    #[inline(never)]
    fn friction_doubt(&self, joint: usize, slice: &Slice<N>) -> f32 {
        let motion = &slice.motion;
        let loads = friction_load::<A, N, P>(&motion.q);
        let (Some(&cycles), Some(&q), Some(&qd), Some(&load), Some(sigma), Some(limits)) = (
            A::COGGING_CYCLES.get(joint),
            motion.q.get(joint),
            motion.qd.get(joint),
            loads.get(joint),
            self.config.friction_sigma.get(joint),
            A::LIMITS.get(joint),
        ) else {
            return 0.0;
        };
        let inverse = 1.0 / (self.config.noise * limits.torque);
        let mut phi = friction_row(cycles, q, qd, load);
        for (phi, sigma) in phi.iter_mut().zip(sigma.0) {
            *phi *= sigma * inverse;
        }
        self.state.estimate.filter().friction_doubt(joint, &phi)
    }

    /// After the last joint of a slice.
    #[inline(never)]
    fn judge(&mut self, tick: u32) {
        let config = &self.config.supervisor;
        let guard = &mut self.state.guard;
        match self.state.report.quality.phase {
            Phase::PayloadTest => {
                let loaded = guard.loaded();
                let mut usual = 0.0;
                let joints = guard.slice_variance.iter();
                for ((square, _), measured) in joints.zip(self.state.estimate.variance()) {
                    usual += square / (AVERAGED as f32 * measured * N as f32);
                }
                let alone = self.own.is_some();
                let verdict = guard.trial.judge(config, loaded, alone, usual);
                if let Some(verdict) = verdict {
                    self.end_trial(tick, verdict);
                }
            }
            Phase::Healthy => {
                if guard.weighing(config) {
                    guard.payload = guard.filter.payload();
                    guard.payload_base = payload_base::<A, N, P>(&guard.payload);
                }
                if guard.loaded() {
                    guard.slices_carried = guard.slices_carried.saturating_add(1);
                }
            }
            Phase::Relearning | Phase::Stopped => {}
        }
    }
}

/// Nothing in `seen` is beyond what the arm can do. A model fitted to the impossible is worth nothing; a wild encoder
/// shows in the acceleration first.
fn plausible<A: Arm<N, P>, const N: usize, const P: usize>(
    seen: &ConditionedSample<N>,
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
