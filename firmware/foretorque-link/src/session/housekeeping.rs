//! Work on banks outside the tick, encoding, decoding, checks, signatures and storage; orders to it, and their replies.

use super::mailbox::{Order, ParameterMailbox, Upload};
use super::{Clock, Mailboxes, Session};
use crate::bank::{ParameterBank, Parameters, slots};
use crate::copy;
use crate::store::{Store, StoreError};
use crate::wire::{BoardMessage, CRC, FrameBuffer, NackReason};
use core::marker::PhantomData;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use foretorque::arm::Arm;
use foretorque::learning::{LearnerConfig, LinearParameters};

/// Bank in force, and buffers for the next one. Its orders come from a [`ParameterMailbox`].
///
/// Blocking, and stalling on a single flash bank while it erases: for the lowest priority.
pub struct Housekeeping<A, const N: usize, const P: usize, F = NoFlash> {
    store: Option<Store<F>>,
    /// Parameters of the last bank that came into force, or was ordered to.
    in_force: Parameters<N, P>,
    /// Standard deviations of its columns: they are kept for the host.
    deviations: LinearParameters<N, P>,
    bank: ParameterBank,
    bytes: [u8; ParameterBank::MAX_BYTES],
    length: usize,
    order: Order,
    arm: PhantomData<A>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize, F: NorFlash> Housekeeping<A, N, P, F> {
    /// The bank of the firmware is in force.
    pub fn new(store: Option<Store<F>>) -> Self {
        let mut housekeeping = Self::empty();
        housekeeping.start(store);
        housekeeping
    }

    /// Memory of a housekeeping that has not [started](Self::start).
    pub const fn empty() -> Self {
        Self {
            store: None,
            in_force: Parameters::zero(),
            deviations: LinearParameters::filled(0.0),
            bank: ParameterBank::empty(),
            bytes: [0; ParameterBank::MAX_BYTES],
            length: 0,
            order: Order::Read,
            arm: PhantomData,
        }
    }

    /// Brings the bank of the firmware into force and takes the store, if the board has one.
    pub fn start(&mut self, store: Option<Store<F>>) {
        self.store = store;
        self.take_nominal();
    }

    /// The store.
    pub fn store_mut(&mut self) -> Option<&mut Store<F>> {
        self.store.as_mut()
    }

    /// Takes the order that waits, with all it needs. False where none waits. Copies only: for a lock.
    pub fn begin(&mut self, mailbox: &mut ParameterMailbox<N, P>) -> bool {
        let Some((order, content, set)) = mailbox.begin() else {
            return false;
        };
        self.order = order;
        match order {
            Order::Read | Order::Save => self.in_force.set = *set,
            _ => self.hold(content),
        }
        true
    }

    /// Returns an order with its result. Copies only: for a lock.
    pub fn finish(
        &mut self,
        mailbox: &mut ParameterMailbox<N, P>,
        outcome: Result<(), NackReason>,
    ) {
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        mailbox.finish(bytes, &self.in_force, outcome);
    }

    /// Executes the order that [`begin`](Self::begin) took.
    ///
    /// Errors: the reason of the refusal; the bank in force is the one before.
    #[inline(never)]
    pub fn execute(&mut self) -> Result<(), NackReason> {
        match self.order {
            Order::Read => self.encode(),
            Order::Save => {
                self.encode()?;
                let store = self.store.as_mut().ok_or(NackReason::NotCapable)?;
                let bytes = self.bytes.get(..self.length).unwrap_or_default();
                store.save(A::hash(), bytes).map_err(NackReason::Store)?;
                Ok(())
            }
            Order::ReadStored => self.load(),
            Order::Restore => {
                self.load()?;
                self.decode().map_err(|reason| match reason {
                    NackReason::Bank(error) => NackReason::Store(StoreError::Bank(error)),
                    other => other,
                })
            }
            Order::Reset => {
                self.take_nominal();
                Ok(())
            }
            Order::Commit(upload) => {
                self.verify(&upload)?;
                self.decode()
            }
            Order::Excitation(upload) => self.verify(&upload),
        }
    }

    /// The order works on the store: an erase stalls every task for seconds, and a search reads all of it.
    pub fn takes_long(&self) -> bool {
        matches!(self.order, Order::Save | Order::Restore | Order::ReadStored)
    }

    /// Executes the order that waits, where tick and housekeeping take turns. False where none waits.
    pub fn work(&mut self, mailbox: &mut ParameterMailbox<N, P>) -> bool {
        let waited = self.begin(mailbox);
        if waited {
            let outcome = self.execute();
            self.finish(mailbox, outcome);
        }
        waited
    }

    fn hold(&mut self, content: &[u8]) {
        self.length = self.bytes.len().min(content.len());
        copy(&mut self.bytes, content);
    }

    /// Checks checksum and signature of the upload in `bytes`.
    fn verify(&self, upload: &Upload) -> Result<(), NackReason> {
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        if CRC.checksum(bytes) != upload.crc {
            return Err(NackReason::Checksum);
        }
        match &upload.signature {
            Some(it) if !it.key.verifies(&it.mac, &it.nonce, A::hash(), bytes) => {
                Err(NackReason::Key)
            }
            _ => Ok(()),
        }
    }

    fn load(&mut self) -> Result<(), NackReason> {
        let store = self.store.as_mut().ok_or(NackReason::NotCapable)?;
        let loaded = store.load(A::hash(), &mut self.bytes);
        self.length = loaded.map_err(NackReason::Store)?.len();
        Ok(())
    }

    /// Writes the bank in force into `bytes`.
    fn encode(&mut self) -> Result<(), NackReason> {
        let Self { bank, in_force, .. } = self;
        bank.describe::<A, N, P>();
        bank.refresh::<A, N, P>(&in_force.set);
        bank.drive_gains_nm_a.clear();
        bank.limits.clear();
        // The capacities suffice for every joint.
        let _ = bank.drive_gains_nm_a.extend_from_slice(&in_force.gains);
        let _ = bank.limits.extend_from_slice(&in_force.bounds);
        let deviations = slots::<A, N, P>(&self.deviations);
        for (column, &deviation) in bank.columns.iter_mut().zip(deviations) {
            column.deviation = deviation;
        }
        let bytes = bank.encode(&mut self.bytes).map_err(NackReason::Bank)?;
        self.length = bytes.len();
        Ok(())
    }

    /// Brings the bank in `bytes` into force, all of it or nothing.
    fn decode(&mut self) -> Result<(), NackReason> {
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        self.bank.decode_into(bytes).map_err(NackReason::Bank)?;
        let parameters = self.bank.parameters::<A, N, P>();
        self.in_force = parameters.map_err(NackReason::Bank)?;
        if let Ok([_, deviations]) = self.bank.linear::<A, N, P>() {
            self.deviations = deviations;
        }
        Ok(())
    }

    fn take_nominal(&mut self) {
        self.in_force = Parameters::nominal::<A>();
        self.deviations = LearnerConfig::<N, P>::for_arm::<A>(1e-3).sigma;
    }
}

/// Flash of a board without a store: there is none.
#[derive(Debug)]
pub enum NoFlash {}

impl NorFlashError for NoFlash {
    fn kind(&self) -> NorFlashErrorKind {
        match *self {}
    }
}

impl ErrorType for NoFlash {
    type Error = Self;
}

impl ReadNorFlash for NoFlash {
    const READ_SIZE: usize = 1;
    fn read(&mut self, _: u32, _: &mut [u8]) -> Result<(), Self> {
        match *self {}
    }
    fn capacity(&self) -> usize {
        match *self {}
    }
}

impl NorFlash for NoFlash {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = crate::store::SLOT_BYTES as usize;
    fn erase(&mut self, _: u32, _: u32) -> Result<(), Self> {
        match *self {}
    }
    fn write(&mut self, _: u32, _: &[u8]) -> Result<(), Self> {
        match *self {}
    }
}

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
        let (learner, mailbox) = (&mut mailboxes.learner, &mut mailboxes.parameters);
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
            let store = &mut self.protocol.counters.store;
            *store = store.after::<()>(wrote, &stored);
            if wrote {
                // Time stands still during an erase: the samples of before it are too old.
                let age = self.controller.safety.limits().timeout_ticks;
                self.controller.miss(age);
            }
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
