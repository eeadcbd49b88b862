use super::*;

#[test]
fn currents_count_by_the_drive_gain_once_it_is_known() {
    let frame = SampleFrame::new(&sample(0)).with_current(&JointVector::<N>::repeat(0.5));
    assert_eq!(frame.sample(&[0.0; N]).measured, None);
    let measured = frame.sample(&[10.0; N]).measured.unwrap();
    assert_eq!(measured.tau, JointVector::<N>::repeat(5.0));
}

#[test]
fn the_timer_runs_the_newest_sample_once_and_then_none() {
    let mut board = Board::new();
    let timer = HostMessage::Configure(Configuration {
        pacing: Pacing::SysTick,
        ..Configuration::default()
    });
    assert_eq!(board.ask(timer), BoardMessage::Ack);
    assert!(board.hear(&frame(2, &sample_message(0))).is_empty());
    assert!(board.hear(&frame(3, &sample_message(1))).is_empty());
    let flags = |answers: Vec<(u16, BoardMessage<N>)>| match answers.as_slice() {
        [(sequence, BoardMessage::Torque(torque))] => (*sequence, torque.tick, Flags(torque.flags)),
        other => panic!("{other:?}"),
    };
    let (sequence, tick, first) = flags(board.timer());
    assert_eq!((sequence, tick), (3, 0));
    assert!(!first.contains(Flags::NO_MEASUREMENT));
    let (sequence, tick, second) = flags(board.timer());
    assert_eq!((sequence, tick), (3, 1));
    assert!(second.contains(Flags::NO_MEASUREMENT));
    let statistics = board.session.statistics(&board.mailboxes.learner);
    assert_eq!((statistics.overtaken, statistics.stale_ticks), (1, 1));
}

#[test]
fn the_timer_does_nothing_where_the_link_paces() {
    let mut board = Board::new();
    assert!(board.timer().is_empty());
    assert_eq!(board.session.statistics(&board.mailboxes.learner).ticks, 0);
}

#[test]
fn every_constant_follows_the_period() {
    let mut board = Board::new();
    let slow = HostMessage::Configure(Configuration {
        period_us: 4000,
        ..Configuration::default()
    });
    assert_eq!(board.ask(slow), BoardMessage::Ack);
    let bank = ParameterBank::nominal::<Ur5, N, P>();
    let wanted = bank.feed_forward_config::<Ur5, N, P>(4e-3).unwrap();
    assert_eq!(*board.session.feed_forward().config(), wanted);
    // The learner starts over too: a round is closed and published from its new tick 0.
    for k in 0..6 {
        board.ask(sample_message(k));
        board.learn();
    }
    assert_eq!(board.learner.state().statistics.published, 1);
}

#[test]
fn learnt_sets_do_not_depend_on_how_late_the_learner_is_within_its_time() {
    let run = |delay: u32| -> Vec<BoardMessage<N>> {
        let mut board = Board::new();
        board.ask(HostMessage::Learning { on: true });
        (0..400)
            .map(|k| {
                let answer = board.ask(sample_message(k));
                // The last tick of a round, N - 1, is due N / 2 ticks later.
                if k % (delay + 1) == delay {
                    board.learn();
                }
                answer
            })
            .collect()
    };
    let prompt = run(0);
    assert_eq!(run(2), prompt);
    let flags = prompt.iter().filter_map(|answer| match answer {
        BoardMessage::Torque(torque) => Some(Flags(torque.flags)),
        _ => None,
    });
    let adopted = flags
        .filter(|flags| flags.contains(Flags::SET_ADOPTED))
        .count();
    assert!(adopted > 60, "{adopted}");
}

#[test]
fn a_set_learnt_before_a_restart_never_meets_the_ticks_after_it() {
    let mut board = Board::new();
    board.ask(HostMessage::Learning { on: true });
    for k in 0..5 {
        board.ask(sample_message(k));
        board.learn();
    }
    board.ask(sample_message(5));
    let lesson = board.mailboxes.learner.begin(&mut board.learner).unwrap();
    board.learner.study(&lesson);
    // The tick interrupts the learner here, at the end of a round.
    board.ask(HostMessage::Learning { on: false });
    assert_eq!(board.ask(HostMessage::Reset), BoardMessage::Ack);
    board.mailboxes.learner.finish(&mut board.learner, 0);
    assert_eq!(board.mailboxes.learner.exchange.published, None);
}

#[test]
fn a_sample_that_is_not_a_number_gives_a_finite_torque() {
    let mut board = Board::new();
    let mut broken = sample(0);
    broken.desired.q[2] = f32::NAN;
    let answer = board.ask(HostMessage::Sample(SampleFrame::new(&broken)));
    let BoardMessage::Torque(torque) = answer else {
        panic!("{answer:?}");
    };
    assert!(torque.total.iter().all(|tau| tau.is_finite()));
    assert!(Flags(torque.flags).contains(Flags::NOT_FINITE));
}

#[test]
fn an_answer_that_is_to_wait_is_held_until_everything_is_learnt() {
    let mut board = Board::new();
    board.ask(HostMessage::Learning { on: true });
    board.ask(sample_message(0));
    assert!(
        !board.mailboxes.learner.holds_reply(),
        "nobody asked for it"
    );
    let patient = SampleFrame::new(&sample(1)).answered_after_learning();
    board.ask(HostMessage::Sample(patient));
    assert!(board.mailboxes.learner.holds_reply());
    // Two lessons wait. The learner is interrupted in the first one.
    let first = board.mailboxes.learner.begin(&mut board.learner).unwrap();
    board.ask(HostMessage::Statistics);
    board.learner.study(&first);
    board.mailboxes.learner.finish(&mut board.learner, 0);
    assert!(!board.mailboxes.learner.release_reply() && board.mailboxes.learner.holds_reply());
    let second = board.mailboxes.learner.begin(&mut board.learner).unwrap();
    board.learner.study(&second);
    board.mailboxes.learner.finish(&mut board.learner, 0);
    assert!(board.mailboxes.learner.begin(&mut board.learner).is_none());
    assert!(board.mailboxes.learner.release_reply() && !board.mailboxes.learner.holds_reply());
    assert!(!board.mailboxes.learner.release_reply(), "it is sent once");
}

#[test]
fn an_answer_that_waits_when_the_tick_starts_over_is_let_go() {
    let mut board = Board::new();
    let patient = SampleFrame::new(&sample(1)).answered_after_learning();
    board.ask(HostMessage::Sample(patient));
    assert_eq!(board.ask(HostMessage::Reset), BoardMessage::Ack);
    assert!(board.mailboxes.learner.begin(&mut board.learner).is_none());
    assert!(board.mailboxes.learner.release_reply());
}
