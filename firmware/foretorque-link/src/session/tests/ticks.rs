use super::*;
use crate::telemetry::Cost;

#[test]
fn currents_count_only_with_a_drive_gain() {
    let frame = SampleFrame::new(&sample(0)).with_current(&JointVector::<N>::repeat(0.5));
    assert_eq!(frame.sample(&[0.0; N]).measured, None);
    let measured = frame.sample(&[10.0; N]).measured.unwrap();
    assert_eq!(measured.tau, JointVector::<N>::repeat(5.0));
}

#[test]
fn the_timer_runs_the_newest_sample_once() {
    let mut board = Board::new();
    board.pace(Pacing::SysTick);
    for k in 0..2 {
        assert!(board.send(&sample_message(k)).is_empty());
    }
    for (tick, stale) in [(0, false), (1, true)] {
        let replies = board.timer();
        let (sequence, reply) = &replies[0];
        let torque = torque(reply);
        assert_eq!((*sequence, torque.tick), (3, tick));
        assert_eq!(Flags(torque.flags).contains(Flags::NO_MEASUREMENT), stale);
    }
    let statistics = board.statistics();
    assert_eq!((statistics.overtaken, statistics.stale_ticks), (1, 1));
}

#[test]
fn a_sample_that_waits_is_dropped_by_a_configuration() {
    let mut board = Board::new();
    board.pace(Pacing::SysTick);
    assert!(board.send(&sample_message(0)).is_empty());
    board.pace(Pacing::SysTick);
    let flags = Flags(torque(&board.timer()[0].1).flags);
    assert!(flags.contains(Flags::STALE_SAMPLE));
}

/// Every counter counts what it is called, by one, and a reset sets all of them back.
#[test]
fn counters_count_and_a_reset_clears_them() {
    let mut board = Board::new();
    board.session.note_boot(77);
    board.pace(Pacing::SysTick);
    // The learner never runs, and its queue takes 15.
    for k in 0..20_u8 {
        let frame = SampleFrame::new(&sample(0)).in_period(k);
        board.send(&HostMessage::Sample(frame.with_temperature(60)));
        board.timer();
    }
    let mut bad = sample(0);
    bad.measured.as_mut().unwrap().tau[5] = 90.0;
    for _ in 0..3 {
        board.session.note_overrun();
        board.session.note_reply_lost();
        board.timer();
        board.send(&HostMessage::Sample(SampleFrame::new(&bad)));
        board.timer();
        let mut damaged = board.numbered(&HostMessage::Hello);
        damaged[5] ^= 1;
        board.receive(&damaged);
        board.receive(&[1, 0]);
    }
    let repeated = frame(board.sequence - 1, &HostMessage::Statistics);
    board.receive(&repeated);
    let clock = |costs: [u32; 2]| Cost {
        mean: costs[0],
        max: costs[1],
    };
    board.session.note_line(clock([3, 4]), clock([5, 6]));
    board.session.note_feeds(9);
    board.mailboxes.learner.begin(&mut board.learner);
    board.mailboxes.learner.finish(&mut board.learner, 1000);
    let counted = board.statistics();
    let expected = Statistics {
        frames: 25,
        crc_errors: 3,
        framing_errors: 3,
        missed: 2,
        repeated: 1,
        stale_ticks: 3,
        overruns: 3,
        replies_lost: 3,
        ticks: 26,
        learning_samples_lost: 11,
        learn_cost: counted.learn_cost,
        hottest_c: 60,
        implausible: 3,
        receive_cost: clock([3, 4]),
        reply_latency: clock([5, 6]),
        watchdog_feeds: 9,
        bytes_lost: counted.bytes_lost,
        ..Board::new().statistics()
    };
    assert_eq!(counted, expected);
    assert_eq!(counted.learn_cost.max, 1000);
    assert!(counted.bytes_lost > 0);
    board.acknowledged(HostMessage::Reset);
    let cleared = Statistics {
        // What the owner counts stays.
        receive_cost: clock([3, 4]),
        reply_latency: clock([5, 6]),
        watchdog_feeds: 9,
        ..Board::new().statistics()
    };
    assert_eq!(board.statistics(), cleared);
    assert_eq!(board.hello().boot_counts, 77);
}

#[test]
fn a_temperature_of_the_boards_own_counts() {
    let mut board = Board::armed();
    board.session.note_temperature(2, 100);
    board.sample(0);
    let latched = board.session.latched_fault();
    assert_eq!(latched, SafetyReason::MotorHot);
}

