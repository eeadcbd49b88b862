//! What the guard does: alarms and the ends of trials, requests, freezes, following and committing.

use super::{Learner, LearnerState};
use crate::arm::Arm;
use crate::dynamics::FRICTION_COLUMNS;
use crate::learning::conditioning::TAPS;
use crate::learning::decision::Reason;
use crate::learning::evidence::Evidence;
use crate::learning::guard::Checkpoint;
use crate::learning::payload::{PAYLOAD_PARAMETERS, describe, payload_base};
use crate::learning::quality::{PayloadEstimate, Phase};
use crate::learning::stacked::LinearParameters;
use crate::learning::trial::{Trial, Verdict};
use crate::learning::{LearningSample, Request};
use crate::limits::Flags;

/// Ticks between two checkpoints: an alarm falls back to one between one and two such times old, longer ago than the
/// detector needs to notice a change.
const CHECKPOINT_TICKS: u32 = 128;
/// Variance that a friction parameter is given back after a change that is no payload, in units of the prior's.
const REOPENED: f32 = 0.05;
/// Ticks for which alarms are not listened to after such a change.
const RELEARNING_TICKS: u32 = 5000;
/// Rounds between two looks at trust.
const TRUST_ROUNDS: u32 = 16;

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// Learning is on and nothing speaks against this lesson. Notes when that changes.
    #[inline(never)]
    pub(super) fn may_learn(&mut self, lesson: &LearningSample<N>) -> bool {
        let state = &mut self.state;
        if !lesson.enabled {
            if state.phase() == Phase::Stopped {
                state.report.quality.phase = Phase::Healthy;
                state.note(lesson.tick, Reason::Resumed, None, 0.0);
            }
            state.frozen = None;
            state.guard.forget_slices();
            return false;
        }
        if state.phase() == Phase::Stopped {
            return false;
        }
        let reason = if lesson.flags.contains(Flags::NOT_FINITE) {
            Some(Reason::FrozenNotFinite)
        } else if lesson.flags.contains(Flags::STALE_SAMPLE) && !state.window.is_whole() {
            Some(Reason::FrozenStale)
        } else if lesson.flags.contains(Flags::SATURATED) {
            Some(Reason::FrozenSaturated)
        } else {
            None
        };
        if let Some(reason) = reason {
            if state.frozen.is_none() {
                state.note(lesson.tick, reason, None, 0.0);
            }
            state.frozen = Some(reason);
            state.thaw_in = TAPS as u32;
        } else if state.frozen.is_some() {
            state.thaw_in = state.thaw_in.saturating_sub(1);
            if state.thaw_in == 0 {
                state.frozen = None;
                state.note(lesson.tick, Reason::Resumed, None, 0.0);
            }
        }
        if state.frozen.is_some() {
            state.guard.forget_slices();
        }
        state.frozen.is_none()
    }

    /// A joint's innovations say that something changed: back to the parameters of before, which are frozen from now on.
    #[inline(never)]
    pub(super) fn raise_alarm(&mut self, tick: u32, joint: usize, sum: f32) {
        let state = &mut self.state;
        let [_, older] = state.guard.checkpoints;
        state.restore(&older);
        let guard = &mut state.guard;
        guard.payload = older.payload;
        guard.payload_base = payload_base::<A, N, P>(&older.payload);
        guard.trial = Trial::new(&self.config.supervisor, &older.payload);
        state.report.quality.phase = Phase::PayloadTest;
        state.note(tick, Reason::Alarm, Some(joint), sum);
    }

    /// The trial has come to a verdict.
    #[inline(never)]
    pub(super) fn end_trial(&mut self, tick: u32, verdict: Verdict) {
        let state = &mut self.state;
        let [_, before] = state.guard.checkpoints;
        let guard = &mut state.guard;
        let mass = guard.payload[0];
        let mut next = Phase::Healthy;
        match verdict {
            Verdict::Promote => {
                guard.filter = *guard.trial.filter();
                guard.payload = guard.filter.payload();
                guard.payload_base = payload_base::<A, N, P>(&guard.payload);
                guard.slices_carried = 0;
                guard.unloaded = guard.unloaded.or(Some(before));
                let mass = guard.payload[0];
                state.note(tick, Reason::Promoted, None, mass);
            }
            Verdict::Release => {
                state.put_down();
                state.note(tick, Reason::Released, None, mass);
            }
            Verdict::Transient => {
                let seconds = guard.trial.slices() as f32
                    * self.config.supervisor.block_ticks as f32
                    / self.config.inv_period;
                state.note(tick, Reason::Transient, None, seconds);
            }
            Verdict::Refuse(reason, figure) => {
                guard.reopen = 0;
                guard.relearning = RELEARNING_TICKS;
                guard.following = false;
                guard.evidence = Evidence::NONE;
                next = Phase::Relearning;
                state.note(tick, reason, None, figure);
                state.note(tick, Reason::Relearning, None, 0.0);
            }
        }
        state.resume(next);
    }

    /// What the owner of the board asks for.
    #[inline(never)]
    pub(super) fn answer(&mut self, tick: u32, request: Request) {
        let state = &mut self.state;
        let mut figure = 0.0;
        let reason = match (request, state.kept) {
            (Request::Snapshot, _) => {
                state.kept = Some(state.active);
                Reason::SnapshotTaken
            }
            (Request::Rollback, Some(kept)) => {
                state.active = kept;
                state.estimate.move_to(&LinearParameters::of(&kept));
                state.guard.following = false;
                state.guard.evidence = Evidence::NONE;
                state.resume(Phase::Healthy);
                Reason::RolledBack
            }
            (Request::Commit, _) => {
                state.commit();
                Reason::Committed
            }
            (Request::ZeroPayload, _) => {
                figure = state.guard.payload[0];
                if state.guard.loaded() {
                    state.put_down();
                }
                state.resume(Phase::Healthy);
                Reason::PayloadZeroed
            }
            (Request::Stop, _) => {
                let [_, older] = state.guard.checkpoints;
                state.restore(&older);
                state.resume(Phase::Stopped);
                Reason::FrozenStopped
            }
            (Request::Rollback, None) => {
                figure = f32::from(request as u8);
                Reason::RequestRefused
            }
        };
        state.note(tick, reason, None, figure);
    }

    /// All joints had their row: follows the estimate, or decides to, or to commit or to go back.
    #[inline(never)]
    pub(super) fn close_round(&mut self, tick: u32) {
        let config = &self.config.supervisor;
        let state = &mut self.state;
        let pending = core::mem::replace(&mut state.pending, [None; N]);
        let rounds = tick / N as u32;
        if state.phase().learns() && pending.iter().all(Option::is_some) {
            state.reopen_friction();
            let evidence = state.guard.evidence;
            let patience = match state.phase() {
                Phase::Relearning => 15 * config.test_rows,
                _ => config.test_rows,
            };
            let settled = evidence.rows() >= patience;
            let early = evidence.ratio() < config.residual_ratio * config.residual_ratio;
            // A little better on some joints may be worse on others; much better is worth it.
            let told = config.test_rows as f32;
            let agreed = |sigmas: f32| early || evidence.no_joint_objects(told, sigmas);
            let opposed = settled && evidence.opposes();
            let fault = if opposed {
                Some(-1.0)
            } else {
                evidence.common_gain(config.gain_error).filter(|_| settled)
            };
            if let (Some(gain), false) = (fault, state.guard.gain_fault) {
                state.note(tick, Reason::CommonGain, None, gain);
            }
            if settled {
                state.guard.gain_fault = fault.is_some();
            }
            if state.guard.following {
                state.guard.followed = state.guard.followed.saturating_add(N as u32);
                if evidence.favours(-config.test_sigmas) {
                    state.roll_back();
                    state.note(tick, Reason::RolledBack, None, evidence.ratio());
                } else if agreed(config.test_sigmas) && !opposed {
                    state.follow(&pending, self.config.torque_step);
                    let followed = state.guard.followed;
                    let due = followed >= config.commit_rows
                        || followed >= config.commit_rows / 4 && early;
                    if due {
                        // What has not been proved better since the last commit waits for a new proof.
                        let proven = evidence.favours(config.test_sigmas);
                        state.commit();
                        state.guard.following = proven;
                        state.note(tick, Reason::Committed, None, evidence.ratio());
                    }
                }
            } else if settled
                && agreed(0.0)
                && fault.is_none()
                && evidence.favours(config.test_sigmas)
            {
                state.guard.following = true;
                state.guard.followed = 0;
                state.note(tick, Reason::Followed, None, evidence.ratio());
            }
            if state.phase() == Phase::Relearning {
                state.guard.relearning = state.guard.relearning.saturating_sub(N as u32);
                if state.guard.relearning == 0 {
                    state.resume(Phase::Healthy);
                    state.note(tick, Reason::RelearningEnded, None, evidence.ratio());
                }
            }
        }
        if state.phase() == Phase::Healthy && tick % CHECKPOINT_TICKS < N as u32 {
            state.keep_checkpoint();
        }
        let guard = &state.guard;
        state.report.quality.payload = if guard.loaded() {
            describe(&guard.payload, guard.filter.mass_sigma())
        } else {
            PayloadEstimate::default()
        };
        state
            .monitor
            .ask(state.estimate.filter(), &mut state.report.quality);
        if rounds.is_multiple_of(TRUST_ROUNDS)
            && let Some(lost) = state
                .monitor
                .tell(&mut state.report.quality, config.trust_floor)
        {
            let reason = if lost {
                Reason::TrustLost
            } else {
                Reason::TrustRegained
            };
            let trust = state.report.quality.trust;
            state.note(tick, reason, None, trust);
        }
        state.closed_round = Some(tick);
    }
}

