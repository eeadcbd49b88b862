//! Work on one block: change detection, and the payload during and after a payload test.

use super::row::joint_attenuation;
use super::{Learner, TorqueChanges, increment};
use crate::arm::Arm;
use crate::dynamics::{
    BaseParameters, COGGING_COLUMNS, FRICTION_COLUMNS, FrictionColumn, FrictionParameters,
    FrictionPoint, Pose, friction_under, regressor_row_at, rnea_of,
};
use crate::joint::JointVector;
use crate::learning::change_detection::Block;
use crate::learning::conditioning::{AVERAGED, ConditionedSample};
use crate::learning::estimator::joint_friction_row;
use crate::learning::parameters::JointEntries;
use crate::learning::payload::{payload_row, payload_torque};
use crate::learning::quality::Phase;
use crate::learning::supervisor::payload_test::PayloadDecision;
use crate::learning::supervisor::step::Evidence;
use crate::math::sqrt;

/// Least usual block variance of a joint, in units of the configured noise. White noise leaves a tenth in a block of ten.
const LEAST_BLOCK_VARIANCE: f32 = 0.1;
/// Memory of the usual variance, blocks; the first ones are averaged.
const BLOCK_MEMORY: u32 = 256;
/// Correlation length of the friction error, parts of the time for which errors of the estimate last: 1 s. Averaging blocks
/// does not reduce this error, so its variance counts once for each of them.
const FRICTION_CORRELATION: f32 = 2.0 / 3.0;

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// One tick of learning: average the block, process one joint of the last block, learn one row of `joint`.
    ///
    /// * returns the torque changes of the joint; `None` if they are unknown
    #[inline(never)]
    pub(super) fn process_sample(
        &mut self,
        tick: u32,
        joint: usize,
        sample: &ConditionedSample<N>,
    ) -> Option<TorqueChanges> {
        let pose = Pose::of::<A, P>(&sample.motion.q);
        let plausible = is_plausible::<A, N, P>(sample, self.config.acceleration_limit);
        let Some(pose) = pose.filter(|_| plausible) else {
            self.state.supervisor.reset_blocks();
            increment(&mut self.state.statistics.rejected);
            return None;
        };
        let residual = self.residual_torque(sample, &pose);
        let gate = self.config.velocity_gate;
        let length = self.config.supervisor.block_ticks;
        let supervisor = &mut self.state.supervisor;
        let average = &mut supervisor.block_average;
        if let Some(block) = average.push(&sample.motion, &residual, gate, length) {
            supervisor.pending_block = Some((block, 0));
        }
        if let Some((block, turn)) = supervisor.pending_block {
            supervisor.pending_block = (turn + 1 < N).then_some((block, turn + 1));
            self.process_block(tick, turn, &block);
            if turn + 1 == N {
                self.decide(tick, &block);
            }
        }
        if self.only_joint.is_some_and(|only| only != joint) {
            // The torque of the other joints is not used, so its step does not limit following.
            return Some(TorqueChanges::default());
        }
        self.learn_row(tick, joint, sample, &pose)
    }

    /// Residual torque of the estimate without payload, N × N·m.
    #[inline(never)]
    fn residual_torque(&self, sample: &ConditionedSample<N>, pose: &Pose<N>) -> JointVector<N> {
        let state = &self.state;
        let estimate = state.estimate.parameters();
        let mut drives = estimate.friction.map(FrictionParameters);
        // Cogging removed by the motion filter is in the torque as far as the active set commands it.
        let active = drives.iter_mut().zip(&state.active.friction);
        for (joint, ((drive, active), &qd)) in active.zip(sample.motion.qd.as_slice()).enumerate() {
            let gain = joint_attenuation::<A, N, P>(&self.config, joint, qd);
            for column in COGGING_COLUMNS {
                let active = active[column];
                drive[column] = active + gain * (drive[column] - active);
            }
        }
        let rigid = BaseParameters::<P>::from(estimate.rigid);
        let motion = &sample.motion;
        let mut torque = [JointVector::zeros()];
        rnea_of::<A, N, P, 1>([&rigid], &pose.angles, motion, &mut torque);
        let [torque] = torque;
        sample.tau - torque - friction_under::<A, N, P>(&drives, &motion.q, &motion.qd, &pose.load)
    }

    /// Process `joint` of `block`: a row of the payload test, or change detection and update of the payload filter. At rest it
    /// only shows whether the payload in the torque is still there.
    #[inline(never)]
    fn process_block(&mut self, tick: u32, joint: usize, block: &Block<N>) {
        if self.only_joint.is_some_and(|only| only != joint) {
            // Friction of other joints is not learnt here, so their residuals are no evidence.
            return;
        }
        let Some(pose) = Pose::of::<A, P>(&block.motion.q) else {
            return;
        };
        let config = &self.config.supervisor;
        let phase = self.state.phase();
        // The estimate pauses meanwhile, so the tick has time for the prediction variance.
        let updates = self.state.supervisor.updates_payload(config);
        let friction_variance = if phase == Phase::PayloadTest || updates {
            self.friction_prediction_variance(joint, block, &pose.load)
        } else {
            0.0
        };
        let state = &mut self.state;
        let (Some(&moving), Some(&tau), Some(limits), Some(&measured), Some(&innovation)) = (
            block.moving.get(joint),
            block.residual.get(joint),
            A::limits().get(joint),
            state.estimate.variance().get(joint),
            state.innovation_variance.get(joint),
        ) else {
            return;
        };
        if !(moving || phase == Phase::Healthy && state.supervisor.carries_payload) {
            return;
        }
        // Built here and not by `torque_row_at`, to spare the stack.
        let own = joint_friction_row::<A, N, P>(joint, &pose.load, &block.motion);
        let columns = JointEntries {
            own: own.unwrap_or_default(),
            rigid: regressor_row_at::<A, N, P>(joint, &pose.angles, &block.motion)
                .data
                .0[0],
        };
        let row = payload_row::<A, N, P>(&columns.rigid);
        let unit = self.config.noise * limits.torque;
        // Correlated rows of the joint in a block, as one observation.
        let rows = config.block_ticks as f32 / N as f32;
        let noise = state.estimate.correlation(joint) * measured / rows;
        let supervisor = &mut state.supervisor;
        let Some((usual, blocks)) = supervisor.block_variance.get_mut(joint) else {
            return;
        };
        // Variance by the error of the estimate; unknown before the first row of the joint.
        let error = (innovation - measured).max(0.0);
        let expected = *usual + error;
        if !moving {
            let friction = &state.estimate.parameters().friction;
            let (Some(friction), Some(&load)) = (friction.get(joint), pose.load.get(joint)) else {
                return;
            };
            let friction = breakaway_torque(friction, load);
            let variance = unit * unit * expected + friction * friction;
            let payload = payload_torque(&supervisor.payload, &row);
            supervisor.payload_test.add_rest(payload, tau, variance);
            return;
        }
        let correlated = FRICTION_CORRELATION * config.lasting_blocks as f32;
        let inflated = unit * sqrt(noise + correlated * friction_variance);
        // Thresholds are in variances of one measurement, not of a mean.
        let sigma = unit * sqrt(AVERAGED as f32 * measured);
        let lasting = error * config.lasting_blocks as f32;
        let deviation = match phase {
            Phase::PayloadTest => inflated,
            Phase::Healthy => unit * sqrt(noise + lasting),
            Phase::Relearning | Phase::Stopped => return,
        };
        // The estimate absorbs a part of the body before there is enough evidence; that of before the window does not.
        let absorbed = match supervisor.carries_payload {
            true => 0.0,
            false => {
                let before = &supervisor.before_payload.estimate;
                columns.change(joint, before, state.estimate.parameters())
            }
        };
        let payload = &supervisor.payload;
        let test = &mut supervisor.payload_test;
        let rival = tau - payload_torque(payload, &row);
        test.add_row(
            joint,
            payload,
            &row,
            [tau + absorbed, rival],
            [sigma, deviation],
        );
        if phase == Phase::Healthy {
            let residual = (tau - payload_torque(payload, &row)) / unit;
            update_block_variance(usual, blocks, residual, config.detector.clip);
            if updates {
                supervisor.payload_filter.update(&row, tau, inflated);
            }
            let z = residual / sqrt(expected);
            if let Some(sum) = supervisor.detector.push(&config.detector, joint, z) {
                self.decide_on(tick, Some(joint), Evidence::Change(sum));
            }
        }
    }

    /// Prediction variance of the friction torque of `joint` in the motion of `block`, in units of the configured noise.
    #[inline(never)]
    fn friction_prediction_variance(
        &self,
        joint: usize,
        block: &Block<N>,
        load: &JointVector<N>,
    ) -> f32 {
        let (Some(own), Some(sigma), Some(limits)) = (
            joint_friction_row::<A, N, P>(joint, load, &block.motion),
            self.config.sigma.friction.get(joint),
            A::limits().get(joint),
        ) else {
            return 0.0;
        };
        let row = JointEntries {
            own,
            ..JointEntries::ZERO
        };
        let phi = row.scaled(sigma, &row.rigid, 1.0 / (self.config.noise * limits.torque));
        self.state
            .estimate
            .filter()
            .prediction_variance(joint, &phi)
    }

    /// Decision after the last joint of a block: end of the payload test; update of the payload in the torque.
    #[inline(never)]
    fn decide(&mut self, tick: u32, block: &Block<N>) {
        let config = &self.config.supervisor;
        let phase = self.state.phase();
        let supervisor = &mut self.state.supervisor;
        supervisor.payload_benefit.end_block(config.lasting_blocks);
        // Of an arm at rest nothing can be learnt: the test waits for its motion.
        let of_joint = self.only_joint.and_then(|joint| block.moving.get(joint));
        let moving = of_joint.map_or(block.moving.contains(&true), |moving| *moving);
        let waits = phase == Phase::PayloadTest && !moving;
        if waits || !matches!(phase, Phase::PayloadTest | Phase::Healthy) {
            return;
        }
        let (mut usual, mut known) = (0.0, 0.0);
        let joints = supervisor.block_variance.iter();
        for ((square, blocks), measured) in joints.zip(self.state.estimate.variance()) {
            if *blocks > 0 {
                usual += square / (AVERAGED as f32 * measured);
                known += 1.0;
            }
        }
        if known > 0.0 {
            usual /= known;
        }
        let carries_payload = supervisor.carries_payload;
        let single = self.only_joint.is_some() || N == 1;
        let decision = if supervisor.payload_costs(config) {
            Some(PayloadDecision::Release)
        } else {
            let test = &mut supervisor.payload_test;
            test.decide(config, carries_payload, single, usual)
        };
        if phase == Phase::Healthy {
            if supervisor.updates_payload(config) {
                let payload = supervisor.payload_filter.payload();
                supervisor.set_payload::<A>(&payload);
            }
            if carries_payload {
                supervisor.blocks_carried = supervisor.blocks_carried.saturating_add(1);
            }
            if !decision.is_some_and(PayloadDecision::is_change) {
                let test = &mut supervisor.payload_test;
                if test.is_over(config) {
                    test.next_window(config, &supervisor.payload);
                    supervisor.keep_checkpoint();
                }
                return;
            }
        }
        if let Some(decision) = decision {
            self.end_payload_test(tick, decision);
        }
    }
}

