//! How a learnt or loaded set comes to count.

use super::*;
use crate::learning::{Request, StartDeviations};

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
    loaded.friction[1][FrictionColumn::Coulomb] = 4.0;
    tick.load(loaded, &mut exchange);
    assert_eq!(
        (tick.state().active, tick.state().committed),
        (loaded, loaded)
    );
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

#[test]
fn what_was_learnt_is_dropped_and_what_was_loaded_stays() {
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
    let mut saved = tick.state().committed;
    assert_ne!(saved, loaded);
    tick.state().drop_learnt(&mut saved);
    let mut wanted = loaded;
    wanted.network[1] = learnt.network[1].silenced();
    assert_eq!(saved, wanted);
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
    let mut last = finished(20, set());
    last.commit = true;
    exchange.published = Some(last);
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
