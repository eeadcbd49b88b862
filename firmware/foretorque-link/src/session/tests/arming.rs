use super::*;

fn status(torque: &TorqueFrame<N>) -> (SafetyState, SafetyReason) {
    (torque.safety.state, torque.safety.reason)
}

fn armed() -> Board {
    let mut board = Board::new();
    board.arm();
    for _ in 0..20 {
        board.sample(0);
    }
    assert_ne!(board.sample(0).total, [0.0; N]);
    board
}

#[test]
fn torque_flows_only_between_arming_and_disarming() {
    let mut board = Board::new();
    let refused = BoardMessage::Nack(NackReason::Unsafe(SafetyReason::NoSample));
    assert_eq!(board.ask(HostMessage::Arm), refused);
    for k in 0..50 {
        let torque = board.sample(k);
        assert_eq!(torque.total, [0.0; N]);
        assert_ne!(torque.shares, [0.0; 3], "the shares are told all the same");
        assert_eq!(torque.safety, SafetyStatus::default());
    }
    assert!(!board.session.torque_enabled());
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
    let first = board.sample(50);
    assert!(board.session.torque_enabled());
    let slew = board.session.feed_forward().config().slew_per_tick;
    for (torque, slew) in first.total.iter().zip(slew) {
        assert!(
            torque.abs() <= slew,
            "the torque held back does not come at once"
        );
    }
    for k in 51..100 {
        board.sample(k);
    }
    assert_eq!(board.ask(HostMessage::Disarm), BoardMessage::Ack);
    let mut ramp = Vec::new();
    while board.session.torque_enabled() {
        ramp.push(board.sample(100).total[1].abs());
    }
    assert!(ramp.is_sorted_by(|a, b| a >= b), "{ramp:?}");
    let after = board.sample(100);
    assert_eq!(after.total, [0.0; N]);
    assert_eq!(
        status(&after),
        (SafetyState::Disarmed, SafetyReason::Disarmed)
    );
}

#[test]
fn an_armed_board_gives_the_torque_of_its_feed_forward_bit_for_bit() {
    let mut board = armed();
    let mut bare = *board.session.feed_forward().state();
    let config = *board.session.feed_forward().config();
    let mut scratch = foretorque::feedforward::FeedForwardScratch::new();
    for k in 0..400 {
        let frame = SampleFrame::new(&sample(k));
        let heard = frame.sample(&[0.0; N]);
        let wanted =
            foretorque::feedforward::step::<Ur5, N, P>(&config, &mut bare, &mut scratch, &heard);
        let given = board.sample(k);
        let bits = |total: [f32; N]| total.map(f32::to_bits);
        assert_eq!(bits(given.total), bits(wanted.total.into()), "tick {k}");
    }
}

#[test]
fn a_stop_takes_effect_in_the_next_reply_even_when_its_number_is_old() {
    let mut board = armed();
    let late = frame(board.sequence, &HostMessage::Stop);
    let answers = board.hear(&late);
    assert_eq!(answers, [(board.sequence, BoardMessage::Ack)]);
    assert!(!board.session.torque_enabled());
    let after = board.sample(0);
    assert_eq!(after.total, [0.0; N]);
    assert_eq!(status(&after), (SafetyState::Fault, SafetyReason::Stopped));
    let refused = BoardMessage::Nack(NackReason::Unsafe(SafetyReason::Stopped));
    assert_eq!(board.ask(HostMessage::Arm), refused);
    assert_eq!(board.ask(HostMessage::Reset), BoardMessage::Ack);
    assert_eq!(
        board.ask(HostMessage::Arm),
        refused,
        "a reset of the session clears no fault"
    );
    assert_eq!(board.ask(HostMessage::ClearFault), BoardMessage::Ack);
    board.arm();
}

#[test]
fn nothing_is_written_while_torque_flows() {
    let mut board = armed();
    let refused = BoardMessage::Nack(NackReason::Armed);
    let bank = uploaded();
    let written = HostMessage::BankWrite {
        offset: 0,
        bytes: bank[..CHUNK].iter().copied().collect(),
    };
    let before = board.read();
    assert_eq!(board.ask(written), refused);
    assert_eq!(board.commit(&bank), refused);
    assert_eq!(board.ask(HostMessage::Reset), refused);
    let configure = HostMessage::Configure(Configuration::default());
    assert_eq!(board.ask(configure), refused);
    assert_eq!(board.read(), before);
    assert!(board.session.torque_enabled());
}

