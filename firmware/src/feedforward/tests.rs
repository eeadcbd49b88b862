//! The tick, without learning: shares, limits, fallbacks, adoption.

use super::*;
use crate::arm::ur5::Ur5;
use crate::dynamics::BaseParameters;
use crate::joint::JointMotion;
use crate::learning::{MotionRange, Publication, Report};

const N: usize = 6;
const P: usize = 40;
type Tick = FeedForward<Ur5, N, P>;
type Set = ParameterSet<N, P>;

/// Everything the arm can do has been learnt.
const WIDE: MotionRange<N> = MotionRange {
    velocity: [1e3; N],
    acceleration: [1e3; N],
};

fn set() -> Set {
    let mut set = Set::nominal::<Ur5>(3);
    for (joint, friction) in set.friction.iter_mut().enumerate() {
        friction.viscous = 1.0 + joint as f32;
        friction.coulomb = 0.5;
    }
    set
}

fn finished(closed: u32, set: Set) -> Publication<N, P> {
    Publication {
        closed,
        set,
        payload: BaseParameters::zeros(),
        range: MotionRange::NONE,
        commit: false,
        report: Report::new(),
    }
}

fn tick(set: Set) -> Tick {
    Tick::new(FeedForwardConfig::for_arm::<Ur5, P>(1e-3), set).unwrap()
}

fn motion(phase: f32) -> JointMotion<N> {
    JointMotion {
        q: JointVector::from_fn(|j, _| (phase + j as f32).sin()),
        qd: JointVector::from_fn(|j, _| (phase + j as f32).cos()),
        qdd: JointVector::from_fn(|j, _| -(phase + j as f32).sin()),
    }
}

fn sample(desired: JointMotion<N>) -> JointSample<N> {
    JointSample {
        desired,
        measured: None,
    }
}

/// The torque of `tick` for a motion that has been asked for long enough to be past the slew limit.
fn settled(tick: &mut Tick, motion: &JointMotion<N>) -> Torque<N> {
    for _ in 0..40 {
        tick.step(&sample(*motion));
    }
    tick.step(&sample(*motion))
}

#[test]
fn starting_over_leaves_nothing_of_what_was() {
    let (mut used, fresh) = (tick(set()), tick(Set::nominal::<Ur5>(1)));
    let mut exchange = Exchange::new();
    used.set_learning(true);
    for step in 0..20 {
        let mut learnt = finished(step, set());
        learnt.set.friction[2].coulomb += 0.1;
        (learnt.range, learnt.commit) = (WIDE, step % 7 == 0);
        exchange.published = Some(learnt);
        used.adopt(&mut exchange);
        used.step(&sample(motion(0.1 * step as f32)));
    }
    used.step_stale();
    assert_ne!(used.state(), fresh.state());
    used.restart(*fresh.config(), &Set::nominal::<Ur5>(1))
        .unwrap();
    assert_eq!(used.state(), fresh.state());
}

#[test]
fn the_settled_torque_is_the_sum_of_the_evaluated_shares() {
    let motion = motion(0.3);
    let torque = settled(&mut tick(set()), &motion);
    let evaluated = evaluate::<Ur5, N, P>(&set(), &motion);
    assert_eq!(torque.shares, evaluated.shares);
    assert_eq!(torque.total, evaluated.total);
    assert_eq!(torque.flags, Flags::NO_MEASUREMENT);
    assert!(torque.shares.rigid.amax() > 10.0 && torque.shares.friction.amax() > 1.0);
}

