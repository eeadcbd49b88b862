//! Transitions of the supervisor: freeze, alarm, end of a payload test, requests, and the close of a round.

use super::{Learner, LearnerState};
use crate::arm::Arm;
use crate::dynamics::FRICTION_COLUMNS;
use crate::learning::change_detection::ChangeDetector;
use crate::learning::conditioning::TAPS;
use crate::learning::config::LearnerConfig;
use crate::learning::decision::Reason;
use crate::learning::exchange::{LearningSample, Request};
use crate::learning::parameters::LinearParameters;
use crate::learning::payload::{NO_PAYLOAD, payload_base, payload_estimate};
use crate::learning::quality::{PayloadEstimate, Phase};
use crate::learning::supervisor::Checkpoint;
use crate::learning::supervisor::paired_test::PairedTest;
use crate::learning::supervisor::payload_test::{PayloadDecision, PayloadHypothesisTest};
use crate::limits::Flags;

/// Ticks between two checkpoints. An alarm returns to one between one and two such times old: older than the delay of
/// change detection.
const CHECKPOINT_TICKS: u32 = 128;
/// Variance added to each friction parameter after a change that is no payload, in units of the prior variance.
const RAISED_VARIANCE: f32 = 0.05;
/// Length of relearning, ticks; change detection is off.
const RELEARNING_TICKS: u32 = 5000;
/// Factor on the least rows of a paired test during relearning.
const RELEARNING_ROWS: u32 = 15;
/// Rounds between two updates of trust.
const TRUST_ROUNDS: u32 = 16;

