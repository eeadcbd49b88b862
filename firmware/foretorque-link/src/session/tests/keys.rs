//! Signatures of banks, excitations and orders on a board with a write key.

use super::store::storing;
use super::*;
use crate::excitation::{
    ExcitationCommand, ExcitationError, ExcitationProgram, ExcitationState, JointSeries,
    MotionBounds,
};
use crate::write_key::WriteKey;
use foretorque::feedforward::evaluate;

const REFUSED: BoardMessage<N> = nack(NackReason::Key);

fn key(byte: u8) -> WriteKey {
    WriteKey::from_slot([byte; 16]).unwrap()
}

/// A board with key 3.
fn locked(seed: u8) -> Board {
    Board::with(|board| (board.write_key, board.seed) = (Some(key(3)), Some([seed; MAC_BYTES])))
}

impl Board {
    fn challenge(&mut self) -> Mac {
        match self.request(HostMessage::Challenge) {
            BoardMessage::Challenge { nonce } => nonce,
            other => panic!("{other:?}"),
        }
    }

    /// Signature of an upload by a key, for a challenge of now.
    fn signed(&mut self, byte: u8, upload: &[u8]) -> Option<Mac> {
        let nonce = self.challenge();
        Some(key(byte).sign_upload(&nonce, Ur5::HASH, upload))
    }

    fn unlock(&mut self, byte: u8, order: [u8; 2]) -> BoardMessage<N> {
        let nonce = self.challenge();
        let mac = key(byte).sign_order(&nonce, Ur5::HASH, order);
        self.request(HostMessage::Unlock { order, mac })
    }
}

#[test]
fn a_board_with_a_key_reports_it_and_accepts_a_signed_bank_once() {
    let mut board = locked(1);
    let bank = uploaded();
    let capabilities = board.hello().capabilities;
    assert!(capabilities.contains(Capabilities::WRITE_KEY));
    let nonce = board.challenge();
    let mac = Some(key(3).sign_upload(&nonce, Ur5::HASH, &bank));
    assert_eq!(board.upload(&bank, mac), ACK);
    assert_eq!(board.read(), bank);
    // It cannot be replayed.
    assert_eq!(board.upload(&bank, mac), REFUSED);
    board.challenge();
    assert_eq!(board.upload(&bank, mac), REFUSED);
    // Nor to the same board after a restart.
    let mut restarted = locked(2);
    assert_ne!(restarted.challenge(), nonce);
    assert_eq!(restarted.upload(&bank, mac), REFUSED);
}

#[test]
fn a_missing_or_wrong_signature_leaves_the_old_bank() {
    let bank = uploaded();
    let mut board = locked(1);
    let before = board.read();
    assert_eq!(board.upload(&bank, None), REFUSED);
    let unasked = key(3).sign_upload(&[0; MAC_BYTES], Ur5::HASH, &bank);
    assert_eq!(board.upload(&bank, Some(unasked)), REFUSED);
    let foreign = board.signed(4, &bank);
    assert_eq!(board.upload(&bank, foreign), REFUSED);
    let mac = board.signed(3, &bank);
    let mut other = bank.clone();
    other[50] ^= 1;
    assert_eq!(board.upload(&other, mac), REFUSED);
    assert_eq!(board.read(), before);
}

#[test]
fn without_a_key_no_signature_is_needed_and_without_randomness_there_is_no_challenge() {
    let mut open = Board::new();
    assert_eq!(open.upload(&uploaded(), None), ACK);
    let mut known = Board::with(|board| (board.write_key, board.seed) = (Some(key(3)), None));
    for board in [&mut open, &mut known] {
        let refused = nack(NackReason::NotCapable);
        assert_eq!(board.request(HostMessage::Challenge), refused);
    }
}

/// An excitation in which no joint moves.
pub(super) fn excitation() -> Vec<u8> {
    let bounds = MotionBounds {
        position_rad: (-0.5, 0.5),
        velocity_rad_s: 1.0,
        acceleration_rad_s2: 5.0,
    };
    let program = ExcitationProgram::<N> {
        arm_hash: Ur5::HASH,
        period_us: 4_000_000,
        periods: 1,
        tracking_rad: 0.05,
        joints: [JointSeries::default(); N],
        certificate: [bounds; N],
    };
    program.encode(&mut [0; 1024]).unwrap().to_vec()
}

#[test]
fn an_excitation_needs_a_signature_of_its_own() {
    let program = excitation();
    let mut board = locked(1);
    assert_eq!(board.upload_excitation(&program, None), REFUSED);
    let foreign = board.signed(4, &program);
    assert_eq!(board.upload_excitation(&program, foreign), REFUSED);
    let status = board.request(HostMessage::Excitation(ExcitationCommand::Status));
    assert_eq!(status, BoardMessage::Excitation(ExcitationState::Empty));
    let start = HostMessage::Excitation(ExcitationCommand::Start);
    let missing = nack(NackReason::Excitation(ExcitationError::NotLoaded));
    assert_eq!(board.request(start), missing);
    let mac = board.signed(3, &program);
    assert_eq!(board.upload_excitation(&program, mac), ACK);
    assert_eq!(board.upload_excitation(&program, mac), REFUSED);
    // The signature of an excitation does not serve a bank.
    let mac = board.signed(3, &program);
    let reply = board.upload(&program, mac);
    assert!(matches!(reply, BoardMessage::Nack(NackReason::Bank(_))));
}

