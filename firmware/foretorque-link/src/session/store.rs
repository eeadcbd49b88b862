//! Orders to the housekeeping, and their replies.

use super::mailbox::{Order, ParameterMailbox};
use super::{Clock, Housekeeping, Mailboxes, Session};
use crate::wire::{BoardMessage, FrameBuffer, NackReason};
use embedded_storage::nor_flash::NorFlash;
use foretorque::arm::Arm;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Starts with the newest set that the store has for this arm; without one the bank of the firmware stays.
    ///
    /// To be called at boot, before the first tick. Errors: the reason for that; the board runs in any case.
    pub fn boot_from<F: NorFlash>(
        &mut self,
        housekeeping: &mut Housekeeping<A, N, P, F>,
        mailboxes: &mut Mailboxes<N, P>,
    ) -> Result<(), NackReason> {
        mailboxes.parameters.post(0, Order::Restore)?;
        housekeeping.work(&mut mailboxes.parameters);
        self.collect(mailboxes)
            .map_or(Ok(()), |(_, reply)| reply.map(|_: BoardMessage<N>| ()))
    }

    /// Posts an order that needs parameters at rest; [`poll_parameters`](Self::poll_parameters) replies.
    pub(super) fn order(
        &mut self,
        sequence: u16,
        order: Order,
        mailbox: &mut ParameterMailbox<N, P>,
    ) -> Result<Option<BoardMessage<N>>, NackReason> {
        self.controller.writable()?;
        mailbox.post(sequence, order)?;
        Ok(None)
    }

    /// Replies to an order that is done. To be called when the housekeeping has returned one.
    #[inline(never)]
    pub fn poll_parameters(&mut self, mailboxes: &mut Mailboxes<N, P>, out: &mut FrameBuffer) {
        if let Some((requester, reply)) = self.collect(mailboxes) {
            let reply = reply.unwrap_or_else(BoardMessage::Nack);
            self.protocol.reply(requester, &reply, out);
        }
    }

    /// Takes over the result of an order: its requester and the reply.
    #[inline(never)]
    fn collect(
        &mut self,
        mailboxes: &mut Mailboxes<N, P>,
    ) -> Option<(u16, Result<BoardMessage<N>, NackReason>)> {
        let Mailboxes {
            learner,
            parameters: mailbox,
        } = mailboxes;
        let (order, requester, outcome) = mailbox.collect()?;
        let stored = match (order, outcome) {
            (Order::Save | Order::Restore | Order::ReadStored, Err(NackReason::Store(error))) => {
                Some(Err(error))
            }
            (Order::Save | Order::Restore | Order::ReadStored, Ok(())) => Some(Ok(())),
            _ => None,
        };
        if let Some(stored) = stored {
            let wrote = matches!(order, Order::Save);
            let store = &mut self.protocol.link.counters.store;
            *store = store.after::<()>(wrote, &stored);
        }
        let controller = &mut self.controller;
        let done = outcome.and_then(|()| match order {
            Order::Read | Order::ReadStored => mailbox.transfer.chunk(0),
            Order::Save => Ok(BoardMessage::Ack),
            Order::Restore | Order::Commit(_) => controller
                .take_over(&mailbox.parameters, learner)
                .map(|()| BoardMessage::Ack),
            Order::Reset => {
                controller.reset(&mailbox.parameters, learner)?;
                self.protocol.reset();
                Ok(BoardMessage::Ack)
            }
            Order::Excitation(_) => {
                controller.load_excitation(mailbox.transfer.content())?;
                Ok(BoardMessage::Ack)
            }
        });
        Some((requester, done))
    }
}
