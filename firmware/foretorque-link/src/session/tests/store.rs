use super::*;
use crate::store::{Store, StoreError};
use core::convert::Infallible;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use std::cell::Cell;
use std::rc::Rc;

/// Flash that works, or is worn out without reporting it; the host has the simulated one of the campaigns.
struct Flash(Vec<u8>, Rc<Cell<bool>>);

impl ErrorType for Flash {
    type Error = Infallible;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 16 * 1024;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        if !self.1.get() {
            self.0[from as usize..to as usize].fill(0xFF);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        if !self.1.get() {
            self.0[offset as usize..][..bytes.len()].copy_from_slice(bytes);
        }
        Ok(())
    }
}

/// A board with a store, whose flash is worn out while the cell is true.
fn storing() -> (Board, Store<Flash>, Rc<Cell<bool>>) {
    let board = Board::described(BoardDescription {
        capabilities: Capabilities::LEARNING | Capabilities::STORE,
        ..BoardDescription::plain(NoClock)
    });
    let worn = Rc::<Cell<bool>>::default();
    let flash = Flash(std::vec![0xFF; 2 * Flash::ERASE_SIZE], worn.clone());
    (board, Store::new(flash), worn)
}

impl Board {
    /// The reply to a message that waits for the housekeeping to access the flash.
    fn request_store(
        &mut self,
        store: &mut Store<Flash>,
        message: HostMessage<N>,
    ) -> BoardMessage<N> {
        assert!(self.send(&message).is_empty());
        let requester = self.sequence;
        // No torque while the flash is written.
        assert_eq!(self.request(HostMessage::Arm), nack(NackReason::Busy));
        let mut job = self.mailboxes.store.begin().unwrap();
        let outcome = job.execute(store, Ur5::HASH);
        self.mailboxes.store.finish(&job, outcome);
        let replies = self.output(|session, mailboxes, out| session.poll_store(mailboxes, out));
        let [(sequence, reply)] = replies.as_slice() else {
            panic!("{replies:?}");
        };
        assert_eq!(*sequence, requester);
        reply.clone()
    }
}

#[test]
fn a_set_is_saved_and_restored_on_request() {
    let (mut board, mut store, _) = storing();
    let bank = uploaded();
    board.write(&bank);
    assert_eq!(board.commit(&bank), ACK);
    assert_eq!(board.request_store(&mut store, HostMessage::Save), ACK);
    board.acknowledged(HostMessage::Reset);
    assert_ne!(board.read(), bank);
    assert_eq!(board.request_store(&mut store, HostMessage::Restore), ACK);
    assert_eq!(board.read(), bank);
}

#[test]
fn the_stored_set_can_be_read_and_is_not_in_force() {
    let (mut board, mut store, _) = storing();
    let bank = uploaded();
    store.save(Ur5::HASH, &bank).unwrap();
    let before = board.read();
    let stored = board.read_from(BankSource::Stored, |board, first| {
        board.request_store(&mut store, first)
    });
    assert_eq!(stored, bank);
    assert_eq!(board.read(), before);
}

#[test]
fn an_empty_or_missing_store_is_refused_and_changes_nothing() {
    let (mut board, mut store, _) = storing();
    let before = board.read();
    let empty = nack(NackReason::Store(StoreError::Empty));
    assert_eq!(board.request_store(&mut store, HostMessage::Restore), empty);
    assert_eq!(board.read(), before);
    let mut without = Board::new();
    for message in [HostMessage::Save, HostMessage::Restore] {
        assert_eq!(without.request(message), nack(NackReason::NotCapable));
    }
}

#[test]
fn a_worn_flash_is_reported_until_a_save_succeeds() {
    let (mut board, mut store, worn) = storing();
    assert_eq!(board.statistics().store, StoreHealth::Unused);
    let learner = &mut board.mailboxes.learner;
    let loaded = board.session.boot_from(&mut store, learner);
    assert_eq!(loaded, Err(StoreError::Empty));
    assert_eq!(board.statistics().store, StoreHealth::Empty);
    let not_kept = nack(NackReason::Store(StoreError::NotKept));
    for (is_worn, message, reply, health) in [
        (false, HostMessage::Save, ACK, StoreHealth::Sound),
        (true, HostMessage::Save, not_kept, StoreHealth::Failing),
        // The earlier set can still be read, and the board runs; the flash is still worn.
        (true, HostMessage::Restore, ACK, StoreHealth::Failing),
        (false, HostMessage::Save, ACK, StoreHealth::Sound),
    ] {
        worn.set(is_worn);
        assert_eq!(board.request_store(&mut store, message), reply);
        assert_eq!(board.statistics().store, health);
        if is_worn {
            board.arm();
            board.acknowledged(HostMessage::Stop);
            board.acknowledged(HostMessage::ClearFault);
        }
    }
}

#[test]
fn nothing_is_saved_while_torque_flows() {
    let (mut board, ..) = storing();
    board.arm();
    for message in [HostMessage::Save, HostMessage::Restore] {
        assert_eq!(board.request(message), nack(NackReason::Armed));
    }
}
