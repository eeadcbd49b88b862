//! Learning from one torque row: quality, estimate, evidence for the shares, network candidate.

use super::{Learner, TorqueChanges, increment};
use crate::arm::Arm;
use crate::dynamics::Pose;
use crate::joint::JointVector;
use crate::learning::conditioning::{ConditionedSample, cogging_attenuation, taps};
use crate::learning::config::LearnerConfig;
use crate::learning::decision::Reason;
use crate::learning::estimator::torque_row_at;
use crate::learning::exchange::MotionRange;
use crate::learning::parameters::{JointEntries, NETWORK_BOUND, dot, network_output};
use crate::learning::quality::Observation;
use crate::learning::trainer::{NetworkDecision, NetworkRow};
use crate::limits::cut;
use crate::math::sqrt;

/// Largest growth of the learnt range by one row, rad/s and rad/s²: one encoder error is no learnt motion.
const RANGE_STEP: (f32, f32) = (0.02, 0.2);

enum RowOutcome {
    Accepted,
    Gated,
    Frozen,
    Rejected,
}

struct JointRow<'a, const P: usize> {
    tick: u32,
    joint: usize,
    /// Torque limit, N·m.
    limit: f32,
    /// Joint velocity, rad/s.
    qd: f32,
    /// Measured torque, N·m.
    tau: f32,
    /// Torques of payload, loaded set and learnt set by their rigid bodies, N·m.
    payload: f32,
    loaded: f32,
    learnt: f32,
    columns: &'a JointEntries<P>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// Learn one row of `joint` and count its outcome.
    ///
    /// * returns the torque changes of the joint; `None` if they are unknown
    #[inline(never)]
    pub(super) fn learn_row(
        &mut self,
        tick: u32,
        joint: usize,
        sample: &ConditionedSample<N>,
        pose: &Pose<N>,
    ) -> Option<TorqueChanges> {
        let (outcome, changes) = self.row(tick, joint, sample, pose);
        let statistics = &mut self.state.statistics;
        increment(match outcome {
            RowOutcome::Gated => &mut statistics.gated,
            RowOutcome::Rejected => &mut statistics.rejected,
            RowOutcome::Frozen => &mut statistics.frozen,
            RowOutcome::Accepted => &mut statistics.accepted,
        });
        changes
    }

    /// Row of `joint`: used if the joint moves, else recorded as standstill.
    #[inline(never)]
    fn row(
        &mut self,
        tick: u32,
        joint: usize,
        sample: &ConditionedSample<N>,
        pose: &Pose<N>,
    ) -> (RowOutcome, Option<TorqueChanges>) {
        let (Some(limits), Some(&qd), Some(&tau)) = (
            A::limits().get(joint),
            sample.motion.qd.get(joint),
            sample.tau.get(joint),
        ) else {
            return (RowOutcome::Rejected, None);
        };
        let columns = torque_row_at::<A, N, P>(joint, pose, &sample.motion);
        let mut payload = 0.0;
        let beta = self.state.supervisor.payload_base.as_slice();
        for (column, beta) in columns.rigid.iter().zip(beta) {
            payload += column * beta;
        }
        let row = JointRow {
            tick,
            joint,
            limit: limits.torque,
            qd,
            tau,
            payload,
            loaded: columns.rigid_dot(&self.state.supervisor.loaded),
            learnt: columns.rigid_dot(&self.state.supervisor.learnt.set),
            columns: &columns,
        };
        let outcome = if qd.abs() >= self.config.velocity_gate {
            self.use_row(&row, sample)
        } else {
            RowOutcome::Gated
        };
        if matches!(outcome, RowOutcome::Rejected) {
            return (outcome, None);
        }
        let inv_limit = 1.0 / row.limit;
        let state = &self.state;
        let supervisor = &state.supervisor;
        let loaded = columns.friction_dot(joint, &supervisor.loaded) + row.loaded;
        let learnt = columns.friction_dot(joint, &supervisor.learnt.set) + row.learnt - loaded;
        let estimate = state.estimate.parameters();
        let estimated =
            columns.friction_dot(joint, estimate) + columns.rigid_dot(estimate) - loaded;
        let changes = TorqueChanges {
            learnt: learnt.abs() * inv_limit,
            estimate: (estimated - learnt).abs() * inv_limit,
        };
        (outcome, Some(changes))
    }

    /// Use the row of a moving joint: quality always; estimate, evidence, network and range while learning.
    fn use_row(&mut self, row: &JointRow<'_, P>, sample: &ConditionedSample<N>) -> RowOutcome {
        let joint = row.joint;
        let inv_limit = 1.0 / row.limit;
        let state = &mut self.state;
        let variance = state.estimate.variance().get(joint).copied();
        let sigma = self.config.noise * sqrt(variance.unwrap_or(1.0));
        let share = state.supervisor.learnt.share.joint.get(joint).copied();
        let learnt = row.learnt - row.loaded;
        let rigid = row.loaded + share.unwrap_or_default() * learnt + row.payload;
        let (Some(active), Some(network)) = (
            state.active.friction.get(joint),
            state.active.network.get(joint),
        ) else {
            return RowOutcome::Rejected;
        };
        let friction = dot(&row.columns.own, &active.0);
        let network = cut(network_output(network, row.qd), NETWORK_BOUND).0;
        let residual = (row.tau - rigid - friction) * inv_limit;
        let payload = row.payload * inv_limit;
        let benefit = &mut state.supervisor.payload_benefit;
        benefit.add_row(payload, residual - network + payload);
        let observation = Observation {
            measured: row.tau * inv_limit,
            residual: residual - network,
            shares: [rigid * inv_limit, friction * inv_limit, network],
        };
        state.monitor.add_row(joint, &observation);
        if !state.phase().learns() {
            return RowOutcome::Frozen;
        }
        let paused = state.supervisor.pauses_estimate(&self.config.supervisor);
        // The network learns the residual of the active set, which is in the torque, not that of the estimate. Under a payload
        // it is compared, too: what it gained before may cost now.
        let network_row = NetworkRow {
            qd: row.qd,
            residual,
            sigma,
            of_arm: !paused,
        };
        self.train_network(row.tick, joint, &network_row);
        let state = &mut self.state;
        let Some(active) = state.active.friction.get(joint) else {
            return RowOutcome::Rejected;
        };
        let mut columns = *row.columns;
        let gain = joint_attenuation::<A, N, P>(&self.config, joint, row.qd);
        let commanded = columns.attenuate_cogging(gain, active);
        let tau = row.tau - row.payload - commanded;
        let estimate = &mut state.estimate;
        let (config, limit) = (&self.config, row.limit);
        let variance = match paused {
            true => estimate.innovation_variance(config, joint, limit, &columns),
            false => estimate.correct_joint(config, joint, limit, &columns, tau),
        };
        let (Some(variance), Some(slot)) = (variance, state.innovation_variance.get_mut(joint))
        else {
            return RowOutcome::Rejected;
        };
        *slot = variance;
        if paused {
            return RowOutcome::Frozen;
        }
        let loaded = columns.friction_dot(joint, &state.supervisor.loaded) + row.loaded;
        let older = &state.supervisor.checkpoints[1].estimate;
        let older = columns.friction_dot(joint, older) + columns.rigid_dot(older);
        // The network is in the torque, beside the learnt part of the linear parameters.
        let tau = tau - network * row.limit;
        let torques = [tau, loaded, tau - older];
        let torques = torques.map(|torque| torque * inv_limit);
        let memory_s = self.config.supervisor.share_memory_s;
        let memory = memory_s * self.config.inv_period / N as f32;
        let evidence = &mut state.supervisor.learnt.evidence;
        evidence.add_row(joint, row.qd, torques, sigma, memory);
        increment(&mut state.supervisor.rows);
        grow(&mut self.state.range, &sample.motion.qd, &sample.motion.qdd);
        self.state.moves = true;
        RowOutcome::Accepted
    }

    /// Train the network candidate of `joint`, and record a promotion or silencing.
    fn train_network(&mut self, tick: u32, joint: usize, row: &NetworkRow) {
        let state = &mut self.state;
        let config = &self.config.supervisor;
        if !state.supervisor.trains_network(config, joint) {
            return;
        }
        let Some(active) = state.active.network.get_mut(joint) else {
            return;
        };
        let config = &self.config.network;
        match state.trainer.train(config, joint, row, active) {
            Some(NetworkDecision::Promoted(ratio)) => {
                state.record(tick, Reason::NetworkPromoted, Some(joint), ratio);
            }
            Some(NetworkDecision::Silenced(ratio)) => {
                state.record(tick, Reason::NetworkSilenced, Some(joint), ratio);
            }
            None => {}
        }
    }

    /// Share of the estimate in the torque of every joint by the evidence.
    #[inline(never)]
    pub(super) fn shares(&self) -> [f32; N] {
        core::array::from_fn(|joint| self.share(joint))
    }

    /// Share of the estimate in the torque of `joint` by the evidence.
    fn share(&self, joint: usize) -> f32 {
        let variance = self.state.estimate.variance().get(joint);
        let noise = self.config.noise * self.config.noise * self.state.estimate.correlation(joint);
        let evidence = &self.state.supervisor.learnt.evidence;
        variance.map_or(0.0, |variance| evidence.share(joint, variance * noise))
    }
}