impl<A: Arm<N, P>, const N: usize, const P: usize> Learner<A, N, P> {
    /// True if learning is on and not frozen at `sample`; records freezes and resumptions.
    #[inline(never)]
    pub(super) fn may_learn(&mut self, sample: &LearningSample<N>) -> bool {
        let state = &mut self.state;
        if !sample.enabled {
            if state.phase() == Phase::Stopped {
                state.report.quality.phase = Phase::Healthy;
                state.record(sample.tick, Reason::Resumed, None, 0.0);
            }
            state.frozen = None;
            state.supervisor.reset_blocks();
            return false;
        }
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
            state.resume_in = TAPS as u32;
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

    /// Alarm of change detection on `joint`, with its CUSUM: return to the older checkpoint and start a payload test.
    #[inline(never)]
    pub(super) fn start_payload_test(&mut self, tick: u32, joint: usize, sum: f32) {
        let state = &mut self.state;
        let [_, older] = state.supervisor.checkpoints;
        state.restore(&older);
        let supervisor = &mut state.supervisor;
        supervisor.payload = older.payload;
        supervisor.payload_base = payload_base::<A, N, P>(&older.payload);
        supervisor.payload_test =
            PayloadHypothesisTest::new(&self.config.supervisor, &older.payload);
        state.report.quality.phase = Phase::PayloadTest;
        state.record(tick, Reason::Alarm, Some(joint), sum);
    }

    /// End of the payload test with `decision`.
    #[inline(never)]
    pub(super) fn end_payload_test(&mut self, tick: u32, decision: PayloadDecision) {
        let state = &mut self.state;
        let [_, before] = state.supervisor.checkpoints;
        let supervisor = &mut state.supervisor;
        let mass = supervisor.payload[0];
        let mut next = Phase::Healthy;
        match decision {
            PayloadDecision::Promote => {
                supervisor.payload_filter = *supervisor.payload_test.filter();
                supervisor.payload = supervisor.payload_filter.payload();
                supervisor.payload_base = payload_base::<A, N, P>(&supervisor.payload);
                supervisor.blocks_carried = 0;
                supervisor.before_payload = supervisor.before_payload.or(Some(before));
                let mass = supervisor.payload[0];
                state.record(tick, Reason::Promoted, None, mass);
            }
            PayloadDecision::Release => {
                state.release_payload();
                state.record(tick, Reason::Released, None, mass);
            }
            PayloadDecision::Transient => {
                let config = &self.config.supervisor;
                let seconds = supervisor.payload_test.blocks() as f32 * config.block_ticks as f32
                    / self.config.inv_period;
                state.record(tick, Reason::Transient, None, seconds);
            }
            PayloadDecision::Refuse(reason, figure) => {
                supervisor.next_raised = 0;
                supervisor.relearning_ticks = RELEARNING_TICKS;
                supervisor.restart_test();
                next = Phase::Relearning;
                state.record(tick, reason, None, figure);
                state.record(tick, Reason::Relearning, None, 0.0);
            }
        }
        state.enter(next);
    }

    /// Execute a request of the owner of the board.
    #[inline(never)]
    pub(super) fn execute(&mut self, tick: u32, request: Request) {
        let state = &mut self.state;
        let mut figure = 0.0;
        let reason = match (request, state.snapshot) {
            (Request::Snapshot, _) => {
                state.snapshot = Some(state.active);
                Reason::SnapshotTaken
            }
            (Request::Rollback, Some(snapshot)) => {
                state.active = snapshot;
                state.estimate.move_to(&LinearParameters::of(&snapshot));
                state.supervisor.restart_test();
                state.enter(Phase::Healthy);
                Reason::RolledBack
            }
            (Request::Commit, _) => {
                state.commit();
                Reason::Committed
            }
            (Request::ZeroPayload, _) => {
                figure = state.supervisor.payload[0];
                if state.supervisor.carries_payload() {
                    state.release_payload();
                }
                state.enter(Phase::Healthy);
                Reason::PayloadZeroed
            }
            (Request::Stop, _) => {
                let [_, older] = state.supervisor.checkpoints;
                state.restore(&older);
                state.enter(Phase::Stopped);
                Reason::FrozenStopped
            }
            (Request::Rollback, None) => {
                figure = f32::from(request as u8);
                Reason::RequestRefused
            }
        };
        state.record(tick, reason, None, figure);
    }

    /// Close of a round, after the last joint: follow, commit or roll back; checkpoint; report.
    #[inline(never)]
    pub(super) fn close_round(&mut self, tick: u32) {
        let state = &mut self.state;
        let steps = core::mem::replace(&mut state.round_steps, [None; N]);
        if state.phase().learns() && steps.iter().all(Option::is_some) {
            state.raise_friction_variance();
            let test = state.supervisor.paired_test;
            state.update_active(&self.config, tick, &steps, &test);
            if state.phase() == Phase::Relearning {
                let remaining = &mut state.supervisor.relearning_ticks;
                *remaining = remaining.saturating_sub(N as u32);
                if *remaining == 0 {
                    state.enter(Phase::Healthy);
                    state.record(tick, Reason::RelearningEnded, None, test.ratio());
                }
            }
        }
        if state.phase() == Phase::Healthy && tick % CHECKPOINT_TICKS < N as u32 {
            state.take_checkpoint();
        }
        state.update_quality(&self.config, tick);
        state.closed_round = Some(tick);
    }
}

impl<const N: usize, const P: usize> LearnerState<N, P> {
    /// Decision on the active set by the paired test: begin to follow the estimate, follow, commit or roll back.
    fn update_active(
        &mut self,
        config: &LearnerConfig<N, P>,
        tick: u32,
        steps: &[Option<f32>; N],
        test: &PairedTest<N>,
    ) {
        let limits = &config.supervisor;
        let required = match self.phase() {
            Phase::Relearning => RELEARNING_ROWS * limits.test_rows,
            _ => limits.test_rows,
        };
        let settled = test.rows() >= required;
        let early = test.ratio() < limits.residual_ratio * limits.residual_ratio;
        // A small advantage may hide worse joints; a large one outweighs them.
        let passes = |sigmas: f32| early || test.joints_pass(limits.test_rows as f32, sigmas);
        let reversed = settled && test.is_reversed();
        let gain = if reversed {
            Some(-1.0)
        } else {
            test.common_gain(limits.gain_error).filter(|_| settled)
        };
        if let (Some(gain), false) = (gain, self.supervisor.gain_fault) {
            self.record(tick, Reason::CommonGain, None, gain);
        }
        if settled {
            self.supervisor.gain_fault = gain.is_some();
        }
        let better = test.is_better(limits.test_sigmas);
        if self.supervisor.following {
            let followed = self.supervisor.rows_followed.saturating_add(N as u32);
            self.supervisor.rows_followed = followed;
            if test.is_worse(limits.test_sigmas) {
                self.roll_back();
                self.record(tick, Reason::RolledBack, None, test.ratio());
            } else if passes(limits.test_sigmas) && !reversed {
                self.follow(steps, config.torque_step);
                if followed >= limits.commit_rows || followed >= limits.commit_rows / 4 && early {
                    self.commit();
                    // Without significance since the last commit, following needs a new test.
                    self.supervisor.following = better;
                    self.record(tick, Reason::Committed, None, test.ratio());
                }
            }
        } else if settled && passes(0.0) && gain.is_none() && better {
            self.supervisor.following = true;
            self.supervisor.rows_followed = 0;
            self.record(tick, Reason::Followed, None, test.ratio());
        }
    }

