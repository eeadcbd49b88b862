//! State machine of the supervisor.

use super::config::SupervisorConfig;
use super::payload_test::PayloadDecision;
use crate::learning::decision::Reason;
use crate::learning::exchange::Request;
use crate::learning::quality::Phase;

/// State of the supervisor's decisions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SupervisorState {
    pub(crate) phase: Phase,
    /// True while the common share is large, with hysteresis.
    pub(crate) following: bool,
    /// True while the measured torques oppose those of the loaded set, over at least `training_rows` rows.
    pub(crate) reversed: bool,
    /// Ticks of following until the next commit.
    pub(crate) commit_in: u32,
    /// Remaining ticks of relearning.
    pub(crate) relearning_ticks: u32,
}

impl SupervisorState {
    /// Healthy, not following.
    pub(crate) const START: Self = Self {
        phase: Phase::Healthy,
        following: false,
        reversed: false,
        commit_in: 0,
        relearning_ticks: 0,
    };
}

/// Event on which the supervisor decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Evidence {
    /// A sample with learning switched off.
    Off,
    /// Alarm of change detection, with its CUSUM.
    Change(f32),
    /// End of the payload test, with mass in kg and seconds since the alarm.
    Payload {
        decision: PayloadDecision,
        mass: f32,
        seconds: f32,
    },
    /// Request of the owner, with the mass in the torque, kg, and true if there is a snapshot.
    Request {
        request: Request,
        mass: f32,
        snapshot: bool,
    },
    /// Close of a round in which every joint was learnt or stood still.
    Round {
        ticks: u32,
        /// Common share by the evidence.
        share: f32,
        reversed: bool,
        carries_payload: bool,
    },
}

/// Consequence of a decision, for the learner to carry out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    /// Nothing changes.
    None,
    /// Move the learnt set and the shares a bounded step; then commit if true.
    Follow { commit: bool },
    /// Return to the older checkpoint, and start a payload test.
    TestPayload,
    /// Return to the older checkpoint.
    Restore,
    /// Adopt the hypothesis as the payload.
    Promote,
    /// Remove the payload.
    Release,
    /// Raise the variance of friction.
    Relearn,
    /// Start change detection again.
    Resume,
    /// Copy the learnt set.
    Snapshot,
    /// Return to the copy.
    Rollback,
    /// Commit the learnt set.
    Commit,
}

/// Decision: next state, action, and the reason with its figure if it is to be recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Transition {
    pub(crate) state: SupervisorState,
    pub(crate) action: Action,
    pub(crate) reason: Option<(Reason, f32)>,
}

/// Decision on `evidence` in the state `before`.
pub(crate) fn step(
    config: &SupervisorConfig,
    before: &SupervisorState,
    evidence: Evidence,
) -> Transition {
    let mut state = *before;
    let mut to = |phase: Phase, action: Action, reason: Reason, figure: f32| {
        state.phase = phase;
        (action, Some((reason, figure)))
    };
    let (action, reason) = match (before.phase, evidence) {
        (Phase::Stopped, Evidence::Off) => to(Phase::Healthy, Action::None, Reason::Resumed, 0.0),
        (Phase::Healthy, Evidence::Change(sum)) => {
            to(Phase::PayloadTest, Action::TestPayload, Reason::Alarm, sum)
        }
        (
            Phase::PayloadTest | Phase::Healthy,
            Evidence::Payload {
                decision,
                mass,
                seconds,
            },
        ) => match decision {
            PayloadDecision::Promote => to(Phase::Healthy, Action::Promote, Reason::Promoted, mass),
            PayloadDecision::Release => to(Phase::Healthy, Action::Release, Reason::Released, mass),
            PayloadDecision::Transient => {
                to(Phase::Healthy, Action::Resume, Reason::Transient, seconds)
            }
            PayloadDecision::Refuse(reason, figure) => {
                let decided = to(Phase::Relearning, Action::Relearn, reason, figure);
                state.relearning_ticks = config.relearning_ticks;
                decided
            }
        },
        (
            phase,
            Evidence::Request {
                request,
                mass,
                snapshot,
            },
        ) => match request {
            Request::Snapshot => to(phase, Action::Snapshot, Reason::SnapshotTaken, 0.0),
            Request::Rollback if snapshot => {
                to(Phase::Healthy, Action::Rollback, Reason::RolledBack, 0.0)
            }
            Request::Rollback => {
                let code = f32::from(request as u8);
                to(phase, Action::None, Reason::RequestRefused, code)
            }
            Request::Commit => to(phase, Action::Commit, Reason::Committed, 0.0),
            Request::ZeroPayload => {
                to(Phase::Healthy, Action::Release, Reason::PayloadZeroed, mass)
            }
            Request::Stop => to(Phase::Stopped, Action::Restore, Reason::FrozenStopped, 0.0),
        },
        (Phase::Relearning, Evidence::Round { ticks, share, .. }) => {
            state.relearning_ticks = state.relearning_ticks.saturating_sub(ticks);
            if state.relearning_ticks == 0 {
                state.phase = Phase::Healthy;
                (Action::Resume, Some((Reason::RelearningEnded, share)))
            } else {
                (Action::None, None)
            }
        }
        (
            Phase::Healthy,
            Evidence::Round {
                ticks,
                share,
                reversed,
                carries_payload,
            },
        ) => follow(config, &mut state, ticks, share, reversed, carries_payload),
        _ => (Action::None, None),
    };
    Transition {
        state,
        action,
        reason,
    }
}

/// Decision at the close of a healthy round.
fn follow(
    config: &SupervisorConfig,
    state: &mut SupervisorState,
    ticks: u32,
    share: f32,
    reversed: bool,
    carries_payload: bool,
) -> (Action, Option<(Reason, f32)>) {
    let before = *state;
    state.reversed = reversed;
    let (begin, end) = config.following_share;
    state.following = share > if before.following { end } else { begin };
    if !state.following {
        // The first commit comes early: the bound on learnt change is centred at the loaded set.
        state.commit_in = config.commit_ticks / 4;
    }
    state.commit_in = state.commit_in.saturating_sub(ticks);
    let commit = state.following && state.commit_in == 0 && !carries_payload;
    if commit {
        state.commit_in = config.commit_ticks;
    }
    let reason = match (before, *state) {
        (before, now) if now.reversed && !before.reversed => Some((Reason::Reversed, -1.0)),
        (before, now) if now.following && !before.following => Some((Reason::Followed, share)),
        (before, now) if before.following && !now.following => Some((Reason::RolledBack, share)),
        _ => None,
    };
    (Action::Follow { commit }, reason)
}

#[cfg(test)]
mod tests;
