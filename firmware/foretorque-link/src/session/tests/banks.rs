use super::*;
use crate::bank::BankError;

#[test]
fn an_upload_takes_effect_whole_for_tick_fallback_and_learner() {
    let mut board = Board::new();
    let bank = uploaded();
    board.write(&bank);
    let before = board.session.feed_forward().state().active;
    assert_eq!(board.commit(&bank), BoardMessage::Ack);
    let state = *board.session.feed_forward().state();
    assert_ne!(state.active, before);
    assert_eq!(state.committed, state.active);
    board.ask(sample_message(0));
    board.learn();
    assert_eq!(board.learner.state().active, state.active);
    assert_eq!(*board.session.controller.gains(), [10.0; N]);
    assert_eq!(board.read(), bank);
}

#[test]
fn an_upload_that_breaks_off_changes_nothing_and_can_begin_anew() {
    let mut board = Board::new();
    let (before, bank) = (board.read(), uploaded());
    board.write(&bank[..3 * CHUNK]);
    assert_eq!(
        board.commit(&bank),
        BoardMessage::Nack(NackReason::Checksum)
    );
    assert_eq!(board.read(), before);
    board.write(&bank[..5 * CHUNK]);
    board.write(&bank);
    assert_eq!(board.commit(&bank), BoardMessage::Ack);
    assert_eq!(board.read(), bank);
}

#[test]
fn a_missing_piece_is_named_and_a_repeated_one_harmless() {
    let mut board = Board::new();
    let bank = uploaded();
    board.write(&bank[..2 * CHUNK]);
    let piece = |place: usize| HostMessage::BankWrite {
        offset: (place * CHUNK) as u16,
        bytes: bank[place * CHUNK..][..CHUNK].iter().copied().collect(),
    };
    let gap = NackReason::Gap { expected: 128 };
    assert_eq!(board.ask(piece(3)), BoardMessage::Nack(gap));
    assert_eq!(board.ask(piece(1)), BoardMessage::Ack);
    assert_eq!(board.ask(piece(2)), BoardMessage::Ack);
}

#[test]
fn a_damaged_or_endless_bank_is_refused() {
    let mut board = Board::new();
    let before = board.read();
    let mut bank = uploaded();
    bank[40] ^= 1;
    board.write(&bank);
    let refused = BoardMessage::Nack(NackReason::Bank(BankError::Checksum));
    assert_eq!(board.commit(&bank), refused);
    let full = [1; ParameterBank::MAX_BYTES / CHUNK * CHUNK];
    board.write(&full);
    let bytes: Chunk = [1; CHUNK].into_iter().collect();
    let beyond = HostMessage::BankWrite {
        offset: full.len() as u16,
        bytes,
    };
    assert_eq!(board.ask(beyond), BoardMessage::Nack(NackReason::TooLong));
    assert_eq!(board.read(), before);
}
