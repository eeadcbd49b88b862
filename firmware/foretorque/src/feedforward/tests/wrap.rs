//! The counter of the tick wraps after 2³² ticks, and half of its range apart two of its values have no order.

use super::*;
use crate::learning::{Learner, LearnerConfig, Reason};
use std::boxed::Box;
use std::vec::Vec;

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
        let lessons = (0..ticks).map(|_| {
            self.step();
            self.tick.learning_sample(None)
        });
        lessons.collect()
    }

    /// A run from the tick `at` on; whether it adopts its rounds, and none of them late.
    fn run(&mut self, at: u32) -> bool {
        self.tick.state.tick = at;
        let (mut adopted, mut late) = (0, 0);
        for count in 0..TICKS {
            let flags = self.step();
            let lesson = self.tick.learning_sample(None);
            self.learner.learn(&lesson, &mut self.exchange);
            if count >= SETTLING {
                adopted += u32::from(flags.contains(Flags::SET_ADOPTED));
                late += u32::from(flags.contains(Flags::SET_LATE));
            }
        }
        // The round in which the counter wraps is cut short, so nothing is due from it.
        (2..=4).contains(&adopted) && late == 0
    }

    /// Asks for `request` at the tick `first`, and runs from the tick `then` on; whether it was carried out.
    fn carries_out(&mut self, request: Request, reason: Reason, first: u32, then: u32) -> bool {
        self.tick.state.tick = first;
        let asked = self.tick.request(request, &mut self.exchange).is_ok();
        let whole = self.run(then);
        let newest = self.tick.state().report.decisions.newest();
        asked && whole && newest.is_some_and(|decision| decision.reason == reason)
    }
}

fn moved(by: f32) -> Set {
    let mut moved = set();
    moved.friction[0][FrictionColumn::Viscous] += by;
    moved
}

/// The promises that are broken where a set is loaded and requests are made at the tick `first`, and the learner next
/// runs from the tick `then` on.
fn broken(first: u32, then: u32) -> Vec<&'static str> {
    let mut bench = Bench::new();
    // A set is loaded while learning samples from before it wait.
    bench.tick.state.tick = first.wrapping_sub(3);
    let before = bench.run_ahead(3);
    bench.tick.load(moved(1.0), &mut bench.exchange);
    for lesson in before {
        bench.learner.learn(&lesson, &mut bench.exchange);
    }
    let reload_waits = bench.exchange.reload.is_some();
    // The learner has no payload.
    bench.tick.state.payload[3] = 5.0;
    bench.step();
    let carried = bench.tick.state().payload_torque.amax() > 1.0;
    let adopts = bench.run(then);
    let taken = bench.learner.state().active == moved(1.0);
    let state = bench.tick.state();
    let (active, put_down) = (state.active, state.payload_torque.amax() == 0.0);
    let kept = bench.carries_out(Request::Snapshot, Reason::SnapshotTaken, first, then);
    bench.learner.set_active(&moved(2.0));
    let commits = bench.carries_out(Request::Commit, Reason::Committed, first, then);
    let committed = bench.tick.state().committed;
    let rolls_back = bench.carries_out(Request::Rollback, Reason::RolledBack, first, then);
    let promises = [
        (reload_waits, "a lesson from before the load takes the set"),
        (taken, "the learner does not take the set"),
        (
            adopts && active == moved(1.0),
            "publications are not adopted",
        ),
        (carried && put_down, "the payload's torque stays"),
        (kept, "a snapshot is not made"),
        (commits && committed == moved(2.0), "a commit has no effect"),
        (
            rolls_back && bench.tick.state().active == moved(1.0),
            "a rollback has no effect",
        ),
    ];
    let broken = promises.into_iter().filter(|(holds, _)| !holds);
    broken.map(|(_, promise)| promise).collect()
}

#[test]
fn c1_loads_requests_and_publications_take_effect_at_every_distance_and_across_every_wrap() {
    let around =
        |point: u32| [-40, -25, -7, -1, 0, 1, 7, 40].map(|by| point.wrapping_add_signed(by));
    let points = [around(0), around(1 << 31)].concat();
    let rows = points
        .iter()
        .flat_map(|&first| points.iter().map(move |&then| (first, then)));
    let failures: Vec<_> = rows
        .map(|(first, then)| (first, then, broken(first, then)))
        .filter(|(_, _, broken)| !broken.is_empty())
        .map(|(first, then, broken)| std::format!("{first:#010x} {then:#010x} {broken:?}"))
        .collect();
    assert!(
        failures.is_empty(),
        "{} of {} rows:\n{}",
        failures.len(),
        points.len().pow(2),
        failures.join("\n")
    );
}
