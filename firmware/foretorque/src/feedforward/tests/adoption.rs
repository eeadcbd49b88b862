//! How a learnt or loaded set comes to count, also where the counter of the tick wraps.

use super::*;
use crate::learning::{Learner, LearnerConfig, Reason, Request, StartDeviations};
use std::boxed::Box;
use std::vec::Vec;

#[test]
fn a_set_is_adopted_at_the_middle_of_the_next_round_and_at_no_other_tick() {
    let mut tick = tick(set());
    tick.set_learning(true);
    let mut learnt = set();
    learnt.friction[0][FrictionColumn::Viscous] = 9.0;
    let mut exchange = Exchange::new();
    for count in 0..30u32 {
        tick.adopt(&mut exchange);
        let torque = tick.step(&sample(motion(0.0)));
        let due = count >= 9 && count % 6 == 3;
        let adopted = torque.flags.contains(Flags::SET_ADOPTED);
        assert_eq!(adopted, due, "tick {count}");
        assert_eq!(tick.state().active == learnt, count >= 9, "tick {count}");
        if count % 6 == 5 {
            exchange.published = Some(finished(count, learnt));
        }
    }
    assert_eq!(tick.state().late_sets, 0);
}

#[test]
fn a_set_that_is_not_there_in_time_is_counted_and_taken_a_round_later() {
    let mut tick = tick(set());
    tick.set_learning(true);
    let mut exchange = Exchange::new();
    let mut adopted = Vec::new();
    for count in 0..24u32 {
        tick.adopt(&mut exchange);
        let torque = tick.step(&sample(motion(0.0)));
        if torque.flags.contains(Flags::SET_ADOPTED) {
            adopted.push((count, torque.flags.contains(Flags::SET_LATE)));
        }
        // The round that closed at tick 11 is ready only after the boundary at tick 15.
        if count == 16 {
            exchange.published = Some(finished(11, set()));
        }
    }
    assert_eq!(adopted, [(21, true)]);
    assert_eq!(tick.state().late_sets, 2);
}

#[test]
fn a_loaded_set_counts_at_once_and_drops_what_was_on_its_way() {
    let mut tick = tick(set());
    let mut exchange = Exchange::new();
    for _ in 0..8 {
        tick.step(&sample(motion(0.0)));
    }
    exchange.published = Some(finished(5, set()));
    let mut loaded = set();
    loaded.friction[1][FrictionColumn::Coulomb] = 4.0;
    tick.load(loaded, &mut exchange);
    let state = tick.state();
    assert_eq!((state.active, *state.committed()), (loaded, loaded));
    assert_eq!(exchange.reload, Some((1, loaded, StartDeviations::PRIOR)));
    // The learner was still busy with a learning sample from before the load.
    exchange.published = Some(finished(5, set()));
    for _ in 0..6 {
        tick.adopt(&mut exchange);
        tick.step(&sample(motion(0.0)));
    }
    assert_eq!(tick.state().active, loaded);
}

#[test]
fn a_request_waits_for_the_one_before_and_a_stop_replaces_it() {
    let mut tick = tick(set());
    let mut exchange = Exchange::new();
    tick.request(Request::Commit, &mut exchange).unwrap();
    assert!(tick.request(Request::Snapshot, &mut exchange).is_err());
    assert_eq!(tick.state().requests, 1);
    tick.request_over(Request::Stop, &mut exchange);
    assert_eq!(tick.state().requests, 2);
    assert_eq!(exchange.request, Some((2, Request::Stop)));
}

/// The motion steps as the commit comes, or after ticks without a sample.
#[test]
fn a_commit_brings_nothing_of_the_motion_before_it() {
    let from = motion(0.0);
    for (stale, acceleration) in [(0, 0.0), (0, 20.0), (3, 0.0), (30, 0.0)] {
        let mut tick = tick(set());
        settled(&mut tick, &from);
        let mut exchange = Exchange::new();
        let mut adopt = |tick: &mut Tick, commit| {
            exchange.published = Some(Publication {
                commit,
                ..finished(tick.state.tick, set())
            });
            tick.adopt(&mut exchange);
            exchange.published.is_none()
        };
        while !adopt(&mut tick, true) {
            tick.step(&sample(from));
        }
        for _ in 0..stale {
            tick.step_stale();
            adopt(&mut tick, false);
        }
        let mut to = from;
        to.q[1] = -3.1;
        to.qdd.fill(acceleration);
        for _ in 0..3 {
            tick.step(&sample(to));
            assert!(tick.learnt_torque().amax() < 1e-3, "{stale} {acceleration}");
        }
        let torque = settled(&mut tick, &to);
        assert_eq!(torque.total, evaluate::<Ur5, N, P>(&set(), &to).total);
    }
}