    /// Move the active linear parameters towards the estimate, so that no joint's torque changes by more than `bound`.
    ///
    /// Torque is linear in the parameters, so a part of the way is the same part of the torque step.
    ///
    /// * `steps` torque change of each joint by the whole way, and `bound`, in units of the torque limit
    fn follow(&mut self, steps: &[Option<f32>; N], bound: f32) {
        let mut largest = 0.0;
        for step in steps.iter().flatten() {
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
        let mut active = LinearParameters::of(&self.active);
        let estimate = self.estimate.parameters();
        for (active, estimate) in active.iter_mut().zip(estimate.iter()) {
            *active += part * (estimate - *active);
        }
        active.write(&mut self.active);
    }

    /// Make the active set the committed one, and restart the paired test against it.
    fn commit(&mut self) {
        self.commit_due = true;
        self.supervisor.committed = LinearParameters::of(&self.active);
        self.supervisor.restart_test();
        self.supervisor.rows_followed = 0;
    }

    /// Return estimate and active set to the committed set.
    fn roll_back(&mut self) {
        let committed = self.supervisor.committed;
        self.estimate.move_to(&committed);
        committed.write(&mut self.active);
        self.supervisor.restart_test();
    }

    /// Return estimate and active set to `checkpoint`, bit for bit.
    fn restore(&mut self, checkpoint: &Checkpoint<N, P>) {
        self.estimate.move_to(&checkpoint.estimate);
        checkpoint.active.write(&mut self.active);
        self.supervisor.reset_blocks();
    }

    /// Enter `phase`: restart change detection, with both checkpoints at the present parameters.
    fn enter(&mut self, phase: Phase) {
        self.report.quality.phase = phase;
        self.supervisor.detector = ChangeDetector::new();
        self.supervisor.reset_blocks();
        self.take_checkpoint();
        self.supervisor.checkpoints[1] = self.supervisor.checkpoints[0];
    }

    /// Replace the older checkpoint by the newer one, and that by the present parameters.
    fn take_checkpoint(&mut self) {
        let now = Checkpoint {
            estimate: *self.estimate.parameters(),
            active: LinearParameters::of(&self.active),
            committed: self.supervisor.committed,
            payload: self.supervisor.payload,
        };
        let [newer, older] = &mut self.supervisor.checkpoints;
        *older = core::mem::replace(newer, now);
    }

    /// Remove the payload and restore the rigid-body parameters of before it, bit for bit.
    ///
    /// Friction stays: it changes only under a payload carried for long, and drives warm up with any load.
    fn release_payload(&mut self) {
        let supervisor = &mut self.supervisor;
        supervisor.payload = NO_PAYLOAD;
        supervisor.payload_base.fill(0.0);
        let Some(before) = supervisor.before_payload.take() else {
            return;
        };
        let (mut estimate, mut active) = (before.estimate, before.active);
        estimate.friction = self.estimate.parameters().friction;
        active.friction = LinearParameters::of(&self.active).friction;
        self.estimate.move_to(&estimate);
        active.write(&mut self.active);
        supervisor.restart_test();
        if supervisor.committed != before.committed {
            // A set committed under the payload contains part of it.
            self.commit();
        }
    }

    /// Raise the variance of one friction parameter a round, after a change that is no payload.
    fn raise_friction_variance(&mut self) {
        let index = self.supervisor.next_raised;
        if index < N * FRICTION_COLUMNS {
            let (joint, column) = (index / FRICTION_COLUMNS, index % FRICTION_COLUMNS);
            self.estimate.raise_variance(joint, column, RAISED_VARIANCE);
            self.supervisor.next_raised = index + 1;
        }
    }

    /// Update payload, information and trust of the report.
    fn update_quality(&mut self, config: &LearnerConfig<N, P>, tick: u32) {
        let supervisor = &self.supervisor;
        let quality = &mut self.report.quality;
        quality.payload = if supervisor.carries_payload() {
            payload_estimate(&supervisor.payload, supervisor.payload_filter.mass_sigma())
        } else {
            PayloadEstimate::default()
        };
        self.monitor
            .update_information(self.estimate.filter(), quality);
        let round = tick / N as u32;
        if !round.is_multiple_of(TRUST_ROUNDS) {
            return;
        }
        if let Some(lost) =
            self.monitor
                .update_trust(quality, config.supervisor.trust_floor, config.noise)
        {
            let reason = if lost {
                Reason::TrustLost
            } else {
                Reason::TrustRegained
            };
            let trust = quality.trust;
            self.record(tick, reason, None, trust);
        }
    }
}
