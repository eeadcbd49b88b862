//! One torque row: what the estimate, the evidence, the network and the monitor make of it.

use super::{Learner, count};
use crate::arm::Arm;
use crate::joint::JointVector;
use crate::learning::NETWORK_BOUND;
use crate::learning::conditioning::{ConditionedSample, cogging_attenuation};
use crate::learning::decision::Reason;
use crate::learning::estimator::torque_row;
use crate::learning::exchange::MotionRange;
use crate::learning::monitor::Observation;
use crate::learning::parameters::network_inputs;
use crate::learning::stacked::LinearParameters;
use crate::learning::trainer::{NetworkRow, NetworkVerdict};
use crate::limits::cut;
use crate::math::sqrt;

/// By how much the range may grow with one row, rad/s and rad/s²: one glitch of an encoder is not a motion that was
/// learnt.
const RANGE_STEP: (f32, f32) = (0.02, 0.2);

/// What became of a row.
enum Verdict {
    Accepted,
    Gated,
    Frozen,
    Rejected,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// One row of joint `joint`. Returns by how much the estimate would change the joint's torque, in units of its limit.
    #[inline(never)]
    pub(super) fn learn_row(
        &mut self,
        tick: u32,
        joint: usize,
        seen: &ConditionedSample<N>,
    ) -> Option<f32> {
        let (verdict, step) = self.row(tick, joint, seen);
        let statistics = &mut self.state.statistics;
        count(match verdict {
            Verdict::Gated => &mut statistics.gated,
            Verdict::Rejected => &mut statistics.rejected,
            Verdict::Frozen => &mut statistics.frozen,
            Verdict::Accepted => &mut statistics.accepted,
        });
        step
    }

    /// The linear parameters take what they can explain; the joint's network is trained on what remained before.
    #[inline(never)]
    fn row(
        &mut self,
        tick: u32,
        joint: usize,
        seen: &ConditionedSample<N>,
    ) -> (Verdict, Option<f32>) {
        let (Some(limits), Some(&speed), Some(&tau)) = (
            A::LIMITS.get(joint),
            seen.motion.qd.get(joint),
            seen.tau.get(joint),
        ) else {
            return (Verdict::Rejected, None);
        };
        let limit = limits.torque;
        let inv_limit = 1.0 / limit;
        let row = torque_row::<A, N, P>(joint, seen);
        let state = &mut self.state;
        let mut carried = 0.0;
        for (row, beta) in row.rigid.iter().zip(state.guard.payload_base.iter()) {
            carried += row * beta;
        }
        // What is left for the arm itself.
        let own = tau - carried;
        let mut verdict = Verdict::Gated;
        if speed.abs() >= self.config.velocity_gate {
            let variance = state.estimate.variance().get(joint).copied();
            let sigma = self.config.noise * sqrt(variance.unwrap_or(1.0));
            let active = LinearParameters::of(&state.active);
            let rigid = row.rigid_dot(&active) + carried;
            let friction = row.friction_dot(&active);
            let [[said]] = match state.active.network.get(joint) {
                Some(network) => network.forward(&network_inputs(speed)).data.0,
                None => return (Verdict::Rejected, None),
            };
            let network = cut(said, NETWORK_BOUND).0;
            state.monitor.note(
                joint,
                &Observation {
                    measured: tau * inv_limit,
                    residual: (tau - rigid - friction) * inv_limit - network,
                    shares: [rigid * inv_limit, friction * inv_limit, network],
                },
            );
            verdict = Verdict::Frozen;
            if state.phase().learns() && !state.guard.resting() {
                let mut heard = row;
                let share = cogging_attenuation_at::<A, N, P>(joint, speed, self.config.inv_period);
                let own = own - heard.attenuate_cogging(joint, share, &active);
                let correction = state
                    .estimate
                    .correct(&self.config, joint, limit, &heard, own);
                let Some(correction) = correction else {
                    return (Verdict::Rejected, None);
                };
                if let Some(slot) = state.innovation_variance.get_mut(joint) {
                    *slot = correction.variance;
                }
                let inverse = inv_limit / sigma;
                let champion = heard.dot(&state.guard.committed);
                state.guard.evidence.note(
                    joint,
                    own * inverse,
                    champion * inverse,
                    correction.residual / sigma,
                    sigma,
                );
                let lesson = NetworkRow {
                    qd: speed,
                    // What is in the torque, not what is estimated beside it.
                    residual: (tau - rigid - friction) * inv_limit,
                    sigma,
                };
                let trained = match state.active.network.get_mut(joint) {
                    Some(active) if state.guard.trains() => {
                        let config = &self.config.network;
                        state.trainer.train(config, joint, &lesson, active)
                    }
                    _ => None,
                };
                match trained {
                    Some(NetworkVerdict::Promoted(ratio)) => {
                        state.note(tick, Reason::NetworkPromoted, Some(joint), ratio);
                    }
                    Some(NetworkVerdict::Silenced(ratio)) => {
                        state.note(tick, Reason::NetworkSilenced, Some(joint), ratio);
                    }
                    None => {}
                }
                grow(&mut state.range, &seen.motion.qd, &seen.motion.qdd);
                verdict = Verdict::Accepted;
            }
        }
        let state = &mut self.state;
        let estimated = row.dot(state.estimate.parameters());
        if matches!(verdict, Verdict::Gated) {
            let change = estimated - row.dot(&state.guard.committed);
            state.guard.evidence.note_still(joint, change * inv_limit);
        }
        let step = estimated - row.dot(&LinearParameters::of(&state.active));
        (verdict, Some(step * inv_limit))
    }
}

/// Share of the cogging of `joint` at `speed`, rad/s, that reaches the learner's motion.
pub(super) fn cogging_attenuation_at<A: Arm<N, P>, const N: usize, const P: usize>(
    joint: usize,
    speed: f32,
    inv_period: f32,
) -> f32 {
    let cycles = A::COGGING_CYCLES.get(joint).copied().unwrap_or(0.0);
    cogging_attenuation(cycles * speed / inv_period)
}

/// Widens `range` towards the motion of a row that was learnt from.
fn grow<const N: usize>(range: &mut MotionRange<N>, qd: &JointVector<N>, qdd: &JointVector<N>) {
    let widen = |widest: &mut f32, value: f32, step: f32| {
        let beyond = value.abs() - *widest;
        if beyond > 0.0 {
            *widest += if beyond < step { beyond } else { step };
        }
    };
    let velocity = range.velocity.iter_mut().zip(qd.iter());
    velocity.for_each(|(widest, &qd)| widen(widest, qd, RANGE_STEP.0));
    let acceleration = range.acceleration.iter_mut().zip(qdd.iter());
    acceleration.for_each(|(widest, &qdd)| widen(widest, qdd, RANGE_STEP.1));
}
