//! The set that the store kept, and the session.

use embedded_storage::nor_flash::NorFlash;

use super::{Clock, LearnerMailbox, Session};
use crate::bank::ParameterBank;
use crate::store::{Store, StoreError, StoreOrder, StoreState};
use crate::wire::{BoardMessage, Capabilities, FrameBuffer, NackReason};
use foretorque::arm::Arm;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Begins with the newest set that the store kept for this arm; where there is none, the bank of the firmware stays.
    ///
    /// Cannot fail: what is wrong is what is returned, and the board runs. To be called at boot, before the first tick.
    #[inline(never)]
    pub fn boot_from<F: NorFlash>(
        &mut self,
        store: &mut Store<F>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> StoreState {
        let mut room = [0; ParameterBank::MAX_BYTES];
        let loaded = store.load(A::HASH, &mut room);
        let state = match loaded.and_then(|bank| self.restore(bank, mailbox).map_err(refused)) {
            Ok(()) => StoreState::Loaded,
            Err(error) => StoreState::Failed(error),
        };
        self.store = state.health();
        state
    }

    /// Orders the set in force to be kept; [`poll_store`](Self::poll_store) answers.
    #[inline(never)]
    pub(super) fn save(
        &mut self,
        sequence: u16,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        self.writable()?;
        self.storing()?;
        self.bank
            .refresh::<A, N, P>(&self.feed_forward.state().active);
        ordered(mailbox.store.save(sequence, &self.bank))
    }

    /// Orders the stored set to be brought back, to be taken over or only to be read; [`poll_store`](Self::poll_store) answers.
    pub(super) fn fetch(
        &mut self,
        sequence: u16,
        to_be_read: bool,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        self.writable()?;
        self.storing()?;
        ordered(mailbox.store.restore(sequence))?;
        self.fetched_to_be_read = to_be_read;
        Ok(())
    }

    fn storing(&self) -> Result<(), NackReason> {
        if self.board.capabilities.contains(Capabilities::STORE) {
            Ok(())
        } else {
            Err(NackReason::NotCapable)
        }
    }

    /// Answers what the store was asked for, when it is done. To be called when the housekeeping has handed an order back.
    #[inline(never)]
    pub fn poll_store(&mut self, mailbox: &mut LearnerMailbox<N, P>, out: &mut FrameBuffer) {
        let Some(answer) = mailbox.store.collect() else {
            return;
        };
        let sequence = answer.requester;
        let state = match answer.outcome {
            Ok(_) => StoreState::Saved,
            Err(error) => StoreState::Failed(error),
        };
        self.store = self.store.after(answer.order, state);
        let done = match (answer.order, answer.outcome) {
            (_, Err(error)) => Err(NackReason::Store(error)),
            (StoreOrder::Save, Ok(_)) => Ok(()),
            (StoreOrder::Restore, Ok(bytes)) if self.fetched_to_be_read => {
                self.transfer.hold(bytes);
                return self.read_on(sequence, 0, out);
            }
            (StoreOrder::Restore, Ok(bytes)) => self
                .incoming
                .decode_into(bytes)
                .map_err(NackReason::Bank)
                // No torque can flow since the order was taken, but learning may have been switched on.
                .and_then(|()| self.writable())
                .and_then(|()| self.take_over(mailbox)),
        };
        let answer = match done {
            Ok(()) => BoardMessage::Ack,
            Err(reason) => BoardMessage::Nack(reason),
        };
        self.answer(sequence, &answer, out);
    }
}

fn ordered(taken: bool) -> Result<(), NackReason> {
    if taken { Ok(()) } else { Err(NackReason::Busy) }
}

/// A session that has just booted refuses a set for what is in it alone.
fn refused(reason: NackReason) -> StoreError {
    match reason {
        NackReason::Bank(error) => StoreError::Bank(error),
        _ => StoreError::Damaged,
    }
}
