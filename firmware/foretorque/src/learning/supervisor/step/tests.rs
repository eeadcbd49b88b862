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

fn round(share: f32, reversed: bool, carries_payload: bool) -> Evidence {
    Evidence::Round {
        ticks: 6,
        share,
        reversed,
        carries_payload,
    }
}

#[test]
fn every_event_has_its_transition() {
    use Phase::{Healthy, PayloadTest, Relearning, Stopped};
    let refusal = payload(PayloadDecision::Refuse(Reason::Uncertain, 0.4));
    let rows = [
        (
            Healthy,
            Evidence::Change(26.0),
            PayloadTest,
            Action::TestPayload,
            (Reason::Alarm, 26.0),
        ),
        (
            PayloadTest,
            payload(PayloadDecision::Promote),
            Healthy,
            Action::Promote,
            (Reason::Promoted, 2.0),
        ),
        (
            Healthy,
            payload(PayloadDecision::Promote),
            Healthy,
            Action::Promote,
            (Reason::Promoted, 2.0),
        ),
        (
            PayloadTest,
            payload(PayloadDecision::Release),
            Healthy,
            Action::Release,
            (Reason::Released, 2.0),
        ),
        (
            PayloadTest,
            payload(PayloadDecision::Transient),
            Healthy,
            Action::Resume,
            (Reason::Transient, 0.1),
        ),
        (
            PayloadTest,
            refusal,
            Relearning,
            Action::Relearn,
            (Reason::Uncertain, 0.4),
        ),
        (
            Stopped,
            Evidence::Off,
            Healthy,
            Action::None,
            (Reason::Resumed, 0.0),
        ),
        (
            Relearning,
            request(Request::Rollback, true),
            Healthy,
            Action::Rollback,
            (Reason::RolledBack, 0.0),
        ),
        (
            Relearning,
            request(Request::Rollback, false),
            Relearning,
            Action::None,
            (Reason::RequestRefused, 2.0),
        ),
        (
            PayloadTest,
            request(Request::ZeroPayload, false),
            Healthy,
            Action::Release,
            (Reason::PayloadZeroed, 2.0),
        ),
        (
            Healthy,
            request(Request::Commit, false),
            Healthy,
            Action::Commit,
            (Reason::Committed, 0.0),
        ),
        (
            Healthy,
            request(Request::Snapshot, false),
            Healthy,
            Action::Snapshot,
            (Reason::SnapshotTaken, 0.0),
        ),
    ];
    for (phase, evidence, next, action, reason) in rows {
        assert_eq!(
            after(phase, evidence),
            (next, action, Some(reason)),
            "{phase:?} {evidence:?}"
        );
    }
    for phase in [Healthy, PayloadTest, Relearning, Stopped] {
        let stopped = (Stopped, Action::Restore, Some((Reason::FrozenStopped, 0.0)));
        assert_eq!(after(phase, request(Request::Stop, true)), stopped);
    }
    for (phase, evidence) in [
        (Stopped, Evidence::Change(26.0)),
        (Relearning, Evidence::Change(26.0)),
        (Stopped, round(1.0, false, false)),
        (PayloadTest, round(1.0, false, false)),
        (Healthy, Evidence::Off),
    ] {
        assert_eq!(
            after(phase, evidence),
            (phase, Action::None, None),
            "{phase:?} {evidence:?}"
        );
    }
}

#[test]
fn following_begins_and_ends_with_hysteresis_and_commits_in_turn() {
    let mut state = SupervisorState::START;
    let mut reasons = std::vec::Vec::new();
    let mut commits = std::vec::Vec::new();
    for tick in (0..20_004).step_by(6) {
        let share = if tick < 600 { 0.4 } else { 0.9 };
        let next = step(&config(), &state, round(share, false, tick < 1200));
        state = next.state;
        reasons.extend(next.reason.map(|(reason, _)| reason));
        if next.action == (Action::Follow { commit: true }) {
            commits.push(tick);
        }
    }
    assert_eq!(commits, [2592, 10_596, 18_600]);
    for (share, reversed) in [(0.3, false), (0.2, false), (0.4, false), (0.0, true)] {
        let next = step(&config(), &state, round(share, reversed, false));
        state = next.state;
        reasons.extend(next.reason.map(|(reason, _)| reason));
    }
    assert_eq!(
        reasons,
        [Reason::Followed, Reason::RolledBack, Reason::Reversed]
    );
}

#[test]
fn relearning_ends_with_its_time() {
    let mut state = SupervisorState::START;
    state.phase = Phase::PayloadTest;
    let refusal = payload(PayloadDecision::Refuse(Reason::Residual, 0.9));
    state = step(&config(), &state, refusal).state;
    let mut rounds = 0;
    while state.phase == Phase::Relearning {
        let next = step(&config(), &state, round(0.5, false, false));
        let over = next.state.phase == Phase::Healthy;
        assert_eq!(
            next.action,
            if over { Action::Resume } else { Action::None }
        );
        state = next.state;
        rounds += 1;
    }
    assert_eq!(rounds, 834);
}
