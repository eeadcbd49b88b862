//! Decisions of the supervisor carried out: freeze, alarm, end of a payload test, requests, and the close of a round.

use super::{Learner, LearnerState};
use crate::arm::Arm;
use crate::dynamics::{FRICTION_COLUMNS, FrictionParameters};
use crate::learning::change_detection::ChangeDetector;
use crate::learning::config::LearnerConfig;
use crate::learning::decision::Reason;
use crate::learning::exchange::{LearningSample, Request};
use crate::learning::payload::{NO_PAYLOAD, payload_estimate};
use crate::learning::quality::{PayloadEstimate, Phase};
use crate::learning::shares::blend;
use crate::learning::supervisor::Checkpoint;
use crate::learning::supervisor::payload_test::{PayloadBenefit, PayloadDecision};
use crate::learning::supervisor::step::{Action, Evidence, Round, step};
use crate::limits::Flags;

/// Rounds between two updates of trust.
const TRUST_ROUNDS: u32 = 16;

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// True if learning is on and not frozen at `sample`; records freezes and resumptions.
    #[inline(never)]
    pub(super) fn may_learn(&mut self, sample: &LearningSample<N>) -> bool {
        if !sample.enabled {
            self.decide_on(sample.tick, None, Evidence::Off);
            let state = &mut self.state;
            state.frozen = None;
            state.supervisor.reset_blocks();
            return false;
        }
        let state = &mut self.state;
        if state.phase() == Phase::Stopped {
            return false;
        }
        let reason = if sample.flags.contains(Flags::NOT_FINITE) {
            Some(Reason::FrozenNotFinite)
        } else if sample.flags.contains(Flags::STALE_SAMPLE) && !state.window.is_full() {
            Some(Reason::FrozenStale)
        } else if sample.flags.contains(Flags::SATURATED) {
            Some(Reason::FrozenSaturated)
        } else {
            None
        };
        if let Some(reason) = reason {
            if state.frozen.is_none() {
                state.record(sample.tick, reason, None, 0.0);
            }
            state.frozen = Some(reason);
            state.resume_in = self.config.filter_ticks();
        } else if state.frozen.is_some() {
            state.resume_in = state.resume_in.saturating_sub(1);
            if state.resume_in == 0 {
                state.frozen = None;
                state.record(sample.tick, Reason::Resumed, None, 0.0);
            }
        }
        if state.frozen.is_some() {
            state.supervisor.reset_blocks();
        }
        state.frozen.is_none()
    }

    /// Decision of the supervisor on `evidence`, carried out and recorded.
    #[inline(never)]
    pub(super) fn decide_on(&mut self, tick: u32, joint: Option<usize>, evidence: Evidence) {
        let before = self.state.supervisor.state;
        let decided = step(&self.config.supervisor, &before, evidence);
        let state = &mut self.state;
        state.supervisor.state = decided.state;
        state.report.quality.phase = decided.state.phase;
        if let Some((reason, figure)) = decided.reason {
            state.record(tick, reason, joint, figure);
        }
        match decided.action {
            Action::None => return,
            Action::Follow { set, commit } => {
                self.follow(set);
                self.state.commit_due |= commit;
                return;
            }
            Action::TestPayload => {
                state.restore();
                let supervisor = &mut state.supervisor;
                let payload = supervisor.checkpoints[1].payload;
                supervisor.set_payload::<A>(&payload);
                supervisor.keep_checkpoint();
                let test = &mut supervisor.payload_test;
                test.restart(&self.config.supervisor, &supervisor.payload);
                return;
            }
            Action::Restore => state.restore(),
            Action::Promote => {
                let supervisor = &mut state.supervisor;
                // Rows of the window contain the body. Under a payload the checkpoint of before it is kept for the release.
                if !supervisor.carries_payload {
                    supervisor.checkpoints[1] = supervisor.before_payload;
                    supervisor.rows_before = state.estimate.rows();
                } else {
                    supervisor.fade_evidence_of_before(&self.config);
                }
                state.restore();
                let supervisor = &mut state.supervisor;
                supervisor.payload_filter = supervisor.payload_test.filter;
                let payload = supervisor.payload_filter.payload();
                supervisor.set_payload::<A>(&payload);
                supervisor.blocks_carried = 0;
                supervisor.payload_benefit = PayloadBenefit::NONE;
                supervisor.carries_payload = true;
            }
            Action::Release => state.release_payload(&self.config),
            Action::Relearn => {
                let supervisor = &mut state.supervisor;
                // The change under a payload is learnt.
                let carried = supervisor.blocks_carried;
                supervisor.blocks_carried = carried.max(self.config.supervisor.pause_blocks);
                let evidence = &mut state.supervisor.learnt.evidence;
                evidence.fade(self.config.lasting_part());
                state.record(tick, Reason::Relearning, None, 0.0);
            }
            Action::Resume => {}
            Action::Snapshot => {
                state.snapshot = Some((state.supervisor.learnt, state.active.network));
                return;
            }
            Action::Rollback => state.roll_back(),
            Action::Commit => {
                state.commit_due = true;
                return;
            }
        }
        let supervisor = &mut state.supervisor;
        let test = &mut supervisor.payload_test;
        test.restart(&self.config.supervisor, &supervisor.payload);
        state.resume_detection();
    }

    /// End of the payload test with `decision`.
    #[inline(never)]
    pub(super) fn end_payload_test(&mut self, tick: u32, decision: PayloadDecision) {
        let supervisor = &self.state.supervisor;
        let test = &supervisor.payload_test;
        let ticks = test.blocks as f32 * self.config.supervisor.block_ticks as f32;
        let mass = match decision {
            PayloadDecision::Promote => test.filter.payload()[0],
            _ => supervisor.payload[0],
        };
        let evidence = Evidence::Payload {
            decision,
            mass,
            seconds: ticks / self.config.inv_period,
        };
        self.decide_on(tick, None, evidence);
    }

    /// Execute a request of the owner of the board.
    #[inline(never)]
    pub(super) fn execute(&mut self, tick: u32, request: Request) {
        let evidence = Evidence::Request {
            request,
            mass: self.state.supervisor.payload[0],
            snapshot: self.state.snapshot.is_some(),
        };
        self.decide_on(tick, None, evidence);
    }

    /// Close of a round, after the last joint: follow; checkpoint; report.
    #[inline(never)]
    pub(super) fn close_round(&mut self, tick: u32) {
        let state = &mut self.state;
        let restored = core::mem::take(&mut state.restored);
        let moves = core::mem::take(&mut state.moves);
        let known = !restored && state.round_changes.iter().all(Option::is_some);
        state.round_ticks = state.round_ticks.saturating_add(N as u32);
        if state.phase().learns() && known {
            if moves && state.phase() == Phase::Relearning {
                state.raise_friction_variance(self.config.supervisor.raised_variance);
            }
            let shares = self.shares();
            let supervisor = &self.state.supervisor;
            let learnt = &supervisor.learnt.evidence;
            // In the first moments, friction that the loaded set lacks may oppose its torques.
            let known = supervisor.rows >= self.config.supervisor.training_rows;
            let evidence = Evidence::Round(Round {
                ticks: self.state.round_ticks,
                moves,
                share: learnt.common(&shares),
                reversed: known && learnt.is_reversed(),
                carries_payload: supervisor.carries_payload,
            });
            self.decide_on(tick, None, evidence);
        }
        let state = &mut self.state;
        if known || restored {
            state.forget_round();
        }
        let age = tick.checked_rem(self.config.supervisor.checkpoint_ticks);
        let due = age.is_some_and(|age| age < N as u32);
        if state.phase() == Phase::Healthy && due {
            state.take_checkpoint();
        }
        state.update_quality(&self.config, tick);
        state.closed_round = Some(tick);
    }

    /// Move the shares towards their evidence, and with `moves_set` the learnt set towards the estimate, so that no joint's
    /// torque changes by more than `torque_step`.
    ///
    /// Torque is linear in the set and in the share, so a part of the way is at most the same part of the torque step. All
    /// joints move with the set, but none stops the share of another.
    pub(super) fn follow(&mut self, moves_set: bool) {
        let shares = self.shares();
        let state = &mut self.state;
        let most = self.config.torque_step;
        let learnt = &mut state.supervisor.learnt;
        // Steps of each joint by its share and by the set.
        let mut steps = [[0.0; 2]; N];
        let mut largest = most;
        let joints = learnt.share.joint.iter().zip(&shares);
        let rows = steps.iter_mut().zip(state.round_changes.iter().flatten());
        for ((own, share), (step, changes)) in joints.zip(rows) {
            let larger = if own > share { own } else { share };
            *step = [
                (share - own).abs() * changes.learnt,
                larger * changes.estimate,
            ];
            let both = step[0] + step[1];
            if !both.is_finite() {
                return;
            }
            if both > largest {
                largest = both;
            }
        }
        // Part of the way of the set.
        let part = if moves_set { most / largest } else { 0.0 };
        let joints = learnt.share.joint.iter_mut().zip(&shares);
        for ((own, share), [by_share, by_set]) in joints.zip(steps) {
            // Rounding must leave no part below zero.
            let left = (most - part * by_set).max(0.0);
            let way = share - *own;
            *own = if by_share > left {
                *own + way * left / by_share
            } else {
                *share
            };
        }
        if moves_set {
            let estimate = state.estimate.parameters().parts();
            for (learnt, estimate) in learnt.set.parts_mut().into_iter().zip(estimate) {
                blend(estimate, learnt, 1.0 - part);
            }
        }
        learnt.share.common = learnt.evidence.common(&learnt.share.joint);
        if !moves_set {
            // A stop must not bring the shares of before relearning back.
            state.supervisor.checkpoints[1].learnt = state.supervisor.learnt;
        }
        state.blend();
    }
}