#[test]
fn silence_of_a_board_paced_by_its_timer_ends_the_torque_and_samples_do_not_bring_it_back() {
    let mut board = Board::new();
    let timer = HostMessage::Configure(Configuration {
        pacing: Pacing::SysTick,
        ..Configuration::default()
    });
    assert_eq!(board.ask(timer), BoardMessage::Ack);
    let told = |board: &mut Board, k: Option<u32>| {
        if let Some(k) = k {
            board.sequence += 1;
            let line = frame(board.sequence, &sample_message(k));
            assert!(board.hear(&line).is_empty());
        }
        match board.timer().as_slice() {
            [(_, BoardMessage::Torque(torque))] => *torque,
            other => panic!("{other:?}"),
        }
    };
    for _ in 0..ARM_SAMPLES {
        told(&mut board, Some(0));
    }
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
    let full = (0..40).map(|_| told(&mut board, Some(0))).last().unwrap();
    assert!(full.total[1].abs() > 10.0);
    let mut before = full.total;
    for tick in 0..60 {
        let torque = told(&mut board, None);
        let steps = torque.total.iter().zip(before).zip(Ur5::LIMITS);
        for ((now, before), limits) in steps {
            assert!((now - before).abs() <= limits.torque / 10.0);
        }
        before = torque.total;
        let armed = torque.safety.state == SafetyState::Armed;
        assert_eq!(armed, tick < 50, "tick {tick}");
    }
    for _ in 0..20 {
        let torque = told(&mut board, Some(0));
        assert_eq!(torque.total, [0.0; N]);
        assert_eq!(
            status(&torque),
            (SafetyState::Disarmed, SafetyReason::CommandTimeout)
        );
    }
    assert!(!board.session.torque_enabled());
}

#[test]
fn silence_of_a_board_paced_by_its_samples_ends_the_torque_by_its_own_timer() {
    let mut board = armed();
    for _ in 0..100 {
        assert!(board.timer().is_empty(), "nothing is said unasked");
    }
    assert!(!board.session.torque_enabled());
    let after = board.sample(0);
    assert_eq!(after.total, [0.0; N]);
    assert_eq!(
        status(&after),
        (SafetyState::Disarmed, SafetyReason::CommandTimeout)
    );
}

#[test]
fn a_board_that_had_to_restart_waits_for_somebody_to_take_note() {
    for (reset_reason, kept_fault, first) in [
        (
            ResetReason::Watchdog,
            SafetyReason::None,
            SafetyReason::Restarted,
        ),
        (
            ResetReason::Panic,
            SafetyReason::None,
            SafetyReason::Restarted,
        ),
        (
            ResetReason::Fault,
            SafetyReason::MotorHot,
            SafetyReason::MotorHot,
        ),
        (
            ResetReason::Software,
            SafetyReason::Stopped,
            SafetyReason::Stopped,
        ),
        (ResetReason::PowerOn, SafetyReason::None, SafetyReason::None),
    ] {
        let mut board = Board::described(BoardDescription {
            reset_reason,
            kept_fault,
            ..BoardDescription::plain(NoClock)
        });
        assert_eq!(board.session.latched_fault(), first);
        for _ in 0..ARM_SAMPLES {
            board.sample(0);
        }
        let answer = match first {
            SafetyReason::None => BoardMessage::Ack,
            fault => BoardMessage::Nack(NackReason::Unsafe(fault)),
        };
        assert_eq!(board.ask(HostMessage::Arm), answer);
    }
}

#[test]
fn a_hot_motor_ends_the_torque_of_all() {
    let mut board = armed();
    for _ in 0..20 {
        let hot = SampleFrame::new(&sample(0)).with_temperature(101);
        board.ask(HostMessage::Sample(hot));
    }
    assert_eq!(
        status(&board.sample(0)),
        (SafetyState::Fault, SafetyReason::MotorHot)
    );
}

