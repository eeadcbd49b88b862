//! Bounds of the torque for any motion, any model and any change of model, and the flags that report them.

use super::*;
use crate::Random;

#[test]
fn a_torque_that_the_drives_cannot_have_got_leaves_the_next_within_its_limits() {
    let limits = Ur5::LIMITS.map(|limits| limits.torque);
    for got in [200.0, -200.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
        for stale in [false, true] {
            let mut tick = tick(set());
            tick.applied(&JointVector::from_element(got));
            let torque = match stale {
                true => tick.step_stale(),
                false => tick.step(&sample(motion(0.3))),
            };
            for (joint, limit) in limits.into_iter().enumerate() {
                let total = torque.total[joint];
                assert!(total.abs() <= limit, "{got} {stale} {joint}: {total}");
                if stale {
                    let clamped = got.clamp(-limit, limit);
                    assert_eq!(total, if got.is_finite() { clamped } else { 0.0 });
                }
            }
        }
    }
}

#[test]
fn a_motion_outside_the_limits_is_cut_to_them() {
    let mut wild = motion(0.3);
    wild.q[0] = 7.0;
    wild.qd[1] = -50.0;
    wild.qdd[2] = 1e9;
    let mut cut = wild;
    cut.q[0] = Ur5::LIMITS[0].position.1;
    cut.qd[1] = -Ur5::LIMITS[1].velocity;
    cut.qdd[2] = tick(set()).config().acceleration_limit;
    let torque = settled(&mut tick(set()), &wild);
    assert!(torque.flags.contains(Flags::DESIRED_CLAMPED));
    assert_eq!(torque.total, settled(&mut tick(set()), &cut).total);
}

#[test]
fn beyond_the_learnt_range_what_was_learnt_is_that_of_its_edge() {
    let motion = motion(0.3);
    let range = MotionRange {
        velocity: [0.2; N],
        acceleration: [0.3; N],
    };
    let mut inside = motion;
    inside.qd = motion.qd.map(|qd| qd.clamp(-0.2, 0.2));
    inside.qdd = motion.qdd.map(|qdd| qdd.clamp(-0.3, 0.3));
    let mut learnt = set();
    learnt.rigid *= 1.1;
    let mut tick = tick(set());
    tick.state.set_active(&learnt, &LearntShare::FULL);
    tick.state.range.set(&range);
    let share = settled(&mut tick, &motion).shares.rigid;
    let rigid = |set: &Set, motion| evaluate::<Ur5, N, P>(set, motion).shares.rigid;
    let wanted = rigid(&set(), &motion) + rigid(&learnt, &inside) - rigid(&set(), &inside);
    assert!((share - wanted).amax() < 1e-3, "{share} {wanted}");
    assert!((share - rigid(&learnt, &motion)).amax() > 0.01);
}

#[test]
fn what_was_learnt_is_bounded_around_the_committed_set() {
    let motion = motion(0.3);
    let committed = settled(&mut tick(set()), &motion).total;
    let mut learnt = set();
    learnt.rigid *= 3.0;
    learnt.network[0].output_bias[0] = 5.0;
    let torque = settled(&mut learnt_tick(&learnt), &motion);
    let clipped = Flags::LEARNED_CLIPPED | Flags::NETWORK_CLIPPED;
    assert!(torque.flags.contains(clipped));
    for j in 0..N {
        let bound = LEARNED_BOUND * Ur5::LIMITS[j].torque;
        let change = (torque.total[j] - committed[j]).abs();
        assert!(change <= bound * 1.001, "joint {j}");
    }
    let bound = NETWORK_BOUND * Ur5::LIMITS[0].torque;
    assert_eq!(torque.shares.network[0], bound);
}

#[test]
fn the_torque_of_a_payload_is_cut_to_its_bound_or_left_out() {
    for (factor, part) in [(100.0, 1.0), (-100.0, -1.0), (f32::NAN, 0.0)] {
        let mut tick = tick(set());
        let gravity = settled(&mut tick, &motion(0.3)).shares.rigid[1];
        tick.state.payload = set().rigid * factor;
        settled(&mut tick, &motion(0.3));
        let bound = part * tick.config().payload_bound[1].copysign(gravity);
        assert_eq!(tick.state().payload_torque[1], bound, "{factor}");
    }
}

/// A network is a part of the arm's limit, as the learner has it; bounds of what acts are parts of the limit in force.
#[test]
fn lower_torque_limits_bound_what_was_learnt_and_leave_its_units() {
    let mut parameters = set();
    parameters.network[3].output_bias[0] = 0.05;
    let mut config = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
    let whole = config;
    for (joint, torque) in [(0, 1e4), (0, f32::NAN), (N, 1.0)] {
        config.limit_torque(joint, torque);
        assert_eq!(config, whole, "nothing is raised");
    }
    for joint in 0..N {
        config.limit_torque(joint, 0.1 * config.limits[joint].torque);
    }
    let mut tick = Tick::new(config, parameters).unwrap();
    let desired = motion(0.3);
    let torque = settled(&mut tick, &desired);
    let evaluated = evaluate::<Ur5, N, P>(&parameters, &desired);
    assert_eq!(torque.shares, evaluated.shares);
    for flag in [Flags::WITHDRAWN, Flags::GRAVITY_LOST, Flags::SHARE_FALLBACK] {
        assert!(!torque.flags.contains(flag), "{:?}", torque.flags);
    }
    for joint in 0..N {
        let slew = 0.1 * whole.learned_slew_per_tick[joint];
        let limit = config.limits[joint].torque;
        assert!((config.learned_slew_per_tick[joint] - slew).abs() < 1e-6 * slew);
        assert!(config.payload_bound[joint] <= PAYLOAD_PART * limit);
        assert!(torque.total[joint].abs() <= limit);
    }
}

