use super::*;
use crate::bank::BankError;

#[test]
fn an_upload_is_in_force_for_tick_fallback_and_learner() {
    let mut board = Board::new();
    let bank = uploaded();
    board.write(&bank);
    let before = board.session.feed_forward().state().active;
    assert_eq!(board.commit(&bank), ACK);
    let state = *board.session.feed_forward().state();
    assert_ne!(state.active, before);
    assert_eq!(state.committed, state.active);
    board.sample(0);
    board.learn();
    assert_eq!(board.learner.state().active, state.active);
    assert_eq!(board.session.controller.gains, [10.0; N]);
    assert_eq!(board.read(), bank);
}

#[test]
fn an_interrupted_upload_changes_nothing_and_can_begin_anew() {
    let mut board = Board::new();
    let (before, bank) = (board.read(), uploaded());
    board.write(&bank[..3 * CHUNK]);
    assert_eq!(board.commit(&bank), nack(NackReason::Checksum));
    assert_eq!(board.read(), before);
    board.write(&bank[..5 * CHUNK]);
    board.write(&bank);
    assert_eq!(board.commit(&bank), ACK);
    assert_eq!(board.read(), bank);
}

#[test]
fn a_missing_chunk_is_named_and_a_repeated_one_harmless() {
    let mut board = Board::new();
    let bank = uploaded();
    board.write(&bank[..2 * CHUNK]);
    let gap = NackReason::Gap { expected: 128 };
    for (place, reply) in [(3, nack(gap)), (1, ACK), (2, ACK)] {
        assert_eq!(board.request(write(&bank, place)), reply);
    }
}

#[test]
fn a_damaged_or_endless_bank_is_refused() {
    let mut board = Board::new();
    let before = board.read();
    let mut bank = uploaded();
    bank[40] ^= 1;
    board.write(&bank);
    let refused = nack(NackReason::Bank(BankError::Checksum));
    assert_eq!(board.commit(&bank), refused);
    // A sound bank, but not the one that was announced: other length, other checksum.
    let announced = |length: usize, crc| HostMessage::BankCommit {
        length: length as u16,
        crc,
        mac: None,
    };
    let (whole, crc) = (uploaded(), CRC.checksum(&uploaded()));
    for (length, crc) in [(whole.len() - 1, crc), (whole.len(), crc ^ 1)] {
        board.write(&whole);
        let reply = board.request(announced(length, crc));
        assert_eq!(reply, nack(NackReason::Checksum));
    }
    let full = ParameterBank::MAX_BYTES / CHUNK;
    let endless = [1; ParameterBank::MAX_BYTES + CHUNK];
    board.write(&endless[..full * CHUNK]);
    let beyond = board.request(write(&endless, full));
    assert_eq!(beyond, nack(NackReason::TooLong));
    assert_eq!(board.read(), before);
    // What was read is no upload.
    assert_eq!(board.commit(&before), nack(NackReason::Checksum));
}

#[test]
fn the_deviations_of_a_bank_reach_the_learner() {
    let start = |factor: f32| {
        let mut bank = ParameterBank::nominal::<Ur5, N, P>();
        let columns = bank.columns.iter_mut();
        columns.for_each(|column| column.deviation *= factor);
        let mut buffer = [0; ParameterBank::MAX_BYTES];
        let bytes = bank.encode(&mut buffer).unwrap();
        let mut board = Board::new();
        board.write(bytes);
        assert_eq!(board.commit(bytes), ACK);
        board.sample(0);
        board.learn();
        board.learner.state().estimate.filter().diagonal().friction[2][1]
    };
    assert_eq!(start(1.0), 1.0);
    assert!((start(0.1) - 0.01).abs() < 5e-4);
    assert!((start(1e-6) - 0.0025).abs() < 1e-4);
}
