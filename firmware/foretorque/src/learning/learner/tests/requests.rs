//! Requests and loads, which take effect with the sample of their tick.

use super::*;

/// Request at `tick` that takes effect with its sample, with the decision `reason`.
fn request_at(learner: &mut Learner<Ur5, N, P>, tick: u32, request: Request, reason: Reason) {
    let mut exchange = Exchange::new();
    exchange.post_request(1, request).unwrap();
    assert!(exchange.post_request(1, request).is_err());
    let mut sample = sample_of(tick, None, true);
    learner.collect(&sample, &mut exchange);
    assert!(exchange.request.is_some(), "taken before its sample");
    sample.requests = 1;
    learner.collect(&sample, &mut exchange);
    assert_eq!(exchange.request, None);
    let newest = learner.state.report.decisions.newest().unwrap();
    assert_eq!((newest.tick, newest.reason), (tick, reason));
}

#[test]
fn a_rollback_restores_the_snapshot_bit_for_bit() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..200, true);
    request_at(&mut learner, 200, Request::Rollback, Reason::RequestRefused);
    let before = learner.state.active;
    request_at(&mut learner, 201, Request::Snapshot, Reason::SnapshotTaken);
    learn_ticks(&mut learner, 201..1200, true);
    learner.state.active.rigid[0] += 0.1;
    request_at(&mut learner, 1200, Request::Rollback, Reason::RolledBack);
    assert_eq!(learner.state.active, before);
}

#[test]
fn an_emergency_stop_ends_when_learning_is_switched_off() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..60, true);
    request_at(&mut learner, 60, Request::Stop, Reason::FrozenStopped);
    let before = (learner.state.estimate, learner.state.active);
    learn_ticks(&mut learner, 60..120, true);
    assert!((learner.state.estimate, learner.state.active) == before);
    learn_ticks(&mut learner, 120..121, false);
    learn_ticks(&mut learner, 121..130, true);
    assert!(learner.state.estimate != before.0);
}

#[test]
fn samples_of_another_load_are_not_used() {
    let mut learner = learner();
    learn_ticks(&mut learner, 0..60, true);
    let mut exchange = Exchange::new();
    learner.publish(&mut exchange);
    exchange.published = None;
    let before = (learner.state.estimate, learner.state.statistics);
    for tick in 60..120 {
        let mut foreign = sample_of(tick, Some(measured(tick, 2.0, 20.0)), true);
        foreign.generation = 1;
        learner.learn(&foreign, &mut exchange);
        assert_eq!(exchange.published, None, "tick {tick}");
    }
    assert!((learner.state.estimate, learner.state.statistics) == before);
    // The window has filled meanwhile.
    learn_ticks(&mut learner, 120..121, true);
    assert!(learner.state.statistics.accepted > before.1.accepted);
}

#[test]
fn a_pending_commit_ends_with_a_new_load() {
    let mut learner = learner();
    let mut exchange = Exchange::new();
    learner.execute(0, Request::Commit);
    for tick in 0..6 {
        learner.learn(&sample_of(tick, None, true), &mut exchange);
    }
    assert!(exchange.published.is_some_and(|set| set.commit));
    // A load during a learning step, before the tick has adopted the set.
    exchange.reload = Some((1, ParameterSet::nominal::<Ur5>(9), StartDeviations::PRIOR));
    for tick in 6..12 {
        let mut sample = sample_of(tick, None, true);
        sample.generation = 1;
        learner.learn(&sample, &mut exchange);
    }
    let published = exchange.published.unwrap();
    assert_eq!((published.generation, published.commit), (1, false));
}