impl<const N: usize, const P: usize> LearnerState<N, P> {
    /// Set the friction in the torque by loaded set, learnt set and shares.
    #[inline(never)]
    fn blend(&mut self) {
        let supervisor = &self.supervisor;
        let learnt = &supervisor.learnt;
        let friction = learnt.share.friction(&supervisor.loaded, &learnt.set);
        self.active.friction = friction.map(FrictionParameters);
    }

    /// Return to the snapshot, if there is one.
    #[inline(never)]
    fn roll_back(&mut self) {
        let Some((learnt, network)) = &self.snapshot else {
            return;
        };
        self.active.network = *network;
        self.trainer.reset(network);
        self.supervisor.learnt = *learnt;
        self.estimate.move_to(&learnt.set);
        self.estimate.reset_covariance();
        // A payload that is released later restores these.
        let before = &mut self.supervisor.before_payload;
        (before.estimate, before.learnt) = (learnt.set, *learnt);
        self.restored = true;
        self.blend();
    }

    /// Return estimate, learnt set and shares to the older checkpoint, bit for bit.
    #[inline(never)]
    fn restore(&mut self) {
        let [_, checkpoint] = &self.supervisor.checkpoints;
        self.estimate.move_to(&checkpoint.estimate);
        self.supervisor.learnt = checkpoint.learnt;
        self.restored = true;
        self.blend();
        self.supervisor.reset_blocks();
    }