fn protected() -> [HostMessage<N>; 6] {
    [
        HostMessage::Learning { on: true },
        HostMessage::Reset,
        HostMessage::Request { code: 1 },
        HostMessage::Request { code: 3 },
        HostMessage::Save,
        HostMessage::Restore,
    ]
}

#[test]
fn m4_on_a_keyed_board_an_unsigned_order_is_refused_and_changes_nothing() {
    let mut board = locked(1);
    let before = *board.session.feed_forward().state();
    for message in protected() {
        assert_eq!(board.request(message), REFUSED);
    }
    assert_eq!(*board.session.feed_forward().state(), before);
    // All that ends torque or learning stays free.
    for message in [
        HostMessage::Learning { on: false },
        HostMessage::Disarm,
        HostMessage::Stop,
        HostMessage::ClearFault,
    ] {
        board.acknowledged(message);
    }
}

/// A save makes nothing that was learnt the centre of the learner's bounds.
#[test]
fn m4_the_bounds_of_learning_stay_around_the_signed_bank() {
    for (keyed, configured) in [(true, false), (true, true), (false, false), (false, true)] {
        let mut board = storing(keyed.then(|| key(3)));
        let bank = uploaded();
        let permit = |board: &mut Board, message: HostMessage<N>| {
            if keyed {
                let order = message.protected().unwrap();
                assert_eq!(board.unlock(3, order), ACK);
            }
            assert_eq!(board.request(message), ACK);
        };
        let mac = keyed.then(|| board.signed(3, &bank)).flatten();
        assert_eq!(board.upload(&bank, mac), ACK);
        permit(&mut board, HostMessage::Learning { on: true });
        // Six N·m more than the bank on every joint.
        let set = board.session.feed_forward().state().active;
        for k in 0..6000 {
            let mut sample = sample(k);
            let torque = evaluate::<Ur5, N, P>(&set, &sample.desired).total;
            sample.measured.as_mut().unwrap().tau = torque.map(|torque| torque + 6.0);
            board.send(&HostMessage::Sample(SampleFrame::new(&sample)));
            board.learn();
        }
        permit(&mut board, HostMessage::Request { code: 3 });
        for k in 6000..6100 {
            board.sample(k);
            board.learn();
        }
        board.acknowledged(HostMessage::Learning { on: false });
        let learnt = board.read_from(BankSource::Committed);
        assert_ne!(learnt, bank);
        let active = board.read();
        let kept = match (keyed, configured) {
            (true, _) => &bank,
            (false, true) => &active,
            (false, false) => &learnt,
        };
        let columns = |bytes: &[u8]| {
            let mut bank = ParameterBank::empty();
            bank.decode_into(bytes).unwrap();
            bank.columns
        };
        if configured {
            board.acknowledged(configure(|_| ()));
            let committed = board.read_from(BankSource::Committed);
            assert_eq!(columns(&committed), columns(kept));
        }
        permit(&mut board, HostMessage::Save);
        permit(&mut board, HostMessage::Restore);
        let restored = board.read();
        assert_eq!(columns(&restored), columns(kept), "keyed {keyed}");
    }
}

#[test]
fn a_permission_serves_one_order_once() {
    let mut board = locked(1);
    for message in protected() {
        let order = message.protected().unwrap();
        assert_eq!(board.unlock(4, order), REFUSED, "a foreign key");
        assert_eq!(board.request(message.clone()), REFUSED, "no permission");
        assert_eq!(board.unlock(3, order), ACK);
        assert_ne!(board.request(message.clone()), REFUSED);
        assert_eq!(board.request(message.clone()), REFUSED, "used up");
        assert_eq!(board.unlock(3, [order[0], order[1] ^ 2]), ACK);
        assert_eq!(board.request(message.clone()), REFUSED, "another order");
        assert_eq!(board.unlock(3, order), ACK);
        let (order, mac) = (order, [0; MAC_BYTES]);
        assert_eq!(board.request(HostMessage::Unlock { order, mac }), REFUSED);
        assert_eq!(board.request(message), REFUSED, "no challenge");
        board.acknowledged(HostMessage::Learning { on: false });
    }
}

#[test]
fn a_permission_cannot_be_replayed_and_an_upload_serves_no_order() {
    let mut board = locked(1);
    let nonce = board.challenge();
    let order = [9, 0];
    let mac = key(3).sign_order(&nonce, Ur5::HASH, order);
    board.acknowledged(HostMessage::Unlock { order, mac });
    assert_eq!(board.request(HostMessage::Unlock { order, mac }), REFUSED);
    let nonce = board.challenge();
    let mac = key(3).sign_upload(&nonce, Ur5::HASH, &order);
    assert_eq!(board.request(HostMessage::Unlock { order, mac }), REFUSED);
}