#[test]
fn cogging_follows_the_measured_place_and_nothing_else_does() {
    let mut cogging = set();
    cogging.friction[1].cogging_sin = 0.5;
    let desired = motion(0.3);
    let mut tick = tick(cogging);
    let mut share_at = |q: f32| {
        let mut measured = JointMeasurement {
            q: desired.q,
            tau: JointVector::zeros(),
        };
        measured.q[1] = q;
        let measured = Some(measured);
        tick.step(&JointSample { desired, measured }).shares
    };
    let lead = 1.5e-3 * desired.qd[1];
    let plain = evaluate::<Ur5, N, P>(&set(), &desired).shares;
    for k in 0..100 {
        let place = 0.01 * k as f32;
        let mut wanted = plain;
        wanted.friction[1] += 0.5 * (202.0 * place).sin();
        let share = share_at(place - lead);
        assert!((share.friction - wanted.friction).amax() < 1e-4, "{place}");
        assert_eq!((share.rigid, share.network), (plain.rigid, plain.network));
    }
    // A wild encoder leaves the cogging of the desired place.
    let unmeasured = evaluate::<Ur5, N, P>(&cogging, &desired).shares;
    for wild in [f32::NAN, f32::INFINITY, -1e30] {
        assert_eq!(share_at(wild), unmeasured);
    }
}

