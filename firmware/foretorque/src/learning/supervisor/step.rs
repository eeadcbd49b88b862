//! State machine of the supervisor.

use super::config::SupervisorConfig;
use super::payload_test::PayloadDecision;
use crate::learning::decision::Reason;
use crate::learning::exchange::Request;
use crate::learning::quality::Phase;

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
    Round(Round),
}

/// Closed round of so many ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Round {
    pub(crate) ticks: u32,
    /// True if a row was learnt in it.
    pub(crate) moves: bool,
    /// Common share by the evidence.
    pub(crate) share: f32,
    pub(crate) reversed: bool,
    pub(crate) carries_payload: bool,
}

/// Consequence of a decision, for the learner to carry out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    None,
    /// Move the shares a bounded step, with `set` the learnt set, too; then commit if true.
    Follow {
        set: bool,
        commit: bool,
    },
    /// Return to the older checkpoint, and start a payload test.
    TestPayload,
    /// Return to the older checkpoint.
    Restore,
    /// Adopt the hypothesis as the payload.
    Promote,
    Release,
    /// Raise the variance of friction.
    Relearn,
    /// Start change detection again.
    Resume,
    /// Copy the learnt set.
    Snapshot,
    /// Return to the copy.
    Rollback,
    Commit,
}

/// Decision: next state, action, and the reason with its figure if it is to be recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Transition {
    pub(crate) state: SupervisorState,
    pub(crate) action: Action,
    pub(crate) reason: Option<(Reason, f32)>,
}

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
            // Only switching learning off ends a stop.
            Request::Rollback if snapshot && phase != Phase::Stopped => {
                to(Phase::Healthy, Action::Rollback, Reason::RolledBack, 0.0)
            }
            Request::ZeroPayload if phase != Phase::Stopped => {
                to(Phase::Healthy, Action::Release, Reason::PayloadZeroed, mass)
            }
            Request::Rollback | Request::ZeroPayload => {
                let code = f32::from(request as u8);
                to(phase, Action::None, Reason::RequestRefused, code)
            }
            Request::Commit => to(phase, Action::Commit, Reason::Committed, 0.0),
            Request::Stop => to(Phase::Stopped, Action::Restore, Reason::FrozenStopped, 0.0),
        },
        (Phase::Relearning, Evidence::Round(round)) => {
            let learnt = if round.moves { round.ticks } else { 0 };
            state.relearning_ticks = state.relearning_ticks.saturating_sub(learnt);
            if state.relearning_ticks == 0 {
                state.phase = Phase::Healthy;
                (Action::Resume, Some((Reason::RelearningEnded, round.share)))
            } else {
                let (set, commit) = (false, false);
                (Action::Follow { set, commit }, None)
            }
        }
        (Phase::Healthy, Evidence::Round(round)) => follow(config, &mut state, &round),
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
    round: &Round,
) -> (Action, Option<(Reason, f32)>) {
    let (before, share) = (*state, round.share);
    state.reversed = round.reversed;
    let (begin, end) = config.following_share;
    state.following = share > if before.following { end } else { begin };
    if !state.following {
        // The first commit comes early: the bound on learnt change is centred at the loaded set.
        state.commit_in = config.commit_ticks / 4;
    }
    state.commit_in = state.commit_in.saturating_sub(round.ticks);
    let commit = state.following && state.commit_in == 0 && !round.carries_payload;
    if commit {
        state.commit_in = config.commit_ticks;
    }
    let reason = match (before.following, state.following) {
        _ if state.reversed && !before.reversed => Some((Reason::Reversed, -1.0)),
        (false, true) => Some((Reason::FollowingBegan, share)),
        (true, false) => Some((Reason::FollowingEnded, share)),
        _ => None,
    };
    (Action::Follow { set: true, commit }, reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{LearnerConfig, Ur5};

    fn config() -> SupervisorConfig {
        LearnerConfig::for_arm::<Ur5>(1e-3).supervisor
    }

    /// Phase, action, and reason with its figure after `evidence` in `phase`.
    fn after(phase: Phase, evidence: Evidence) -> (Phase, Action, Option<(Reason, f32)>) {
        let before = SupervisorState {
            phase,
            ..SupervisorState::START
        };
        let next = step(&config(), &before, evidence);
        (next.state.phase, next.action, next.reason)
    }

    fn payload(decision: PayloadDecision) -> Evidence {
        Evidence::Payload {
            decision,
            mass: 2.0,
            seconds: 0.1,
        }
    }

    fn request(request: Request, snapshot: bool) -> Evidence {
        Evidence::Request {
            request,
            mass: 2.0,
            snapshot,
        }
    }

    const ROUND: Round = Round {
        ticks: 6,
        moves: true,
        share: 0.5,
        reversed: false,
        carries_payload: false,
    };

    fn round(share: f32, reversed: bool, carries_payload: bool) -> Evidence {
        Evidence::Round(Round {
            share,
            reversed,
            carries_payload,
            ..ROUND
        })
    }

    #[test]
    fn every_event_has_its_transition() {
        use PayloadDecision::{Promote, Refuse, Release, Transient};
        use Phase::{Healthy, PayloadTest, Relearning, Stopped};
        use Request::{Commit, Rollback, Snapshot, ZeroPayload};
        let alarm = Evidence::Change(26.0);
        let refuse = payload(Refuse(Reason::Uncertain, 0.4));
        let [promote, release, transient] = [Promote, Release, Transient].map(payload);
        let to_snapshot = request(Rollback, true);
        let [rollback, zero, commit, snapshot] =
            [Rollback, ZeroPayload, Commit, Snapshot].map(|what| request(what, false));
        // Phase, event; next phase, action, reason with its figure.
        for (phase, evidence, wanted) in [
            (Healthy, alarm, "PayloadTest TestPayload Alarm 26"),
            (PayloadTest, promote, "Healthy Promote Promoted 2"),
            (Healthy, promote, "Healthy Promote Promoted 2"),
            (PayloadTest, release, "Healthy Release Released 2"),
            (PayloadTest, transient, "Healthy Resume Transient 0.1"),
            (PayloadTest, refuse, "Relearning Relearn Uncertain 0.4"),
            (Stopped, Evidence::Off, "Healthy None Resumed 0"),
            (Relearning, to_snapshot, "Healthy Rollback RolledBack 0"),
            (Relearning, rollback, "Relearning None RequestRefused 2"),
            (PayloadTest, zero, "Healthy Release PayloadZeroed 2"),
            (Healthy, commit, "Healthy Commit Committed 0"),
            (Stopped, to_snapshot, "Stopped None RequestRefused 2"),
            (Stopped, zero, "Stopped None RequestRefused 4"),
            (Healthy, snapshot, "Healthy Snapshot SnapshotTaken 0"),
        ] {
            let (next, action, reason) = after(phase, evidence);
            let (reason, figure) = reason.expect("a reason");
            let decided = std::format!("{next:?} {action:?} {reason:?} {figure}");
            assert_eq!(decided, wanted, "{phase:?} {evidence:?}");
        }
        for phase in [Healthy, PayloadTest, Relearning, Stopped] {
            let stopped = (Stopped, Action::Restore, Some((Reason::FrozenStopped, 0.0)));
            assert_eq!(after(phase, request(Request::Stop, true)), stopped);
        }
        for (phase, evidence) in [
            (Stopped, alarm),
            (Relearning, alarm),
            (Stopped, round(1.0, false, false)),
            (PayloadTest, round(1.0, false, false)),
            (Healthy, Evidence::Off),
        ] {
            let nothing = (phase, Action::None, None);
            assert_eq!(after(phase, evidence), nothing, "{evidence:?}");
        }
    }

    #[test]
    fn following_begins_and_ends_with_hysteresis_and_commits_in_turn() {
        let mut state = SupervisorState::START;
        let mut reasons = std::vec::Vec::new();
        let mut commits = std::vec::Vec::new();
        for tick in (0..20_004).step_by(6) {
            let share = if tick < 600 { 0.4 } else { 0.9 };
            let next = step(&config(), &state, round(share, false, tick < 3000));
            state = next.state;
            reasons.extend(next.reason.map(|(reason, _)| reason));
            if let Action::Follow { commit: true, .. } = next.action {
                commits.push(tick);
            }
        }
        // Due at 2592, it waits for the payload to be let go.
        assert_eq!(commits, [3000, 11_004, 19_008]);
        for (share, reversed) in [(0.3, false), (0.2, false), (0.4, false), (0.0, true)] {
            let next = step(&config(), &state, round(share, reversed, false));
            state = next.state;
            reasons.extend(next.reason.map(|(reason, _)| reason));
        }
        let wanted = [
            Reason::FollowingBegan,
            Reason::FollowingEnded,
            Reason::Reversed,
        ];
        assert_eq!(reasons, wanted);
    }

    #[test]
    fn relearning_ends_with_its_time() {
        let mut state = SupervisorState::START;
        state.phase = Phase::PayloadTest;
        let refusal = payload(PayloadDecision::Refuse(Reason::Residual, 0.9));
        state = step(&config(), &state, refusal).state;
        // Rounds at rest do not count.
        for _ in 0..5000 {
            let rest = Evidence::Round(Round {
                moves: false,
                ..ROUND
            });
            state = step(&config(), &state, rest).state;
        }
        let mut rounds = 0;
        while state.phase == Phase::Relearning {
            let next = step(&config(), &state, Evidence::Round(ROUND));
            let over = next.state.phase == Phase::Healthy;
            let shares_alone = Action::Follow {
                set: false,
                commit: false,
            };
            let action = if over { Action::Resume } else { shares_alone };
            assert_eq!(next.action, action);
            state = next.state;
            rounds += 1;
        }
        assert_eq!(rounds, 834);
    }
}
