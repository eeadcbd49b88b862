//! Position of the joint: from the encoder, or none.

use super::*;

const NEAR: TurnReference = TurnReference::Near(0.0);

#[test]
fn the_position_of_the_encoder_replaces_that_of_the_sample() {
    // The host measures half a radian, where only the encoder allows arming, then zero, where it does not.
    let mut board = Board::new(NEAR);
    (0..5).for_each(|_| _ = board.sample(&still(0.5)));
    assert_eq!(board.request(HostMessage::Arm), ACK);
    let mut board = Board::new(NEAR);
    board.chip.borrow_mut().angle = 1304;
    board.samples(5);
    board.assert_refused(SafetyReason::TooFar);
}

#[test]
fn a_failed_reading_drops_the_measurement_only() {
    let mut board = Board::armed(NEAR);
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
fn a_missing_encoder_ends_the_torque_and_latches() {
    for (level, error) in [
        (0x0000, EncoderError::NotReady),
        (0xffff, EncoderError::Refused(7)),
    ] {
        let mut board = Board::armed(NEAR);
        board.chip.borrow_mut().level = Some(level);
        let mut ticks = 0;
        while board.sample(&still(0.0)).safety.state == SafetyState::Armed {
            ticks += 1;
        }
        assert!((49..=52).contains(&ticks), "{ticks}");
        board.samples(20);
        assert!(!board.enabled());
        let safety = board.board.session.safety();
        let latched = (SafetyState::Fault, SafetyReason::Encoder);
        assert_eq!((safety.state, safety.reason), latched);
        let reported = (0..4).any(|_| {
            board.sample(&still(0.0));
            board.encoder.last_error() == Some(error)
        });
        assert!(reported, "{level:#x}");
    }
}

#[test]
fn a_board_without_its_encoder_is_not_armed() {
    for level in [0x0000, 0xffff] {
        let mut board = Board::new(NEAR);
        board.chip.borrow_mut().level = Some(level);
        for _ in 0..20 {
            let safety = board.sample(&still(0.0)).safety;
            assert_eq!(safety.reason, SafetyReason::Encoder);
        }
        board.assert_refused(SafetyReason::Encoder);
    }
}

#[test]
fn a_lost_turn_is_restored_at_rest_only() {
    let mut board = Board::armed(NEAR);
    board.chip.borrow_mut().angle = 1500;
    board.sample(&still(0.0));
    assert_eq!(board.encoder.last_error(), Some(EncoderError::Jump));
    board.chip.borrow_mut().angle = 0;
    while board.board.session.torque_enabled() {
        board.sample(&still(0.0));
        assert_eq!(board.encoder.last_error(), Some(EncoderError::NoReference));
    }
    board.sample(&still(0.0));
    assert_eq!(board.encoder.last_error(), None);
    assert_eq!(board.request(HostMessage::ClearFault), ACK);
    board.samples(5);
    assert_eq!(board.request(HostMessage::Arm), ACK);
}

#[test]
fn behind_a_gear_the_sample_gives_the_turn() {
    let mut board = Board::new(TurnReference::FromSample);
    let mut unmeasured = still(0.0);
    unmeasured.measured = None;
    for _ in 0..5 {
        let safety = board.sample(&unmeasured).safety;
        assert_eq!(safety.reason, SafetyReason::Encoder);
    }
    assert_eq!(board.encoder.last_error(), Some(EncoderError::NoReference));
    (0..5).for_each(|_| _ = board.sample(&still(0.1)));
    assert_eq!(board.encoder.last_error(), None);
    assert_eq!(board.request(HostMessage::Arm), ACK);
}

#[test]
fn a_tick_of_the_timer_reads_the_encoder_too() {
    let mut board = Board::new(NEAR);
    board.samples(5);
    board.board.pace(Pacing::SysTick);
    let before = board.chip.borrow().frames;
    (0..10).for_each(|_| board.timer());
    assert_eq!(board.chip.borrow().frames, before + 20);
}
