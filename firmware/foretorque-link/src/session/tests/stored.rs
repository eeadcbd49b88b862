use super::*;
use crate::store::{Store, StoreError, StoreHealth};
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use std::cell::Cell;
use std::rc::Rc;

/// Flash that works, or is worn out and says "done" all the same; the simulated one of the campaigns is the host's.
struct Flash(Vec<u8>, Rc<Cell<bool>>);

#[derive(Debug)]
struct Never;

impl NorFlashError for Never {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl ErrorType for Flash {
    type Error = Never;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Never> {
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

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Never> {
        if !self.1.get() {
            self.0[from as usize..to as usize].fill(0xFF);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Never> {
        if !self.1.get() {
            self.0[offset as usize..][..bytes.len()].copy_from_slice(bytes);
        }
        Ok(())
    }
}

fn flash(worn: &Rc<Cell<bool>>) -> Flash {
    Flash(std::vec![0xFF; 2 * 16 * 1024], worn.clone())
}

fn storing() -> (Board, Store<Flash>) {
    let board = Board::described(BoardDescription {
        capabilities: Capabilities::LEARNING | Capabilities::STORE,
        ..BoardDescription::plain(NoClock)
    });
    (board, Store::new(flash(&Rc::default())))
}

impl Board {
    /// Says `message`, which has no answer before the housekeeping has been at the flash; then its answer.
    fn ask_store(&mut self, store: &mut Store<Flash>, message: &HostMessage<N>) -> BoardMessage<N> {
        self.sequence += 1;
        assert!(self.hear(&frame(self.sequence, message)).is_empty());
        let busy = BoardMessage::Nack(NackReason::Busy);
        let asked = self.sequence;
        assert_eq!(
            self.ask(HostMessage::Arm),
            busy,
            "no torque while the flash is written"
        );
        let mut job = self.mailboxes.store.begin().unwrap();
        let outcome = job.execute(store, Ur5::HASH);
        self.mailboxes.store.finish(&job, outcome);
        let mut out = FrameBuffer::new();
        self.session.poll_store(&mut self.mailboxes, &mut out);
        match heard(out.as_bytes()).as_slice() {
            [(sequence, answer)] => {
                assert_eq!(*sequence, asked);
                answer.clone()
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_set_is_saved_and_restored_on_request() {
    let (mut board, mut store) = storing();
    let bank = uploaded();
    board.write(&bank);
    assert_eq!(board.commit(&bank), BoardMessage::Ack);
    let saved = board.ask_store(&mut store, &HostMessage::Save);
    assert_eq!(saved, BoardMessage::Ack);
    assert_eq!(board.ask(HostMessage::Reset), BoardMessage::Ack);
    assert_ne!(board.read(), bank);
    let restored = board.ask_store(&mut store, &HostMessage::Restore);
    assert_eq!(restored, BoardMessage::Ack);
    assert_eq!(board.read(), bank);
}

#[test]
fn the_stored_set_can_be_read_and_stays_where_it_is() {
    let (mut board, mut store) = storing();
    let bank = uploaded();
    store.save(Ur5::HASH, &bank).unwrap();
    let before = board.read();
    let read = |offset| HostMessage::BankRead {
        source: BankSource::Stored,
        offset,
    };
    let mut stored = Vec::new();
    let mut answer = board.ask_store(&mut store, &read(0));
    loop {
        let BoardMessage::BankChunk { bytes, length, .. } = answer else {
            panic!("{answer:?}");
        };
        stored.extend(bytes);
        if stored.len() == usize::from(length) {
            break;
        }
        answer = board.ask(read(stored.len() as u16));
    }
    assert_eq!(stored, bank);
    assert_eq!(board.read(), before);
}

#[test]
fn an_empty_store_or_none_says_so_and_changes_nothing() {
    let (mut board, mut store) = storing();
    let before = board.read();
    let empty = BoardMessage::Nack(NackReason::Store(StoreError::Empty));
    assert_eq!(board.ask_store(&mut store, &HostMessage::Restore), empty);
    assert_eq!(board.read(), before);
    let mut without = Board::new();
    let refused = BoardMessage::Nack(NackReason::NotCapable);
    assert_eq!(without.ask(HostMessage::Save), refused);
    assert_eq!(without.ask(HostMessage::Restore), refused);
}

#[test]
fn a_flash_that_keeps_nothing_is_told_until_it_keeps_something() {
    let (mut board, _) = storing();
    let worn = Rc::default();
    let mut store = Store::new(flash(&worn));
    let told = |board: &mut Board| match board.ask(HostMessage::Statistics) {
        BoardMessage::Statistics(statistics) => statistics.store,
        other => panic!("{other:?}"),
    };
    assert_eq!(told(&mut board), StoreHealth::Unused);
    board
        .session
        .boot_from(&mut store, &mut board.mailboxes.learner);
    assert_eq!(told(&mut board), StoreHealth::Empty);
    let saved = board.ask_store(&mut store, &HostMessage::Save);
    assert_eq!(saved, BoardMessage::Ack);
    assert_eq!(told(&mut board), StoreHealth::Sound);
    worn.set(true);
    let refused = board.ask_store(&mut store, &HostMessage::Save);
    let not_kept = NackReason::Store(StoreError::NotKept);
    assert_eq!(refused, BoardMessage::Nack(not_kept));
    assert_eq!(told(&mut board), StoreHealth::Failing);
    // What was kept before can still be read, and the board runs; that mends nothing.
    let restored = board.ask_store(&mut store, &HostMessage::Restore);
    assert_eq!(restored, BoardMessage::Ack);
    assert_eq!(told(&mut board), StoreHealth::Failing);
    board.arm();
    assert_eq!(board.ask(HostMessage::Stop), BoardMessage::Ack);
    worn.set(false);
    let saved = board.ask_store(&mut store, &HostMessage::Save);
    assert_eq!(saved, BoardMessage::Ack);
    assert_eq!(told(&mut board), StoreHealth::Sound);
}

#[test]
fn nothing_is_saved_while_torque_flows() {
    let (mut board, _) = storing();
    board.arm();
    let refused = BoardMessage::Nack(NackReason::Armed);
    assert_eq!(board.ask(HostMessage::Save), refused);
    assert_eq!(board.ask(HostMessage::Restore), refused);
}
