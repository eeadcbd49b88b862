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

const NONE: Flags = Flags::NONE;

/// The flags of the page that have risen in a test.
struct Rows(Flags);

impl Rows {
    /// `flag` has risen in `torque` as the `text` in its row has it, with the flags of `others` and no more.
    #[track_caller]
    fn rises(&mut self, torque: &Torque<N>, flag: Flags, others: Flags, text: &str) {
        let (bit, name) = (flag.0.trailing_zeros(), flag.name().to_uppercase());
        let cells = std::format!("| {bit} | `{name}` |");
        let row = PAGE.lines().find(|line| line.starts_with(&cells));
        let row = row.unwrap_or_else(|| panic!("docs/safety.md has no row `{cells}`"));
        assert!(row.contains(text), "{row}\nhas no `{text}`");
        assert_eq!(torque.flags, flag | others, "{name}, {text}");
        self.0 |= flag;
    }
}

#[test]
fn every_flag_of_the_page_rises_as_its_row_has_it() {
    let mut rows = Rows(NONE);
    let percent = |bound: f32| std::format!("its bound, {} % of", (100.0 * bound).round());
    let torque = loaded(|set| set.rigid *= 8.0);
    rows.rises(&torque, Flags::SATURATED, NONE, "cut to the torque limit");
    let torque = changed(|tick, _| *tick = super::tick(set()));
    rows.rises(&torque, Flags::SLEWED, NONE, "normal at the start");
    let torque = loaded(|set| set.network[0].output_bias[0] = 5.0);
    let bound = percent(NETWORK_BOUND);
    rows.rises(&torque, Flags::NETWORK_CLIPPED, NONE, &bound);
    let torque = learnt(|set| set.rigid *= 3.0, false);
    let bound = percent(LEARNED_BOUND);
    rows.rises(&torque, Flags::LEARNED_CLIPPED, NONE, &bound);

    let flag = Flags::STALE_SAMPLE;
    let others = Flags::NO_MEASUREMENT;
    rows.rises(&silent(1), flag, others, "torque held");
    let others = others | Flags::WITHDRAWN;
    rows.rises(&silent(60), flag, others, "then to zero");

    let flag = Flags::SHARE_FALLBACK;
    let torque = learnt(|set| set.friction[2][FrictionColumn::Viscous] = 1e9, false);
    rows.rises(&torque, flag, NONE, "not plausible");
    let torque = learnt(|set| set.rigid.fill(f32::NAN), false);
    rows.rises(&torque, flag, Flags::NOT_FINITE, "not finite");

    let flag = Flags::NOT_FINITE;
    let torque = changed(|_, sample| sample.desired.qd[3] = f32::NAN);
    let others = Flags::STALE_SAMPLE;
    rows.rises(&torque, flag, others, "of the desired motion");
    let torque = learnt(|set| set.friction[2].0.fill(f32::NAN), false);
    rows.rises(&torque, flag, Flags::SHARE_FALLBACK, "of a share");

    let torque = changed(|tick, _| tick.set_learning(true));
    rows.rises(&torque, Flags::LEARNING_ON, NONE, "learning is on");
    let text = "every N-th tick, also with learning off";
    rows.rises(&adopted(41), Flags::SET_ADOPTED, NONE, text);
    let others = Flags::SET_ADOPTED;
    rows.rises(&adopted(35), Flags::SET_LATE, others, "too slow");
    let torque = changed(|_, sample| sample.desired.q[0] = 7.0);
    let flag = Flags::DESIRED_CLAMPED;
    rows.rises(&torque, flag, NONE, "cut to the limits");
    let torque = changed(|_, sample| sample.measured = None);
    rows.rises(&torque, Flags::NO_MEASUREMENT, NONE, "no measurement");

    let flag = Flags::WITHDRAWN;
    let others = Flags::STALE_SAMPLE | Flags::NO_MEASUREMENT | Flags::SLEWED;
    rows.rises(&silent(12), flag, others, "or the torque, goes to zero");
    let torque = learnt(|set| set.friction[2].0.fill(f32::NAN), true);
    rows.rises(&torque, flag, Flags::NOT_FINITE, "a share");

    let flag = Flags::PAYLOAD_CLIPPED;
    let torque = changed(|tick, sample| {
        tick.state.payload = set().rigid * -100.0;
        settled(tick, &sample.desired);
    });
    rows.rises(&torque, flag, NONE, "cut to its bound");
    let torque = changed(|tick, _| tick.state.payload.fill(f32::NAN));
    rows.rises(&torque, flag, NONE, "left out because it was not finite");

    let flag = Flags::GRAVITY_LOST;
    let others = Flags::WITHDRAWN | Flags::NOT_FINITE;
    let torque = learnt(|set| set.rigid.fill(f32::NAN), true);
    rows.rises(&torque, flag, others, "neither active nor committed");
    let others = Flags::WITHDRAWN;
    let torque = learnt(|set| set.rigid.fill(1e30), true);
    rows.rises(&torque, flag, others, "no sound rigid-body share");

    for (bit, (flag, name)) in Flags::NAMED.into_iter().enumerate() {
        assert_eq!(flag.0, 1 << bit, "{name}");
        assert!(rows.0.contains(flag), "{name} has no test");
    }
}