#[test]
fn torque_rises_from_zero_at_the_slew_limit() {
    let mut tick = tick(set());
    let slew = tick.config().slew_per_tick[1];
    for count in 1..5 {
        let torque = tick.step(&sample(JointMotion::zero()));
        assert!(torque.flags.contains(Flags::SLEWED));
        assert!((torque.total[1].abs() - slew * count as f32).abs() < 1e-4);
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
fn a_broken_share_is_replaced_by_the_committed_one_and_the_others_go_on() {
    let motion = motion(1.1);
    let whole = evaluate::<Ur5, N, P>(&set(), &motion).shares;
    let spoil: [fn(&mut Set); 3] = [
        |s| s.rigid.fill(f32::NAN),
        |s| s.friction[2].viscous = f32::INFINITY,
        |s| s.network[4].output_bias[0] = f32::NAN,
    ];
    for spoil in spoil {
        let mut tick = tick(set());
        let mut broken = set();
        spoil(&mut broken);
        tick.state.set_active(&broken);
        let torque = settled(&mut tick, &motion);
        assert_eq!(torque.shares, whole);
        assert!(
            torque
                .flags
                .contains(Flags::SHARE_FALLBACK | Flags::NOT_FINITE)
        );
        assert!(!torque.flags.contains(Flags::WITHDRAWN));
    }
}

#[test]
fn a_share_broken_in_both_sets_is_withdrawn_alone_at_the_slew_limit() {
    let motion = motion(1.1);
    let mut tick = tick(set());
    let before = settled(&mut tick, &motion);
    let mut broken = set();
    broken.rigid.fill(f32::NAN);
    tick.state.set_active(&broken);
    tick.state.set_committed(&broken);
    let next = tick.step(&sample(motion));
    assert!(next.flags.contains(Flags::WITHDRAWN | Flags::SLEWED));
    for j in 0..N {
        let slew = tick.config().slew_per_tick[j] * 1.001;
        assert!((next.total[j] - before.total[j]).abs() <= slew, "joint {j}");
    }
    assert_eq!(settled(&mut tick, &motion).total, before.shares.friction);
}

#[test]
fn what_was_learnt_is_bounded_around_the_committed_set() {
    let motion = motion(0.3);
    let mut tick = tick(set());
    let committed = settled(&mut tick, &motion).total;
    let mut learnt = set();
    learnt.rigid *= 3.0;
    learnt.network[0].output_bias[0] = 5.0;
    tick.state.set_active(&learnt);
    tick.state.range = WIDE;
    let torque = settled(&mut tick, &motion);
    assert!(
        torque
            .flags
            .contains(Flags::LEARNED_CLIPPED | Flags::NETWORK_CLIPPED)
    );
    for j in 0..N {
        let bound = LEARNED_BOUND * Ur5::LIMITS[j].torque;
        assert!(
            (torque.total[j] - committed[j]).abs() <= bound * 1.001,
            "joint {j}"
        );
    }
    assert_eq!(
        torque.shares.network[0],
        NETWORK_BOUND * Ur5::LIMITS[0].torque
    );
}

#[test]
fn without_samples_the_torque_is_held_then_slewed_to_zero() {
    let mut tick = tick(set());
    let before = settled(&mut tick, &motion(0.3));
    for _ in 0..tick.config().hold_ticks {
        let held = tick.step_stale();
        assert_eq!(held.total, before.total);
        assert!(held.flags.contains(Flags::STALE_SAMPLE));
    }
    let mut last = before.total;
    for _ in 0..25 {
        let torque = tick.step_stale();
        assert!(torque.flags.contains(Flags::WITHDRAWN));
        for j in 0..N {
            assert!((torque.total[j] - last[j]).abs() <= tick.config().slew_per_tick[j] * 1.001);
        }
        last = torque.total;
    }
    assert_eq!(last.amax(), 0.0);
    let back = settled(&mut tick, &motion(0.3));
    assert_eq!(back.total, before.total);
}

#[test]
fn a_desired_motion_that_is_not_finite_is_no_sample() {
    let mut broken = motion(0.3);
    broken.qdd[5] = f32::NAN;
    let (mut fed, mut starved) = (tick(set()), tick(set()));
    settled(&mut fed, &motion(0.3));
    settled(&mut starved, &motion(0.3));
    for _ in 0..40 {
        let torque = fed.step(&sample(broken));
        assert!(
            torque
                .flags
                .contains(Flags::STALE_SAMPLE | Flags::NOT_FINITE)
        );
        assert_eq!(torque.total, starved.step_stale().total);
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
            wild(&mut friction.viscous, &mut bits);
            wild(&mut friction.coulomb, &mut bits);
            wild(&mut friction.stribeck, &mut bits);
            wild(&mut friction.bend, &mut bits);
            wild(&mut friction.offset, &mut bits);
            wild(&mut friction.cogging_sin, &mut bits);
            wild(&mut friction.cogging_cos, &mut bits);
        }
        for net in &mut start.network {
            net.hidden_weights
                .iter_mut()
                .for_each(|v| wild(v, &mut bits));
            net.output_weights
                .iter_mut()
                .for_each(|v| wild(v, &mut bits));
            net.output_bias.iter_mut().for_each(|v| wild(v, &mut bits));
        }
        let mut tick = tick(set());
        match round % 4 {
            0 => tick.state.load(&start),
            1 => tick.state.set_active(&start),
            2 => {
                tick.state.set_active(&start);
                tick.state.set_committed(&start);
            }
            _ => tick.state.payload = start.rigid,
        }
        if round % 3 == 0 {
            tick.state.range = WIDE;
        }
        for step in 0..4 {
            let mut desired = motion(round as f32);
            for value in desired
                .q
                .iter_mut()
                .chain(desired.qd.iter_mut())
                .chain(desired.qdd.iter_mut())
            {
                if step % 2 == 1 {
                    wild(value, &mut bits);
                }
            }
            let torque = tick.step(&sample(desired));
            finite_motion += usize::from(!torque.flags.contains(Flags::STALE_SAMPLE));
            for j in 0..N {
                assert!(
                    torque.total[j].abs() <= Ur5::LIMITS[j].torque,
                    "round {round}: {torque:?}"
                );
                let shares =
                    torque.shares.rigid[j] + torque.shares.friction[j] + torque.shares.network[j];
                assert!(shares.is_finite(), "round {round}: {torque:?}");
            }
        }
    }
    assert!(
        finite_motion > 40_000,
        "the test hardly reached the shares: {finite_motion}"
    );
}

#[test]
fn a_set_is_adopted_at_the_middle_of_the_next_round_and_at_no_other_tick() {
    let mut tick = tick(set());
    tick.set_learning(true);
    let mut learnt = set();
    learnt.friction[0].viscous = 9.0;
    let mut exchange = Exchange::new();
    for count in 0..30u32 {
        tick.adopt(&mut exchange);
        let torque = tick.step(&sample(motion(0.0)));
        let due = count >= 9 && count % 6 == 3;
        assert_eq!(
            torque.flags.contains(Flags::SET_ADOPTED),
            due,
            "tick {count}"
        );
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
    loaded.friction[1].coulomb = 4.0;
    tick.load(loaded, &mut exchange);
    assert_eq!(
        (tick.state().active, tick.state().committed),
        (loaded, loaded)
    );
    assert_eq!(exchange.reload, Some((8, loaded)));
    // The learner was still busy with a lesson from before the load.
    exchange.published = Some(finished(5, set()));
    for _ in 0..6 {
        tick.adopt(&mut exchange);
        tick.step(&sample(motion(0.0)));
    }
    assert_eq!(tick.state().active, loaded);
}

#[test]
fn a_configuration_that_cannot_work_is_refused() {
    let good = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
    let mut slew = good;
    slew.slew_per_tick[3] = f32::NAN;
    let mut range = good;
    range.limits[0].position = (1.0, -1.0);
    assert!(good.validate().is_ok());
    assert_eq!(
        slew.validate(),
        Err(ConfigError::NotPositive("slew_per_tick"))
    );
    assert_eq!(
        range.validate(),
        Err(ConfigError::NotPositive("limits.position"))
    );
}

#[test]
fn no_adoption_commit_or_payload_steps_the_torque_by_more_than_a_hundredth_of_the_limit() {
    for seed in 1..=40u32 {
        let mut word = seed;
        let mut dice = move || {
            word = word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (word >> 8) as f32 / 8_388_608.0 - 1.0
        };
        let path: [[f32; 3]; N] =
            core::array::from_fn(|_| [dice() * 3.0, 1.0 + dice(), 0.4 + 0.4 * dice()]);
        let at = |tick: u32| {
            let angle = |j: usize| path[j][0] + path[j][1] * tick as f32 * 1e-3;
            let [speed, size] = [1, 2].map(|k| move |j: usize| path[j][k]);
            JointMotion::<N> {
                q: JointVector::from_fn(|j, _| size(j) * angle(j).sin()),
                qd: JointVector::from_fn(|j, _| size(j) * speed(j) * angle(j).cos()),
                qdd: JointVector::from_fn(|j, _| -size(j) * speed(j).powi(2) * angle(j).sin()),
            }
        };
        let mut tick = tick(set());
        let mut exchange = Exchange::new();
        let (mut largest, mut steps) = (0.0f32, 0);
        let mut before: Option<(JointVector<N>, JointVector<N>)> = None;
        for now in 0..600 {
            // A round closes three ticks before its set is taken; some rounds bring nothing new.
            if now >= 60 && now % 6 == 0 && dice() > 0.3 {
                let mut new = set();
                for value in new.rigid.iter_mut() {
                    *value *= 1.0 + 0.5 * dice();
                }
                for (joint, friction) in new.friction.iter_mut().enumerate() {
                    friction.coulomb += 0.05 * dice().abs() * Ur5::LIMITS[joint].torque;
                    new.network[joint].output_bias[0] = 0.1 * dice();
                }
                let mut publication = finished(now - 1, new);
                publication.range = WIDE;
                publication.commit = dice() > 0.5;
                for (place, nominal) in publication.payload.iter_mut().zip(Ur5::NOMINAL) {
                    *place = 0.1 * dice() * nominal;
                }
                exchange.published = Some(publication);
            }
            let committed = tick.state().committed;
            tick.adopt(&mut exchange);
            let recommitted = tick.state().committed != committed;
            let desired = at(now);
            let torque = tick.step(&sample(desired));
            if now < 50 {
                continue;
            }
            assert!(!torque.flags.contains(Flags::SATURATED), "seed {seed}");
            // Measured from the committed set, whose own torque follows the motion.
            let reference = evaluate::<Ur5, N, P>(&tick.state().committed, &desired).total;
            if let Some((total, learned)) = before {
                let change = if recommitted {
                    torque.total - total
                } else {
                    torque.total - reference - learned
                };
                for j in 0..N {
                    let part = change[j].abs() / Ur5::LIMITS[j].torque;
                    largest = largest.max(part);
                    steps += u32::from(part > 0.0099);
                    assert!(
                        part < 0.0101,
                        "seed {seed}, tick {now}, joint {j}: {part}, commit: {recommitted}"
                    );
                }
            }
            before = Some((torque.total, torque.total - reference));
        }
        assert!(steps > 20, "the bound was hardly touched: {largest}");
    }
}