/// The next set comes before a sample.
#[test]
fn a_commit_lasts_without_a_sample_after_it() {
    let mut tick = tick(set());
    let mut exchange = Exchange::new();
    let [first, second] = [9.0, 10.0].map(|viscous| {
        let mut set = set();
        set.friction[0][FrictionColumn::Viscous] = viscous;
        set
    });
    for (learnt, commit) in [(first, true), (second, false)] {
        exchange.published = Some(Publication {
            commit,
            ..finished(tick.state.tick, learnt)
        });
        while exchange.published.is_some() {
            tick.step_stale();
            tick.adopt(&mut exchange);
        }
        assert_eq!(
            (tick.state().active, *tick.state().committed()),
            (learnt, first)
        );
    }
    tick.step(&sample(motion(0.0)));
    assert_eq!(*tick.state().committed(), first);
}

#[test]
fn an_active_set_that_needs_the_committed_one_does_not_become_it() {
    let mut tick = tick(set());
    let mut exchange = Exchange::new();
    let mut unsound = finished(5, set());
    unsound.set.friction[2][FrictionColumn::Coulomb] = 1e9;
    (unsound.range, unsound.commit) = (WIDE, true);
    exchange.published = Some(unsound);
    tick.state.tick = 9;
    tick.adopt(&mut exchange);
    for _ in 0..3 {
        let torque = tick.step(&sample(motion(0.3)));
        assert!(torque.flags.contains(Flags::SHARE_FALLBACK));
    }
    assert_eq!(*tick.state().committed(), set());
}

#[test]
fn what_was_learnt_returns_after_a_silence_as_that_of_the_motion_then() {
    let mut learnt = set();
    learnt.rigid *= 1.1;
    let mut tick = learnt_tick(&learnt);
    settled(&mut tick, &motion(0.3));
    (0..40).for_each(|_| _ = tick.step_stale());
    // Of another pose: the total alone is slewed.
    tick.step(&sample(motion(2.0)));
    let at_once = tick.state().learned;
    settled(&mut tick, &motion(2.0));
    assert_eq!(at_once, tick.state().learned);
}

#[test]
fn the_learner_sees_an_end_of_learning_that_no_tick_saw() {
    let mut tick = tick(set());
    let enabled = |tick: &mut Tick| {
        tick.step(&sample(motion(0.0)));
        tick.learning_sample(None).enabled
    };
    tick.set_learning(true);
    assert!(enabled(&mut tick));
    for pauses in [0, 1, 5] {
        tick.set_learning(false);
        tick.set_learning(true);
        (0..pauses).for_each(|_| _ = tick.pause());
        let seen: [bool; 3] = core::array::from_fn(|_| enabled(&mut tick));
        assert_eq!(seen, [false, true, true], "{pauses}");
    }
    tick.set_learning(false);
    assert!(!enabled(&mut tick) && !enabled(&mut tick) && !enabled(&mut tick));
}

#[test]
fn the_loaded_set_stays_beside_what_was_learnt() {
    let mut loaded = set();
    loaded.network[0].output_bias[0] = 0.05;
    loaded.network[1].output_bias[0] = 0.05;
    let mut tick = tick(loaded);
    let mut learnt = loaded;
    learnt.rigid *= 1.1;
    learnt.friction[3][FrictionColumn::Viscous] = 9.0;
    learnt.network[1].output_bias[0] = 0.02;
    tick.state.set_active(&learnt, &LearntShare::FULL);
    tick.state.commit();
    assert_eq!(*tick.state().committed(), learnt);
    assert_eq!(*tick.state().loaded(), loaded);
}

#[test]
fn starting_over_leaves_nothing_of_what_was() {
    let (mut used, fresh) = (tick(set()), tick(Set::nominal::<Ur5>(1)));
    let mut exchange = Exchange::new();
    used.set_learning(true);
    for step in 0..20 {
        let mut learnt = finished(step, set());
        learnt.set.friction[2][FrictionColumn::Coulomb] += 0.1;
        (learnt.range, learnt.commit) = (WIDE, step % 7 == 0);
        exchange.published = Some(learnt);
        used.adopt(&mut exchange);
        used.step(&sample(motion(0.1 * step as f32)));
    }
    used.step_stale();
    // A set adopted, and committed, whose tick has not run.
    exchange.published = Some(Publication {
        commit: true,
        ..finished(20, set())
    });
    used.state.tick = 27;
    used.adopt(&mut exchange);
    assert_ne!(used.state(), fresh.state());
    used.restart(*fresh.config(), &Set::nominal::<Ur5>(1))
        .unwrap();
    // But for its number: a set that was learnt before must not pass for one that was learnt since.
    assert_eq!(used.state().generation, 1);
    used.state.generation = 0;
    assert_eq!(used.state(), fresh.state());
}

