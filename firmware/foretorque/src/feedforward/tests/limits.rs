//! Bounds of the torque for any motion, any model and any change of model.

use super::*;

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
fn a_motion_that_is_not_finite_is_no_motion() {
    let changes: [fn(&mut JointMotion<N>) -> &mut f32; 3] =
        [|m| &mut m.q[2], |m| &mut m.qd[2], |m| &mut m.qdd[2]];
    for (change, bad) in changes
        .iter()
        .flat_map(|c| [f32::NAN, f32::INFINITY].map(|b| (c, b)))
    {
        let mut broken = motion(0.3);
        *change(&mut broken) = bad;
        let flags = tick(set()).step(&sample(broken)).flags;
        assert!(flags.contains(Flags::NOT_FINITE | Flags::STALE_SAMPLE));
    }
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
    let mut tick = tick(set());
    let committed = settled(&mut tick, &motion).total;
    let mut learnt = set();
    learnt.rigid *= 3.0;
    learnt.network[0].output_bias[0] = 5.0;
    tick.state.set_active(&learnt, &LearntShare::FULL);
    tick.state.range.set(&WIDE);
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
                    friction[FrictionColumn::Coulomb] +=
                        0.05 * dice().abs() * Ur5::LIMITS[joint].torque;
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