    /// Restart change detection, with all checkpoints at the present parameters.
    fn resume_detection(&mut self) {
        self.supervisor.detector = ChangeDetector::new();
        self.supervisor.reset_blocks();
        // Twice: the older checkpoint, too.
        self.take_checkpoint();
        self.take_checkpoint();
        self.supervisor.keep_checkpoint();
    }

    /// Replace the older checkpoint by the newer one, and that by the present parameters.
    #[inline(never)]
    fn take_checkpoint(&mut self) {
        let now = Checkpoint {
            estimate: *self.estimate.parameters(),
            learnt: self.supervisor.learnt,
            payload: self.supervisor.payload,
        };
        let [newer, older] = &mut self.supervisor.checkpoints;
        *older = core::mem::replace(newer, now);
    }

    /// Remove the payload and restore the rigid-body parameters of before it, bit for bit.
    ///
    /// Friction stays: it changes only under a payload carried for long, and drives warm up with any load. The covariance stays
    /// too, unless most of its rows are of such a payload.
    fn release_payload(&mut self, config: &LearnerConfig<N, P>) {
        let supervisor = &mut self.supervisor;
        supervisor.payload = NO_PAYLOAD;
        supervisor.payload_base.fill(0.0);
        if !core::mem::take(&mut supervisor.carries_payload) {
            return;
        }
        supervisor.fade_evidence_of_before(config);
        let before = &mut supervisor.before_payload;
        before.estimate.friction = self.estimate.parameters().friction;
        before.learnt.set.friction = supervisor.learnt.set.friction;
        // A set committed on request contains part of the payload.
        self.commit_due |= before.learnt.set.rigid != supervisor.learnt.set.rigid;
        supervisor.checkpoints[1] = *before;
        // Most rows of the covariance are of the rigid body with the payload.
        let learnt_under_it = supervisor.blocks_carried >= config.supervisor.pause_blocks;
        if learnt_under_it && self.estimate.rows() / 2 > supervisor.rows_before {
            self.estimate.reset_covariance();
        }
        self.restore();
    }

    /// Raise the variance of one friction parameter a round, in turn for as long as relearning lasts: the change may end as it
    /// began.
    fn raise_friction_variance(&mut self, variance: f32) {
        let index = self.supervisor.next_raised;
        let (joint, column) = (index / FRICTION_COLUMNS, index % FRICTION_COLUMNS);
        self.estimate.raise_variance(joint, column, variance);
        self.supervisor.next_raised = (index + 1) % (N * FRICTION_COLUMNS);
    }

    /// Update payload, information and trust of the report.
    fn update_quality(&mut self, config: &LearnerConfig<N, P>, tick: u32) {
        let supervisor = &self.supervisor;
        let quality = &mut self.report.quality;
        quality.payload = if supervisor.carries_payload {
            payload_estimate(&supervisor.payload, supervisor.payload_filter.mass_sigma())
        } else {
            PayloadEstimate::default()
        };
        let monitor = &mut self.monitor;
        monitor.update_information(self.estimate.filter(), quality);
        let round = tick / N as u32;
        if !round.is_multiple_of(TRUST_ROUNDS) {
            return;
        }
        let floor = config.supervisor.trust_floor;
        let reason = match monitor.update_trust(quality, floor, config.noise) {
            Some(true) => Reason::TrustLost,
            Some(false) => Reason::TrustRegained,
            None => return,
        };
        let trust = quality.trust;
        self.record(tick, reason, None, trust);
    }
}
