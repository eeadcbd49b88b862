//! Banks of a board: uploads and the store.

use super::*;
use crate::bank::BankError;
use crate::store::{Store, StoreError, StoreHealth};
use crate::write_key::WriteKey;
use foretorque_flash::{Protection, SimulatedFlash};

pub(super) type Flash = SimulatedFlash<{ 16 * 1024 }>;

pub(super) fn storing(write_key: Option<WriteKey>) -> Board {
    let mut board = Board::with(|board| {
        board.capabilities = Capabilities::LEARNING | Capabilities::STORE;
        board.write_key = write_key;
    });
    board.housekeeping.start(Some(Store::new(Flash::new(1))));
    board
}

#[test]
fn a_set_is_saved_read_and_restored_on_request() {
    let mut board = storing(None);
    let bank = uploaded();
    assert_eq!(board.upload(&bank, None), ACK);
    board.acknowledged(HostMessage::Save);
    board.acknowledged(HostMessage::Reset);
    assert_eq!(board.read_from(BankSource::Stored), bank);
    assert_ne!(board.read(), bank, "in force");
    board.acknowledged(HostMessage::Restore);
    assert_eq!(board.read(), bank);
}

#[test]
fn the_newest_set_stays_in_the_flash_until_the_next_one_is_kept() {
    let mut store = Store::new(Flash::new(1));
    for k in 1..=20 {
        assert_eq!(store.save(7, &[k; 100]), Ok(k.into()));
        let held = |set: [u8; 100]| store.flash().bytes().windows(100).any(|bytes| bytes == set);
        assert!(k == 1 || held([k - 1; 100]), "set {k}");
        assert_eq!(store.load(7, &mut [0; 100]), Ok(&[k; 100][..]));
    }
}

#[test]
fn a_damaged_set_gives_way_to_the_one_before() {
    let mut store = Store::new(Flash::new(1));
    store.save(7, &[1; 100]).unwrap();
    store.save(7, &[2; 100]).unwrap();
    let [first, second] = [1, 2].map(|k| {
        let mut places = store.flash().bytes().windows(100);
        places.position(|bytes| bytes == [k; 100]).unwrap()
    });
    for place in second..second + 100 {
        store.flash_mut().rot(place, 2);
        assert_eq!(store.load(7, &mut [0; 100]), Ok(&[1; 100][..]));
        store.flash_mut().rot(place, 2);
    }
    store.flash_mut().rot(second, 2);
    store.flash_mut().rot(first, 2);
    assert_eq!(store.load(7, &mut [0; 100]), Err(StoreError::Damaged));
}

#[test]
fn an_empty_or_missing_store_is_refused_and_changes_nothing() {
    let mut board = storing(None);
    let before = board.read();
    let empty = nack(NackReason::Store(StoreError::Empty));
    assert_eq!(board.request(HostMessage::Restore), empty);
    assert_eq!(board.read(), before);
    let mut without = Board::new();
    for message in [HostMessage::Save, HostMessage::Restore] {
        assert_eq!(without.request(message), nack(NackReason::NotCapable));
    }
}

#[test]
fn a_worn_flash_is_reported_until_a_save_succeeds() {
    let mut board = storing(None);
    assert_eq!(board.statistics().store, StoreHealth::Unused);
    let loaded = board
        .session
        .boot_from(&mut board.housekeeping, &mut board.mailboxes);
    assert_eq!(loaded, Err(NackReason::Store(StoreError::Empty)));
    assert_eq!(board.statistics().store, StoreHealth::Empty);
    let not_kept = nack(NackReason::Store(StoreError::NotKept));
    // A worn flash takes every order, and keeps nothing.
    use Protection::{None as Works, Silent as Worn};
    for (flash, message, reply, health) in [
        (Works, HostMessage::Save, ACK, StoreHealth::Sound),
        (Worn, HostMessage::Save, not_kept, StoreHealth::Failing),
        // The earlier set can still be read, and the board runs; the flash is still worn.
        (Worn, HostMessage::Restore, ACK, StoreHealth::Failing),
        (Works, HostMessage::Save, ACK, StoreHealth::Sound),
    ] {
        let store = board.housekeeping.store_mut().unwrap();
        store.flash_mut().protect(flash);
        assert_eq!(board.request(message), reply);
        assert_eq!(board.statistics().store, health);
        if flash == Worn {
            board.arm();
            board.acknowledged(HostMessage::Stop);
            board.acknowledged(HostMessage::ClearFault);
        }
    }
}