/// Ticks after a jump of the counter until a round has begun, closed and been adopted.
const SETTLING: u32 = 16;
/// Ticks of a run: some rounds after the first.
const TICKS: u32 = 36;

/// A tick, its learner, and a counter that can be put anywhere: the years between are not waited for.
struct Bench {
    tick: Tick,
    learner: Box<Learner<Ur5, N, P>>,
    exchange: Box<Exchange<N, P>>,
}

impl Bench {
    fn new() -> Self {
        let config = LearnerConfig::for_arm::<Ur5>(1e-3);
        let mut bench = Self {
            tick: tick(set()),
            learner: Box::new(Learner::new(config, set()).unwrap()),
            exchange: Box::new(Exchange::new()),
        };
        bench.tick.set_learning(true);
        bench
    }

    fn step(&mut self) -> Flags {
        self.tick.adopt(&mut self.exchange);
        self.tick.step(&sample(motion(0.0))).flags
    }

    /// Ticks whose learning samples wait for the learner.
    fn run_ahead(&mut self, ticks: u32) -> Vec<LearningSample<N>> {
        let learning_samples = (0..ticks).map(|_| {
            self.step();
            self.tick.learning_sample(None)
        });
        learning_samples.collect()
    }

    /// A run from the tick `at` on that adopts its rounds, and none of them late.
    fn run(&mut self, at: u32) {
        self.tick.state.tick = at;
        let (mut adopted, mut late) = (0, 0);
        for count in 0..TICKS {
            let flags = self.step();
            let learning_sample = self.tick.learning_sample(None);
            self.learner.learn(&learning_sample, &mut self.exchange);
            if count >= SETTLING {
                adopted += u32::from(flags.contains(Flags::SET_ADOPTED));
                late += u32::from(flags.contains(Flags::SET_LATE));
            }
        }
        // The round in which the counter wraps is cut short, so nothing is due from it.
        let in_time = (2..=4).contains(&adopted) && late == 0;
        assert!(in_time, "{at:#010x}: {adopted} sets, {late} late");
    }

    /// Asks for `request` at the tick `first`, and runs from the tick `then` on.
    fn carry_out(&mut self, request: Request, reason: Reason, first: u32, then: u32) {
        self.tick.state.tick = first;
        self.tick.request(request, &mut self.exchange).unwrap();
        self.run(then);
        let newest = self.tick.state().report.decisions.newest();
        let decided = newest.map(|decision| decision.reason);
        assert_eq!(decided, Some(reason), "{first:#010x} {then:#010x}");
    }
}

fn moved(by: f32) -> Set {
    let mut moved = set();
    moved.friction[0][FrictionColumn::Viscous] += by;
    moved
}

/// Loads a set and makes requests at the tick `first`, where the learner next runs from the tick `then` on.
fn take_effect(first: u32, then: u32) {
    let place = std::format!("{first:#010x} {then:#010x}");
    let mut bench = Bench::new();
    // A set is loaded while learning samples from before it wait.
    bench.tick.state.tick = first.wrapping_sub(3);
    let before = bench.run_ahead(3);
    bench.tick.load(moved(1.0), &mut bench.exchange);
    for learning_sample in before {
        bench.learner.learn(&learning_sample, &mut bench.exchange);
    }
    assert!(bench.exchange.reload.is_some(), "{place}: taken too early");
    // The learner has no payload.
    bench.tick.state.payload[3] = 5.0;
    bench.step();
    assert!(bench.tick.state().payload_torque.amax() > 1.0, "{place}");
    bench.run(then);
    assert_eq!(bench.learner.state().active, moved(1.0), "{place}");
    assert_eq!(bench.tick.state().active, moved(1.0), "{place}");
    let carried = bench.tick.state().payload_torque.amax();
    assert_eq!(carried, 0.0, "{place}: the payload's torque stays");
    bench.carry_out(Request::Snapshot, Reason::SnapshotTaken, first, then);
    bench.learner.set_active(&moved(2.0));
    bench.carry_out(Request::Commit, Reason::Committed, first, then);
    assert_eq!(*bench.tick.state().committed(), moved(2.0), "{place}");
    bench.carry_out(Request::Rollback, Reason::RolledBack, first, then);
    assert_eq!(bench.tick.state().active, moved(1.0), "{place}");
}

#[test]
fn c1_loads_requests_and_publications_take_effect_at_every_distance_and_across_every_wrap() {
    let around =
        |point: u32| [-40, -25, -7, -1, 0, 1, 7, 40].map(|by| point.wrapping_add_signed(by));
    let points = [around(0), around(1 << 31)].concat();
    for &first in &points {
        points.iter().for_each(|&then| take_effect(first, then));
    }
}
