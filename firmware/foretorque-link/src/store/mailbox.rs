use embedded_storage::nor_flash::NorFlash;

use super::{Store, StoreError};
use crate::bank::ParameterBank;
use serde::{Deserialize, Serialize};

/// Order to the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreOrder {
    /// Store a set.
    Save,
    /// Return the newest one.
    Restore,
}

/// State of the store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StoreHealth {
    /// The board has none, or it has not been used yet.
    #[default]
    Unused,
    /// The last order succeeded.
    Sound,
    /// It holds no set.
    Empty,
    /// Its content does not fit this firmware, or the store.
    Refused,
    /// The flash is worn out, write-protected or absent: the board runs from RAM and loses its set at power-off. Stays
    /// until a save succeeds.
    Failing,
}

impl StoreHealth {
    /// The state after one more order: a flash that failed to store is not sound because it can be read.
    pub(crate) fn after<T>(self, order: StoreOrder, outcome: &Result<T, StoreError>) -> Self {
        match (self, order, outcome) {
            (Self::Failing, StoreOrder::Restore, _) => Self::Failing,
            (_, _, Ok(_)) => Self::Sound,
            (_, _, Err(StoreError::Empty)) => Self::Empty,
            (_, _, Err(StoreError::NotKept | StoreError::Flash)) => Self::Failing,
            (_, _, Err(_)) => Self::Refused,
        }
    }
}

/// An order that the housekeeping executes.
pub struct StoreJob {
    order: StoreOrder,
    bytes: [u8; ParameterBank::MAX_BYTES],
    length: usize,
}

impl StoreJob {
    /// Executes the order. Blocking, and stalling on a single flash bank: for a disarmed board and its lowest priority.
    pub fn execute<F: NorFlash>(
        &mut self,
        store: &mut Store<F>,
        arm_hash: u32,
    ) -> Result<(), StoreError> {
        match self.order {
            StoreOrder::Save => {
                let bank = self.bytes.get(..self.length).unwrap_or_default();
                store.save(arm_hash, bank).map(|_| ())
            }
            StoreOrder::Restore => {
                self.length = store.load(arm_hash, &mut self.bytes)?.len();
                Ok(())
            }
        }
    }

    /// The order.
    pub fn order(&self) -> StoreOrder {
        self.order
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Free,
    Waiting,
    /// The housekeeping executes it.
    Running,
    Done(Result<(), StoreError>),
}

/// Result of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoreReply<'b> {
    /// Sequence number of the requesting frame.
    pub requester: u16,
    /// The order.
    pub order: StoreOrder,
    /// The bytes stored or loaded, not checked yet, or the error.
    pub outcome: Result<&'b [u8], StoreError>,
}

/// Mailbox between the session, which takes orders in the tick, and the housekeeping, which alone accesses the flash.
///
/// [`Mailboxes`](crate::session::Mailboxes) shows the task of the housekeeping.
pub struct StoreMailbox {
    phase: Phase,
    order: StoreOrder,
    requester: u16,
    bytes: [u8; ParameterBank::MAX_BYTES],
    length: usize,
}

impl StoreMailbox {
    /// Without an order.
    pub const fn new() -> Self {
        Self {
            phase: Phase::Free,
            order: StoreOrder::Restore,
            requester: 0,
            bytes: [0; ParameterBank::MAX_BYTES],
            length: 0,
        }
    }

    /// An order waits or runs, or its result waits to be collected: no other one is accepted.
    pub fn is_busy(&self) -> bool {
        self.phase != Phase::Free
    }

    /// Orders a save of `bank`. False, and nothing changes, while busy or for a bank that cannot be encoded.
    pub fn save(&mut self, requester: u16, bank: &ParameterBank) -> bool {
        if self.is_busy() {
            return false;
        }
        let Ok(bytes) = bank.encode(&mut self.bytes) else {
            return false;
        };
        self.length = bytes.len();
        self.post(requester, StoreOrder::Save)
    }

    /// Orders the newest set. False, and nothing changes, while busy.
    pub fn restore(&mut self, requester: u16) -> bool {
        !self.is_busy() && self.post(requester, StoreOrder::Restore)
    }

    fn post(&mut self, requester: u16, order: StoreOrder) -> bool {
        (self.requester, self.order, self.phase) = (requester, order, Phase::Waiting);
        true
    }

    /// The order that waits. A copy, so that the flash is written without a lock.
    pub fn begin(&mut self) -> Option<StoreJob> {
        if self.phase != Phase::Waiting {
            return None;
        }
        self.phase = Phase::Running;
        Some(StoreJob {
            order: self.order,
            bytes: self.bytes,
            length: self.length,
        })
    }

    /// Returns an order with its result.
    pub fn finish(&mut self, job: &StoreJob, outcome: Result<(), StoreError>) {
        if job.order == StoreOrder::Restore {
            (self.bytes, self.length) = (job.bytes, job.length);
        }
        self.phase = Phase::Done(outcome);
    }

    /// Result of an order, once.
    pub fn collect(&mut self) -> Option<StoreReply<'_>> {
        let Phase::Done(outcome) = self.phase else {
            return None;
        };
        self.phase = Phase::Free;
        Some(StoreReply {
            requester: self.requester,
            order: self.order,
            outcome: outcome.map(|()| self.bytes.get(..self.length).unwrap_or_default()),
        })
    }
}

impl Default for StoreMailbox {
    fn default() -> Self {
        Self::new()
    }
}