#[test]
fn m5_while_an_order_is_executed_nothing_disturbs_it_and_a_read_disturbs_nothing() {
    let mut board = storing(None);
    board.samples_to_arm();
    let started = |message: HostMessage<N>, board: &mut Board| {
        let frame = board.numbered(&message);
        let (out, sensor) = (&mut FrameBuffer::new(), &mut NoLocalSensor);
        board
            .session
            .receive(&frame, &mut board.mailboxes, out, sensor);
        assert!(board.housekeeping.begin(&mut board.mailboxes.parameters));
    };
    let finished = |board: &mut Board| {
        let outcome = board.housekeeping.execute();
        let parameters = &mut board.mailboxes.parameters;
        board.housekeeping.finish(parameters, outcome);
        board.output(|session, mailboxes, out, _| session.poll_parameters(mailboxes, out))
    };
    let busy = nack(NackReason::Busy);
    started(HostMessage::Save, &mut board);
    for message in [
        HostMessage::Arm,
        HostMessage::Learning { on: true },
        HostMessage::Configure(Configuration::default()),
        HostMessage::Reset,
        HostMessage::Reboot,
        HostMessage::Restore,
        write(&uploaded(), 0),
    ] {
        assert_eq!(board.request(message), busy);
    }
    board.acknowledged(HostMessage::Learning { on: false });
    assert_eq!(finished(&mut board), [(4, ACK)]);
    // An erase takes two seconds, in which no sample came.
    let refused = board.request(HostMessage::Arm);
    assert_eq!(refused, nack(NackReason::Unsafe(SafetyReason::NoSample)));
    board.samples_to_arm();
    let source = BankSource::Live;
    started(HostMessage::BankRead { source, offset: 0 }, &mut board);
    board.acknowledged(HostMessage::Arm);
    board.sample(0);
    assert!(matches!(
        finished(&mut board)[..],
        [(17, BoardMessage::BankChunk { offset: 0, .. })]
    ));
}

#[test]
fn m4_saves_are_a_minute_apart_and_restarts_do_not_shorten_it() {
    let board = |reset_reason| {
        let mut board = Board::with(|board| {
            board.capabilities = Capabilities::STORE | Capabilities::TIMER;
            board.reset_reason = reset_reason;
        });
        board.housekeeping.start(Some(Store::new(Flash::new(1))));
        board
    };
    let wait = |seconds| nack(NackReason::Wait { seconds });
    let mut powered = board(ResetReason::PowerOn);
    assert_eq!(powered.request(HostMessage::Save), ACK);
    assert_eq!(powered.request(HostMessage::Save), wait(60));
    (0..59_000).for_each(|_| _ = powered.timer());
    assert_eq!(powered.request(HostMessage::Save), wait(1));
    (0..1_000).for_each(|_| _ = powered.timer());
    assert_eq!(powered.request(HostMessage::Save), ACK);
    for reason in [ResetReason::Software, ResetReason::Watchdog] {
        assert_eq!(board(reason).request(HostMessage::Save), wait(60));
    }
}

#[test]
fn an_upload_is_in_force_for_tick_fallback_and_learner() {
    let mut board = Board::new();
    let bank = uploaded();
    let before = board.session.feed_forward().state().active;
    assert_eq!(board.upload(&bank, None), ACK);
    let state = *board.session.feed_forward().state();
    assert_ne!(state.active, before);
    assert_eq!(*state.committed(), state.active);
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
    assert_eq!(board.commit(&bank, None), nack(NackReason::Checksum));
    assert_eq!(board.read(), before);
    board.write(&bank[..5 * CHUNK]);
    assert_eq!(board.upload(&bank, None), ACK);
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
    let refused = nack(NackReason::Bank(BankError::Checksum));
    assert_eq!(board.upload(&bank, None), refused);
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
    assert_eq!(board.commit(&before, None), nack(NackReason::Checksum));
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
        assert_eq!(board.upload(bytes, None), ACK);
        board.sample(0);
        board.learn();
        board.learner.state().estimate.filter().diagonal().friction[2][1]
    };
    assert_eq!(start(1.0), 1.0);
    assert!((start(0.1) - 0.01).abs() < 5e-4);
    assert!((start(1e-6) - 0.0025).abs() < 1e-4);
}