#[test]
fn the_torque_is_finite_and_limited_for_any_bits() {
    let mut state = 0x1234_5678_9abc_def1u64;
    let mut bits = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        f32::from_bits((state >> 16) as u32)
    };
    let mut finite_motion = 0;
    for round in 0..20_000 {
        let mut start = set();
        // Anything from one wild number to nothing sane at all.
        let wild = |value: &mut f32, bits: &mut dyn FnMut() -> f32| {
            let fresh = bits();
            if round % 3 == 0 || fresh.to_bits() & 7 == 0 {
                *value = fresh;
            }
        };
        start.rigid.iter_mut().for_each(|v| wild(v, &mut bits));
        for friction in &mut start.friction {
            friction.0.iter_mut().for_each(|v| wild(v, &mut bits));
        }
        for layer in start.network.iter_mut().flat_map(|net| net.layers_mut()) {
            layer.iter_mut().for_each(|v| wild(v, &mut bits));
        }
        let mut tick = tick(set());
        match round % 4 {
            0 => tick.state.load(&start),
            1 => tick.state.set_active(&start, &LearntShare::FULL),
            2 => {
                tick.state.set_active(&start, &LearntShare::FULL);
                tick.state.commit();
            }
            _ => tick.state.payload = start.rigid,
        }
        if round % 3 == 0 {
            tick.state.range.set(&WIDE);
        }
        for step in 0..4 {
            let mut desired = motion(round as f32);
            if step % 2 == 1 {
                for part in [&mut desired.q, &mut desired.qd, &mut desired.qdd] {
                    part.iter_mut().for_each(|v| wild(v, &mut bits));
                }
            }
            let torque = tick.step(&sample(desired));
            finite_motion += usize::from(!torque.flags.contains(Flags::STALE_SAMPLE));
            for j in 0..N {
                let bounded = torque.total[j].abs() <= Ur5::LIMITS[j].torque;
                let shares = torque.shares.total()[j];
                assert!(bounded && shares.is_finite(), "round {round}: {torque:?}");
            }
        }
    }
    assert!(
        finite_motion > 40_000,
        "the test hardly reached the shares: {finite_motion}"
    );
}

#[test]
fn no_adoption_commit_or_payload_steps_the_torque_by_more_than_a_hundredth_of_the_limit() {
    for seed in 1..=40u32 {
        let mut random = Random(u64::from(seed));
        let mut random = || random.uniform() as f32;
        let path: [[f32; 3]; N] =
            core::array::from_fn(|_| [random() * 3.0, 1.0 + random(), 0.4 + 0.4 * random()]);
        let at = |tick: u32| {
            sines::<N>(1e-3 * f64::from(tick), |j| {
                let [phase, speed, size] = path[j].map(f64::from);
                [size, speed, phase]
            })
        };
        let mut tick = tick(set());
        let mut exchange = Exchange::new();
        let (mut largest, mut steps) = (0.0f32, 0);
        let mut learned: Option<JointVector<N>> = None;
        for now in 0..600 {
            // A round closes three ticks before its set is taken; some rounds bring nothing new.
            if now >= 60 && now % 6 == 0 && random() > 0.3 {
                let mut new = set();
                for value in new.rigid.iter_mut() {
                    *value *= 1.0 + 0.5 * random();
                }
                for (joint, friction) in new.friction.iter_mut().enumerate() {
                    friction[FrictionColumn::Coulomb] +=
                        0.05 * random().abs() * Ur5::LIMITS[joint].torque;
                    new.network[joint].output_bias[0] = 0.1 * random();
                }
                let mut publication = finished(now - 1, new);
                (publication.range, publication.commit) = (WIDE, random() > 0.5);
                for (place, nominal) in publication.payload.iter_mut().zip(Ur5::NOMINAL) {
                    *place = 0.1 * random() * nominal;
                }
                exchange.published = Some(publication);
            }
            let committed = *tick.state().committed();
            tick.adopt(&mut exchange);
            let commits = *tick.state().committed() != committed;
            let desired = at(now);
            let torque = tick.step(&sample(desired));
            if now < 50 {
                continue;
            }
            assert!(!torque.flags.contains(Flags::SATURATED), "seed {seed}");
            // Measured from a committed set, whose own torque follows the motion.
            let from = |set| torque.total - evaluate::<Ur5, N, P>(set, &desired).total;
            if let Some(learned) = learned {
                let change = from(&committed) - learned;
                for j in 0..N {
                    let part = change[j].abs() / Ur5::LIMITS[j].torque;
                    largest = largest.max(part);
                    steps += u32::from(part > 0.0099);
                    assert!(
                        part < 0.0101,
                        "seed {seed}, tick {now}, joint {j}: {part}, commit: {commits}"
                    );
                }
            }
            learned = Some(from(tick.state().committed()));
        }
        assert!(steps > 20, "the bound was hardly touched: {largest}");
    }
}

/// The table of the flags is tested row by row.
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
    let mut learnt = set();
    change(&mut learnt);
    let mut tick = learnt_tick(&learnt);
    if committed {
        tick.state.commit();
    }
    let (_, sample) = prepared(set());
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
    const NONE: Flags = Flags::NONE;
    let mut rows = Rows(Flags::NONE);
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
