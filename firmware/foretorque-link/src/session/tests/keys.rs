use super::*;
use crate::excitation::{
    ExcitationCommand, ExcitationProgram, ExcitationState, JointSeries, MotionBounds,
};
use crate::wire::MAC_BYTES;
use crate::write_key::WriteKey;

fn key(byte: u8) -> WriteKey {
    WriteKey::from_slot([byte; 16]).unwrap()
}

fn locked(seed: u8) -> Board {
    Board::described(BoardDescription {
        write_key: Some(key(3)),
        seed: [seed; MAC_BYTES],
        ..BoardDescription::plain(NoClock)
    })
}

fn challenge(board: &mut Board) -> [u8; MAC_BYTES] {
    match board.ask(HostMessage::Challenge) {
        BoardMessage::Challenge { nonce } => nonce,
        other => panic!("{other:?}"),
    }
}

fn commit(board: &mut Board, bank: &[u8], mac: Option<[u8; MAC_BYTES]>) -> BoardMessage<N> {
    board.ask(HostMessage::BankCommit {
        length: bank.len() as u16,
        crc: CRC.checksum(bank),
        mac,
    })
}

#[test]
fn a_board_with_a_key_takes_a_signed_bank_and_says_that_it_has_a_key() {
    let mut board = locked(1);
    let bank = uploaded();
    let BoardMessage::Hello(hello) = board.ask(HostMessage::Hello) else {
        panic!("no hello");
    };
    assert!(hello.capabilities.contains(Capabilities::WRITE_KEY));
    let nonce = challenge(&mut board);
    board.write(&bank);
    let mac = key(3).sign_upload(&nonce, Ur5::HASH, &bank);
    assert_eq!(commit(&mut board, &bank, Some(mac)), BoardMessage::Ack);
    assert_eq!(board.read(), bank);
}

#[test]
fn without_the_right_signature_the_old_bank_stays_and_the_host_is_told() {
    let bank = uploaded();
    let refused = BoardMessage::Nack(NackReason::Key);
    let mut board = locked(1);
    let before = board.read();
    board.write(&bank);
    assert_eq!(commit(&mut board, &bank, None), refused);
    board.write(&bank);
    let unasked = key(3).sign_upload(&[0; MAC_BYTES], Ur5::HASH, &bank);
    assert_eq!(commit(&mut board, &bank, Some(unasked)), refused);
    let nonce = challenge(&mut board);
    board.write(&bank);
    let foreign = key(4).sign_upload(&nonce, Ur5::HASH, &bank);
    assert_eq!(commit(&mut board, &bank, Some(foreign)), refused);
    let nonce = challenge(&mut board);
    let mut other = bank.clone();
    other[50] ^= 1;
    board.write(&other);
    let mac = key(3).sign_upload(&nonce, Ur5::HASH, &bank);
    assert_eq!(commit(&mut board, &other, Some(mac)), refused);
    assert_eq!(board.read(), before);
}

#[test]
fn what_was_overheard_cannot_be_sent_again() {
    let bank = uploaded();
    let mut board = locked(1);
    let nonce = challenge(&mut board);
    let mac = key(3).sign_upload(&nonce, Ur5::HASH, &bank);
    board.write(&bank);
    assert_eq!(commit(&mut board, &bank, Some(mac)), BoardMessage::Ack);
    let refused = BoardMessage::Nack(NackReason::Key);
    board.write(&bank);
    assert_eq!(commit(&mut board, &bank, Some(mac)), refused);
    challenge(&mut board);
    board.write(&bank);
    assert_eq!(commit(&mut board, &bank, Some(mac)), refused);
    // Nor to the same board after it was started anew.
    let mut restarted = locked(2);
    assert_ne!(challenge(&mut restarted), nonce);
    restarted.write(&bank);
    assert_eq!(commit(&mut restarted, &bank, Some(mac)), refused);
}

#[test]
fn a_board_without_a_key_gives_no_challenge_and_needs_no_signature() {
    let mut board = Board::new();
    let refused = BoardMessage::Nack(NackReason::NotCapable);
    assert_eq!(board.ask(HostMessage::Challenge), refused);
    let bank = uploaded();
    board.write(&bank);
    assert_eq!(commit(&mut board, &bank, None), BoardMessage::Ack);
}

/// An excitation in which no joint moves.
fn excitation() -> Vec<u8> {
    let program = ExcitationProgram::<N> {
        arm_hash: Ur5::HASH,
        period_us: 4_000_000,
        periods: 1,
        tracking_rad: 0.05,
        joints: [JointSeries::ZERO; N],
        certificate: [MotionBounds {
            position_rad: (-0.5, 0.5),
            velocity_rad_s: 1.0,
            acceleration_rad_s2: 5.0,
        }; N],
    };
    program.encode(&mut [0; 1024]).unwrap().to_vec()
}

fn load(board: &mut Board, program: &[u8], mac: Option<[u8; MAC_BYTES]>) -> BoardMessage<N> {
    board.write(program);
    board.ask(HostMessage::ExcitationLoad {
        length: program.len() as u16,
        crc: CRC.checksum(program),
        mac,
    })
}

#[test]
fn an_excitation_needs_the_signature_that_a_bank_needs() {
    let program = excitation();
    let refused = BoardMessage::Nack(NackReason::Key);
    let mut board = locked(1);
    assert_eq!(load(&mut board, &program, None), refused);
    let nonce = challenge(&mut board);
    let foreign = key(4).sign_upload(&nonce, Ur5::HASH, &program);
    assert_eq!(load(&mut board, &program, Some(foreign)), refused);
    assert_eq!(
        board.ask(HostMessage::Excitation(ExcitationCommand::Status)),
        BoardMessage::Excitation(ExcitationState::Empty)
    );
    let nonce = challenge(&mut board);
    let mac = key(3).sign_upload(&nonce, Ur5::HASH, &program);
    assert_eq!(load(&mut board, &program, Some(mac)), BoardMessage::Ack);
    assert_eq!(load(&mut board, &program, Some(mac)), refused);
    // For a bank the signature of an excitation is worth nothing.
    let nonce = challenge(&mut board);
    let mac = key(3).sign_upload(&nonce, Ur5::HASH, &program);
    board.write(&program);
    let answer = commit(&mut board, &program, Some(mac));
    assert!(matches!(answer, BoardMessage::Nack(NackReason::Bank(_))));
}