impl<const N: usize, const P: usize> LearnerState<N, P> {
    /// Estimate and active set as they were at `checkpoint`, bit for bit.
    fn restore(&mut self, checkpoint: &Checkpoint<N, P>) {
        self.estimate.move_to(&checkpoint.estimate);
        checkpoint.active.write(&mut self.active);
        self.guard.forget_slices();
    }

    /// Goes on in `phase`: no trial runs, and the detector begins anew.
    fn resume(&mut self, phase: Phase) {
        self.report.quality.phase = phase;
        self.guard.detector = Default::default();
        self.guard.forget_slices();
        self.keep_checkpoint();
        self.guard.checkpoints[1] = self.guard.checkpoints[0];
    }

    fn keep_checkpoint(&mut self) {
        let now = Checkpoint {
            estimate: *self.estimate.parameters(),
            active: LinearParameters::of(&self.active),
            committed: self.guard.committed,
            payload: self.guard.payload,
        };
        let [newer, older] = &mut self.guard.checkpoints;
        *older = core::mem::replace(newer, now);
    }

    /// The hand is empty: no payload, and the parameters of before it, bit for bit. Only friction learnt under a load
    /// that was carried for long stays: drives warm up whatever the hand holds.
    fn put_down(&mut self) {
        let guard = &mut self.guard;
        guard.payload = [0.0; PAYLOAD_PARAMETERS];
        guard.payload_base.fill(0.0);
        let Some(before) = guard.unloaded.take() else {
            return;
        };
        let (mut estimate, mut active) = (before.estimate, before.active);
        if !guard.resting() {
            estimate.friction = self.estimate.parameters().friction;
            active.friction = LinearParameters::of(&self.active).friction;
        }
        self.estimate.move_to(&estimate);
        active.write(&mut self.active);
        guard.following = false;
        guard.evidence = Evidence::NONE;
        if guard.committed != before.committed {
            // A set committed under the load has weighed it too.
            self.commit();
        }
    }

