//! The stored set and the session.

use super::{Clock, LearnerMailbox, Mailboxes, Session};
use crate::bank::ParameterBank;
use crate::store::{Store, StoreError, StoreMailbox, StoreOrder};
use crate::wire::{BoardMessage, Capabilities, FrameBuffer, NackReason};
use embedded_storage::nor_flash::NorFlash;
use foretorque::arm::Arm;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Starts with the newest set that the store has for this arm; without one the bank of the firmware stays.
    ///
    /// To be called at boot, before the first tick. Errors: the reason for that; the board runs in any case.
    #[inline(never)]
    pub fn boot_from<F: NorFlash>(
        &mut self,
        store: &mut Store<F>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), StoreError> {
        let mut buffer = [0; ParameterBank::MAX_BYTES];
        let loaded = store.load(A::hash(), &mut buffer).and_then(|bytes| {
            // A session that has just booted refuses a set only for its content.
            self.load_bank(bytes, mailbox)
                .map_err(|reason| match reason {
                    NackReason::Bank(error) => StoreError::Bank(error),
                    _ => StoreError::Damaged,
                })
        });
        self.store = self.store.after(StoreOrder::Restore, &loaded);
        loaded
    }

    /// Brings the bank in `bytes` into force, all of it or nothing.
    #[inline(never)]
    fn load_bank(
        &mut self,
        bytes: &[u8],
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        let incoming = self.controller.incoming();
        incoming.decode_into(bytes).map_err(NackReason::Bank)?;
        self.controller.writable()?;
        self.controller.take_over(mailbox)
    }

    /// Orders the active set to be stored; [`poll_store`](Self::poll_store) replies.
    #[inline(never)]
    pub(super) fn save_to_store(
        &mut self,
        sequence: u16,
        store: &mut StoreMailbox,
    ) -> Result<(), NackReason> {
        self.controller.writable()?;
        self.board.require(Capabilities::STORE)?;
        ordered(store.save(sequence, self.controller.active_bank()))
    }

    /// Orders the stored set, to bring it into force or to read it only; [`poll_store`](Self::poll_store) replies.
    pub(super) fn restore_from_store(
        &mut self,
        sequence: u16,
        read_only: bool,
        store: &mut StoreMailbox,
    ) -> Result<(), NackReason> {
        self.controller.writable()?;
        self.board.require(Capabilities::STORE)?;
        ordered(store.restore(sequence))?;
        self.read_only = read_only;
        Ok(())
    }

    /// Replies to a save or restore that is done. To be called when the housekeeping has returned an order.
    #[inline(never)]
    pub fn poll_store(&mut self, mailboxes: &mut Mailboxes<N, P>, out: &mut FrameBuffer) {
        let Some(done) = mailboxes.store.collect() else {
            return;
        };
        self.store = self.store.after(done.order, &done.outcome);
        let reply: Result<BoardMessage<N>, _> = match (done.order, done.outcome) {
            (_, Err(error)) => Err(NackReason::Store(error)),
            (StoreOrder::Save, Ok(_)) => Ok(BoardMessage::Ack),
            (StoreOrder::Restore, Ok(bytes)) if self.read_only => {
                self.protocol.transfer.hold(bytes);
                self.protocol.transfer.chunk(0)
            }
            // No torque can flow since the order was taken, but learning may have been switched on.
            (StoreOrder::Restore, Ok(bytes)) => self
                .load_bank(bytes, &mut mailboxes.learner)
                .map(|()| BoardMessage::Ack),
        };
        let reply = reply.unwrap_or_else(BoardMessage::Nack);
        self.protocol.reply(done.requester, &reply, out);
    }
}

fn ordered(taken: bool) -> Result<(), NackReason> {
    if taken { Ok(()) } else { Err(NackReason::Busy) }
}
