//! Whose position counts, and what comes of none.

use super::*;

#[test]
fn the_encoder_and_not_the_sample_says_where_the_joint_is() {
    let mut board = Board::new(TurnReference::Near(0.0));
    // The host believes the joint half a radian away; the encoder is right.
    for _ in 0..5 {
        board.sample(&still(0.5));
    }
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
    let mut board = Board::new(TurnReference::Near(0.0));
    board.chip.borrow_mut().angle = 1304;
    for _ in 0..5 {
        board.sample(&still(0.0));
    }
    assert!(far(&mut board), "the encoder is half a radian away");
}

#[test]
fn a_reading_that_fails_drops_the_measurement_and_the_tick_goes_on() {
    let mut board = Board::armed(TurnReference::Near(0.0));
    let torque = board.sample(&still(0.0)).total;
    board.chip.borrow_mut().flips = (0, 0, 1);
    let reply = board.sample(&still(0.0));
    assert_eq!(reply.safety.state, SafetyState::Armed);
    assert_eq!(reply.safety.reason, SafetyReason::Encoder);
    assert!(Flags(reply.flags).contains(Flags::NO_MEASUREMENT));
    assert_eq!(reply.total, torque);
    assert_eq!(board.encoder.last_error(), Some(EncoderError::Parity));
    let reply = board.sample(&still(0.0));
    assert_eq!(reply.safety.reason, SafetyReason::None);
    assert!(!Flags(reply.flags).contains(Flags::NO_MEASUREMENT));
    assert_eq!(board.encoder.last_error(), None);
}

#[test]
fn an_encoder_that_is_gone_ends_the_torque_within_the_time_out_and_latches() {
    for (level, error) in [
        (0x0000, EncoderError::NotReady),
        (0xffff, EncoderError::Refused(7)),
    ] {
        let mut board = Board::armed(TurnReference::Near(0.0));
        board.chip.borrow_mut().level = Some(level);
        let mut ticks = 0;
        while board.sample(&still(0.0)).safety.state == SafetyState::Armed {
            ticks += 1;
        }
        assert!((49..=52).contains(&ticks), "{ticks}");
        for _ in 0..20 {
            board.sample(&still(0.0));
        }
        assert!(!board.bench.borrow().enabled);
        let safety = board.session.safety();
        assert_eq!(
            (safety.state, safety.reason),
            (SafetyState::Fault, SafetyReason::Encoder)
        );
        let told = (0..4).any(|_| {
            board.sample(&still(0.0));
            board.encoder.last_error() == Some(error)
        });
        assert!(told, "{level:#x}");
    }
}

#[test]
fn a_board_without_its_encoder_is_not_armed() {
    for level in [0x0000, 0xffff] {
        let mut board = Board::new(TurnReference::Near(0.0));
        board.chip.borrow_mut().level = Some(level);
        for _ in 0..20 {
            let safety = board.sample(&still(0.0)).safety;
            assert_eq!(safety.reason, SafetyReason::Encoder);
        }
        assert_eq!(board.refusal(), SafetyReason::Encoder);
    }
}

#[test]
fn a_lost_turn_is_found_again_at_rest_only() {
    let mut board = Board::armed(TurnReference::Near(0.0));
    board.chip.borrow_mut().angle = 1500;
    board.sample(&still(0.0));
    assert_eq!(board.encoder.last_error(), Some(EncoderError::Jump));
    board.chip.borrow_mut().angle = 0;
    while board.session.torque_enabled() {
        board.sample(&still(0.0));
        assert_eq!(board.encoder.last_error(), Some(EncoderError::NoReference));
    }
    board.sample(&still(0.0));
    assert_eq!(board.encoder.last_error(), None);
    assert_eq!(board.ask(HostMessage::ClearFault), BoardMessage::Ack);
    for _ in 0..5 {
        board.sample(&still(0.0));
    }
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
}

#[test]
fn behind_a_gear_the_host_says_in_which_turn_the_encoder_stands() {
    let mut board = Board::new(TurnReference::FromSample);
    let mut silent = still(0.0);
    silent.measured = None;
    for _ in 0..5 {
        let safety = board.sample(&silent).safety;
        assert_eq!(safety.reason, SafetyReason::Encoder);
    }
    assert_eq!(board.encoder.last_error(), Some(EncoderError::NoReference));
    for _ in 0..5 {
        board.sample(&still(0.1));
    }
    assert_eq!(board.encoder.last_error(), None);
    assert_eq!(board.ask(HostMessage::Arm), BoardMessage::Ack);
}

#[test]
fn the_timers_tick_reads_the_encoder_too() {
    let mut board = Board::armed(TurnReference::Near(0.0));
    let configuration = Configuration {
        pacing: Pacing::SysTick,
        ..Configuration::default()
    };
    let mut description = BoardDescription::plain(NoClock);
    description.capabilities = description.capabilities | Capabilities::TIMER;
    board.session = Session::new(description).unwrap();
    board.sequence = 0;
    assert_eq!(
        board.ask(HostMessage::Configure(configuration)),
        BoardMessage::Ack
    );
    let before = board.chip.borrow().frames;
    let mut out = FrameBuffer::new();
    for _ in 0..10 {
        board
            .session
            .timer_tick(&mut board.mailboxes, &mut out, &mut board.encoder);
        out.clear();
    }
    assert_eq!(board.chip.borrow().frames, before + 20);
}