    /// The active set becomes the committed one; the estimate has to prove itself against it anew.
    fn commit(&mut self) {
        self.commit = true;
        let guard = &mut self.guard;
        guard.committed = LinearParameters::of(&self.active);
        guard.evidence = Evidence::NONE;
        guard.following = false;
        guard.followed = 0;
    }

    /// The committed set explains the torques better than what was learnt since.
    fn roll_back(&mut self) {
        let committed = self.guard.committed;
        self.estimate.move_to(&committed);
        committed.write(&mut self.active);
        self.guard.evidence = Evidence::NONE;
        self.guard.following = false;
    }

    /// Raises the doubt about one friction parameter a round after a change that is no payload.
    fn reopen_friction(&mut self) {
        let place = self.guard.reopen;
        if place < N * FRICTION_COLUMNS {
            let (joint, column) = (place / FRICTION_COLUMNS, place % FRICTION_COLUMNS);
            self.estimate.reopen(joint, column, REOPENED);
            self.guard.reopen = place + 1;
        }
    }

    /// Moves the candidate's linear parameters towards the estimate: all the way if that changes no joint's torque by
    /// more than `bound`, else by the part that keeps to it. Torque is linear in them, so a part of the way is a part of
    /// the step.
    fn follow(&mut self, pending: &[Option<f32>; N], bound: f32) {
        let mut largest = 0.0;
        for step in pending.iter().flatten() {
            if !step.is_finite() {
                return;
            }
            if step.abs() > largest {
                largest = step.abs();
            }
        }
        if largest <= bound {
            self.estimate.parameters().write(&mut self.active);
            return;
        }
        let part = bound / largest;
        let mut followed = LinearParameters::of(&self.active);
        let estimate = self.estimate.parameters();
        for (followed, estimate) in followed.iter_mut().zip(estimate.iter()) {
            *followed += part * (estimate - *followed);
        }
        followed.write(&mut self.active);
    }
}