#[test]
fn the_timer_runs_no_tick_where_samples_pace() {
    let mut board = Board::new();
    assert!(board.timer().is_empty());
    assert_eq!(board.statistics().ticks, 0);
}

#[test]
fn every_constant_follows_the_period() {
    let mut board = Board::new();
    board.acknowledged(configure(|wanted| wanted.period_us = 4000));
    let bank = ParameterBank::nominal::<Ur5, N, P>();
    let wanted = bank.feed_forward_config::<Ur5, N, P>(4e-3).unwrap();
    assert_eq!(*board.session.feed_forward().config(), wanted);
    // The learner restarts too: it closes and publishes a round from its new tick 0.
    for k in 0..6 {
        board.sample(k);
        board.learn();
    }
    assert_eq!(board.learner.state().statistics.published, 1);
}

#[test]
fn torques_do_not_depend_on_the_delay_of_the_learner() {
    let run = |delay: u32| -> Vec<TorqueFrame<N>> {
        let mut board = Board::new();
        board.acknowledged(HostMessage::Learning { on: true });
        (0..400)
            .map(|k| {
                let torque = board.sample(k);
                // The last tick of a round, N - 1, is due N / 2 ticks later.
                if k % (delay + 1) == delay {
                    board.learn();
                }
                torque
            })
            .collect()
    };
    let prompt = run(0);
    assert_eq!(run(2), prompt);
    let adopted = |torque: &&TorqueFrame<N>| Flags(torque.flags).contains(Flags::SET_ADOPTED);
    assert!(prompt.iter().filter(adopted).count() > 60);
}

#[test]
fn a_set_learnt_before_a_restart_never_reaches_later_ticks() {
    let mut board = Board::new();
    board.acknowledged(HostMessage::Learning { on: true });
    for k in 0..5 {
        board.sample(k);
        board.learn();
    }
    board.sample(5);
    let sample = board.mailboxes.learner.begin(&mut board.learner).unwrap();
    board.learner.study(&sample);
    // The tick interrupts the learner here, at the end of a round.
    board.acknowledged(HostMessage::Learning { on: false });
    board.acknowledged(HostMessage::Reset);
    board.mailboxes.learner.finish(&mut board.learner, 0);
    assert_eq!(board.mailboxes.learner.exchange.published, None);
}

#[test]
fn a_sample_that_is_not_finite_gives_a_finite_torque() {
    let mut board = Board::new();
    let mut broken = sample(0);
    broken.desired.q[2] = f32::NAN;
    let reply = board.request(HostMessage::Sample(SampleFrame::new(&broken)));
    let torque = torque(&reply);
    assert!(torque.total.iter().all(|tau| tau.is_finite()));
    assert!(Flags(torque.flags).contains(Flags::NOT_FINITE));
}

/// A sample whose reply waits for the learner.
fn waiting_sample() -> HostMessage<N> {
    HostMessage::Sample(SampleFrame::new(&sample(1)).answered_after_learning())
}

#[test]
fn a_waiting_reply_is_held_until_everything_is_learnt() {
    let mut board = Board::new();
    board.acknowledged(HostMessage::Learning { on: true });
    board.sample(0);
    assert!(!board.mailboxes.learner.holds_reply(), "not requested");
    board.request(waiting_sample());
    assert!(board.mailboxes.learner.holds_reply());
    // Two samples wait. A command interrupts the learner in the first one.
    for (interrupted, released) in [(true, false), (false, true)] {
        let sample = board.mailboxes.learner.begin(&mut board.learner).unwrap();
        if interrupted {
            board.request(HostMessage::Statistics);
        }
        board.learner.study(&sample);
        let mailbox = &mut board.mailboxes.learner;
        mailbox.finish(&mut board.learner, 0);
        assert_eq!(mailbox.release_reply(), released);
        assert_eq!(mailbox.holds_reply(), !released);
    }
    let mailbox = &mut board.mailboxes.learner;
    assert!(mailbox.begin(&mut board.learner).is_none());
    assert!(!mailbox.release_reply(), "it is sent once");
}

#[test]
fn a_restart_of_the_tick_releases_a_waiting_reply() {
    let mut board = Board::new();
    board.request(waiting_sample());
    board.acknowledged(HostMessage::Reset);
    let mailbox = &mut board.mailboxes.learner;
    assert!(mailbox.begin(&mut board.learner).is_none());
    assert!(mailbox.release_reply());
}