/// Friction torque of a joint that begins to move, N·m.
///
/// * `friction` parameters of the joint      * `load` torque that its gear carries, N·m
fn breakaway_torque(friction: &[f32; FRICTION_COLUMNS], load: f32) -> f32 {
    let begin = FrictionPoint {
        qd: 0.0,
        sign: 1.0,
        load,
        cogging_sin: 0.0,
        cogging_cos: 0.0,
    };
    let friction = FrictionParameters(*friction);
    friction.torque(&begin.columns()) - friction[FrictionColumn::Offset]
}

/// Update the usual variance with the `residual` of one block; `blocks` is the number of blocks behind it.
///
/// A residual counts up to `clip` standard deviations, the bound of change detection. With a lower bound, model errors that
/// return in bursts would never raise the variance, and each burst would raise an alarm.
fn update_block_variance(usual: &mut f32, blocks: &mut u32, residual: f32, clip: f32) {
    *blocks += u32::from(*blocks < BLOCK_MEMORY);
    let (square, most) = (residual * residual, clip * clip * *usual);
    let counted = if square < most { square } else { most };
    *usual += (counted - *usual) / *blocks as f32;
    if *usual < LEAST_BLOCK_VARIANCE {
        *usual = LEAST_BLOCK_VARIANCE;
    }
}