#[test]
fn what_is_asked_of_the_learner_is_handed_on() {
    let mut board = Board::new();
    let ask = |code| HostMessage::Request { code };
    for unknown in [0, 5, 6, 200] {
        let refused = BoardMessage::Nack(NackReason::NotCapable);
        assert_eq!(board.ask(ask(unknown)), refused);
    }
    assert_eq!(board.ask(ask(1)), BoardMessage::Ack);
    let busy = BoardMessage::Nack(NackReason::Busy);
    assert_eq!(board.ask(ask(3)), busy);
    let waits = board.mailboxes.learner.exchange.request;
    assert_eq!(waits, Some((1, foretorque::learning::Request::Snapshot)));
    board.sample(0);
    board.learn();
    assert_eq!(board.ask(ask(3)), BoardMessage::Ack);
}

/// A board with either pacing, as silicon has it: a timer runs beside the samples.
fn timed(pacing: Pacing) -> Board {
    let mut board = Board::new();
    let configuration = Configuration {
        pacing,
        ..Configuration::default()
    };
    assert_eq!(
        board.ask(HostMessage::Configure(configuration)),
        BoardMessage::Ack
    );
    for _ in 0..ARM_SAMPLES {
        assert_eq!(board.period(Some(sample(0))).unwrap().total, [0.0; N]);
    }
    board
}

#[test]
fn samples_older_than_the_time_out_arm_no_board_whatever_paces_it() {
    let refused = BoardMessage::Nack(NackReason::Unsafe(SafetyReason::NoSample));
    for pacing in [Pacing::Link, Pacing::SysTick] {
        for (silent, answer) in [
            (49, &BoardMessage::Ack),
            (51, &refused),
            (1000, &refused),
            (100_000, &refused),
        ] {
            let mut board = timed(pacing);
            for _ in 0..silent {
                board.period(None);
            }
            let told = board.ask(HostMessage::Arm);
            assert_eq!(told, *answer, "{pacing:?}, {silent} periods");
            let armed = *answer == BoardMessage::Ack;
            assert_eq!(board.session.torque_enabled(), armed);
            if !armed {
                // One sample does not make the ones of before fresh.
                board.period(Some(sample(0)));
                assert_eq!(board.ask(HostMessage::Arm), refused, "{pacing:?}");
                (0..2).for_each(|_| _ = board.period(Some(sample(0))));
                assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
            }
        }
    }
}

#[test]
fn an_arm_that_has_moved_since_it_was_armed_gets_no_torque() {
    type Change = fn(&mut JointSample<N>);
    let cases: [(Change, SafetyReason); 6] = [
        (
            |s| s.measured.as_mut().unwrap().q[1] += 0.8,
            SafetyReason::PositionJump,
        ),
        (|s| s.desired.q[1] += 0.8, SafetyReason::DesiredJump),
        (
            |s| s.desired.qd[0] = f32::NAN,
            SafetyReason::DesiredNotFinite,
        ),
        (
            |s| s.measured.as_mut().unwrap().tau[5] = 90.0,
            SafetyReason::EffortRange,
        ),
        // In 40 periods a joint can get so far.
        (
            |s| s.measured.as_mut().unwrap().q[5] += 0.21,
            SafetyReason::TooFar,
        ),
        // Near enough to where the arm was measured last.
        (|s| s.measured = None, SafetyReason::None),
    ];
    for pacing in [Pacing::Link, Pacing::SysTick] {
        for (change, reason) in cases {
            let mut board = timed(pacing);
            assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
            if reason == SafetyReason::TooFar {
                for _ in 0..40 {
                    let torque = board.period(None);
                    assert!(torque.is_none_or(|torque| torque.total == [0.0; N]));
                }
                assert!(board.session.torque_enabled());
            }
            let mut changed = sample(0);
            change(&mut changed);
            let first = board.period(Some(changed)).unwrap();
            let flows = reason == SafetyReason::None;
            assert_eq!(first.total != [0.0; N], flows, "{pacing:?}, {reason:?}");
            let state = if flows {
                SafetyState::Armed
            } else {
                SafetyState::Disarmed
            };
            assert_eq!(status(&first), (state, reason), "{pacing:?}");
            assert_eq!(board.session.torque_enabled(), flows);
            for _ in 0..20 {
                let torque = board.period(Some(changed)).unwrap();
                assert_eq!(torque.total != [0.0; N], flows, "{pacing:?}, {reason:?}");
            }
        }
    }
}