/// Gain of the motion filter for the cogging of `joint` at the velocity `qd`, rad/s.
pub(super) fn joint_attenuation<A: Arm<N, P>, const N: usize, const P: usize>(
    config: &LearnerConfig<N, P>,
    joint: usize,
    qd: f32,
) -> f32 {
    let cycles = A::cogging_cycles().get(joint).copied().unwrap_or(0.0);
    let angle = cycles * qd * config.decimation as f32 / config.inv_period;
    cogging_attenuation(angle, taps(config.delay))
}

/// Extend `range` towards the motion of a used row.
fn grow<const N: usize>(range: &mut MotionRange<N>, qd: &JointVector<N>, qdd: &JointVector<N>) {
    let widen = |widest: &mut f32, value: f32, step: f32| {
        let beyond = value.abs() - *widest;
        if beyond > 0.0 {
            *widest += if beyond < step { beyond } else { step };
        }
    };
    let velocity = range.velocity.iter_mut().zip(qd.as_slice());
    velocity.for_each(|(widest, &qd)| widen(widest, qd, RANGE_STEP.0));
    let acceleration = range.acceleration.iter_mut().zip(qdd.as_slice());
    acceleration.for_each(|(widest, &qdd)| widen(widest, qdd, RANGE_STEP.1));
}