/// True if the arm can move and load its joints as in `sample`. An encoder error shows in the acceleration first.
fn is_plausible<A: Arm<N, P>, const N: usize, const P: usize>(
    sample: &ConditionedSample<N>,
    acceleration_limit: f32,
) -> bool {
    let motion = sample.motion.qd.as_slice().iter();
    let motion = motion.zip(sample.motion.qdd.as_slice());
    let mut joints = motion.zip(sample.tau.as_slice()).zip(A::limits());
    joints.all(|(((qd, qdd), tau), limits)| {
        qd.abs() <= 2.0 * limits.velocity
            && qdd.abs() <= acceleration_limit
            && tau.abs() <= 2.0 * limits.torque
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{LearnerConfig, Ur5};
    use crate::learning::change_detection::ChangeDetector;

    /// Blocks at which a joint's residuals raise an alarm.
    fn alarms(residuals: impl Iterator<Item = f32>) -> std::vec::Vec<usize> {
        let config = LearnerConfig::for_arm::<Ur5>(1e-3).supervisor.detector;
        let mut detector = ChangeDetector::<1>::new();
        let (mut usual, mut blocks) = (1.0, 0);
        let alarm = |(block, residual): (usize, f32)| {
            let alarm = detector.push(&config, 0, residual / sqrt(usual));
            update_block_variance(&mut usual, &mut blocks, residual, config.clip);
            alarm.map(|_| {
                detector = ChangeDetector::new();
                block
            })
        };
        residuals.enumerate().filter_map(alarm).collect()
    }

    #[test]
    fn bursts_that_return_are_usual_and_a_change_is_not() {
        // Every 2 s of a path the model errs for 0.2 s.
        let bursts = |block| if block % 200 < 180 { 1.0 } else { 6.0 };
        let known = alarms((0..4000).map(bursts));
        assert!(known.iter().all(|block| *block < 400), "{known:?}");
        let changed = (0..4000).map(|block| bursts(block) + if block < 3000 { 0.0 } else { 20.0 });
        let first = alarms(changed).into_iter().find(|block| *block >= 3000);
        assert!(first.is_some_and(|block| block < 3010), "{first:?}");
    }
}
