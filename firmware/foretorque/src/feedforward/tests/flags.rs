//! The table of the flags in `docs/safety.md`, row by row.

use super::*;

const PAGE: &str = include_str!("../../../../../docs/safety.md");

/// A settled tick with `parameters`, and a measured sample of its motion.
fn prepared(parameters: Set) -> (Tick, JointSample<N>) {
    let mut tick = tick(parameters);
    let desired = motion(0.3);
    settled(&mut tick, &desired);
    let measured = Some(JointMeasurement {
        q: desired.q,
        tau: JointVector::zeros(),
    });
    (tick, JointSample { desired, measured })
}

/// The tick after `change`.
fn changed(change: fn(&mut Tick, &mut JointSample<N>)) -> Torque<N> {
    let (mut tick, mut sample) = prepared(set());
    change(&mut tick, &mut sample);
    tick.step(&sample)
}

/// The tick after a load of other parameters.
fn loaded(change: fn(&mut Set)) -> Torque<N> {
    let mut loaded = set();
    change(&mut loaded);
    let (mut tick, sample) = prepared(loaded);
    tick.step(&sample)
}

/// The tick after other parameters were learnt, and committed or not.
fn learnt(change: fn(&mut Set), committed: bool) -> Torque<N> {
    let (mut tick, sample) = prepared(set());
    let mut learnt = set();
    change(&mut learnt);
    tick.state.set_active(&learnt, &LearntShare::FULL);
    tick.state.range.set(&WIDE);
    if committed {
        tick.state.commit();
    }
    (0..40).for_each(|_| _ = tick.step(&sample));
    tick.step(&sample)
}

/// The last of so many ticks without a sample.
fn silent(ticks: u32) -> Torque<N> {
    let (mut tick, _) = prepared(set());
    (1..ticks).for_each(|_| _ = tick.step_stale());
    tick.step_stale()
}

/// The first tick of a round in which a set is adopted; no other tick of the round adopts one.
fn adopted(closed: u32) -> Torque<N> {
    let (mut tick, sample) = prepared(set());
    let mut exchange = Exchange::new();
    exchange.published = Some(finished(closed, set()));
    tick.state.tick = 45;
    let mut step = || {
        tick.adopt(&mut exchange);
        tick.step(&sample)
    };
    let first = step();
    assert!((1..N).all(|_| step().flags == Flags::NONE));
    first
}

#[test]
fn every_flag_of_the_page_rises_as_its_row_has_it() {
    type Drive = fn() -> Torque<N>;
    let network = std::format!("its bound, {} % of", (100.0 * NETWORK_BOUND).round());
    let learned = std::format!("its bound, {} % of", (100.0 * LEARNED_BOUND).round());
    let rounds = "every N-th tick, also with learning off";
    // The flag, a part of its row, and a tick in which it rises with the other flags and no more.
    let cases: [(Flags, &str, Drive, Flags); 21] = [
        (
            Flags::SATURATED,
            "cut to the torque limit",
            || loaded(|set| set.rigid *= 8.0),
            Flags::NONE,
        ),
        (
            Flags::SLEWED,
            "normal at the start",
            || changed(|tick, _| *tick = super::tick(set())),
            Flags::NONE,
        ),
        (
            Flags::NETWORK_CLIPPED,
            &network,
            || loaded(|set| set.network[0].output_bias[0] = 5.0),
            Flags::NONE,
        ),
        (
            Flags::LEARNED_CLIPPED,
            &learned,
            || learnt(|set| set.rigid *= 3.0, false),
            Flags::NONE,
        ),
        (
            Flags::STALE_SAMPLE,
            "torque held",
            || silent(1),
            Flags::NO_MEASUREMENT,
        ),
        (
            Flags::STALE_SAMPLE,
            "then to zero",
            || silent(60),
            Flags::NO_MEASUREMENT | Flags::WITHDRAWN,
        ),
        (
            Flags::SHARE_FALLBACK,
            "not plausible",
            || learnt(|set| set.friction[2][FrictionColumn::Viscous] = 1e9, false),
            Flags::NONE,
        ),
        (
            Flags::SHARE_FALLBACK,
            "not finite",
            || learnt(|set| set.rigid.fill(f32::NAN), false),
            Flags::NOT_FINITE,
        ),
        (
            Flags::NOT_FINITE,
            "of the desired motion",
            || changed(|_, sample| sample.desired.qd[3] = f32::NAN),
            Flags::STALE_SAMPLE,
        ),
        (
            Flags::NOT_FINITE,
            "of a share",
            || learnt(|set| set.friction[2].0.fill(f32::NAN), false),
            Flags::SHARE_FALLBACK,
        ),
        (
            Flags::LEARNING_ON,
            "learning is on",
            || changed(|tick, _| tick.set_learning(true)),
            Flags::NONE,
        ),
        (Flags::SET_ADOPTED, rounds, || adopted(41), Flags::NONE),
        (
            Flags::SET_LATE,
            "too slow",
            || adopted(35),
            Flags::SET_ADOPTED,
        ),
        (
            Flags::DESIRED_CLAMPED,
            "cut to the limits",
            || changed(|_, sample| sample.desired.q[0] = 7.0),
            Flags::NONE,
        ),
        (
            Flags::NO_MEASUREMENT,
            "no measurement",
            || changed(|_, sample| sample.measured = None),
            Flags::NONE,
        ),
        (
            Flags::WITHDRAWN,
            "or the torque, goes to zero",
            || silent(12),
            Flags::STALE_SAMPLE | Flags::NO_MEASUREMENT | Flags::SLEWED,
        ),
        (
            Flags::WITHDRAWN,
            "a share",
            || learnt(|set| set.friction[2].0.fill(f32::NAN), true),
            Flags::NOT_FINITE,
        ),
        (
            Flags::PAYLOAD_CLIPPED,
            "cut to its bound",
            || {
                changed(|tick, _| {
                    tick.state.payload = set().rigid * -100.0;
                    let desired = motion(0.3);
                    settled(tick, &desired);
                })
            },
            Flags::NONE,
        ),
        (
            Flags::PAYLOAD_CLIPPED,
            "left out because it was not finite",
            || changed(|tick, _| tick.state.payload.fill(f32::NAN)),
            Flags::NONE,
        ),
        (
            Flags::GRAVITY_LOST,
            "neither active nor committed",
            || learnt(|set| set.rigid.fill(f32::NAN), true),
            Flags::WITHDRAWN | Flags::NOT_FINITE,
        ),
        (
            Flags::GRAVITY_LOST,
            "no sound rigid-body share",
            || learnt(|set| set.rigid.fill(1e30), true),
            Flags::WITHDRAWN,
        ),
    ];
    for (bit, (flag, name)) in Flags::NAMED.into_iter().enumerate() {
        assert_eq!(flag.0, 1 << bit, "{name}");
        let cells = std::format!("| {bit} | `{}` |", name.to_uppercase());
        let row = PAGE.lines().find(|line| line.starts_with(&cells));
        let row = row.unwrap_or_else(|| panic!("docs/safety.md has no row `{cells}`"));
        let mut driven = cases.iter().filter(|case| case.0 == flag).peekable();
        assert!(driven.peek().is_some(), "{name} has no test");
        for (_, text, drive, others) in driven {
            assert!(row.contains(text), "{row}\nhas no `{text}`");
            assert_eq!(drive().flags, flag | *others, "{name}, {text}");
        }
    }
}
