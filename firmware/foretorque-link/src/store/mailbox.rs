use embedded_storage::nor_flash::NorFlash;

use super::{Store, StoreError};
use crate::bank::ParameterBank;
use serde::{Deserialize, Serialize};

/// Orders to the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreOrder {
    /// Keep a set.
    Save,
    /// Bring back the newest one.
    Restore,
}

/// How the store stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreState {
    /// The board has none, or nobody has asked it yet.
    #[default]
    Unused,
    /// The set in force at boot, or the last one asked for, came from it.
    Loaded,
    /// It kept the last set it was given.
    Saved,
    /// It did not do what was asked last; the board runs on from RAM.
    Failed(StoreError),
}

/// How the store stands, as the link tells it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StoreHealth {
    /// The board has none, or nobody has asked it yet.
    #[default]
    Unused,
    /// It has kept, or brought back, what it was asked to.
    Sound,
    /// There is no set in it.
    Empty,
    /// The stored set is unusable for this firmware or does not fit it.
    Refused,
    /// The flash is worn out, write-protected or not there: the board runs from RAM, and forgets at power-off what it was
    /// told to keep. Stays until something is kept.
    Failing,
}

impl StoreState {
    /// Health of the store as the link reports it.
    pub const fn health(self) -> StoreHealth {
        match self {
            Self::Unused => StoreHealth::Unused,
            Self::Loaded | Self::Saved => StoreHealth::Sound,
            Self::Failed(StoreError::Empty) => StoreHealth::Empty,
            Self::Failed(StoreError::NotKept | StoreError::Flash) => StoreHealth::Failing,
            Self::Failed(_) => StoreHealth::Refused,
        }
    }
}

impl StoreHealth {
    /// How it stands after one more order: a flash that has failed to keep is not sound because it could be read.
    pub(crate) const fn after(self, order: StoreOrder, state: StoreState) -> Self {
        match (self, order) {
            (Self::Failing, StoreOrder::Restore) => Self::Failing,
            _ => state.health(),
        }
    }
}

/// One order in the hands of the housekeeping.
pub struct StoreJob {
    order: StoreOrder,
    bytes: [u8; ParameterBank::MAX_BYTES],
    length: usize,
}

impl StoreJob {
    /// Does what was ordered. Blocking, and on one bank of flash stalling: for a disarmed board and its lowest priority.
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

    /// Order of the job.
    pub fn order(&self) -> StoreOrder {
        self.order
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Free,
    Waiting,
    /// With the housekeeping.
    Away,
    Done(Result<(), StoreError>),
}

/// Result of an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoreReply<'b> {
    /// Sequence number of the host's frame that asked.
    pub requester: u16,
    /// Order that was given.
    pub order: StoreOrder,
    /// The bytes that were kept or brought back, not judged yet, or why not.
    pub outcome: Result<&'b [u8], StoreError>,
}

/// The door between the session, which takes orders in the tick, and the housekeeping, which alone touches the flash.
///
/// ```text
/// tick:          mailbox.save(sequence, &bank)  …  if let Some(answer) = mailbox.collect() { … }
/// housekeeping:  if let Some(mut job) = lock(|mailbox| mailbox.begin()) {
///                    let outcome = job.execute(&mut store, arm_hash);      // the tick may run in the middle of it
///                    lock(|mailbox| mailbox.finish(&job, outcome));
///                }
/// ```
pub struct StoreMailbox {
    phase: Phase,
    order: StoreOrder,
    requester: u16,
    bytes: [u8; ParameterBank::MAX_BYTES],
    length: usize,
}

impl StoreMailbox {
    /// Nothing ordered.
    pub const fn new() -> Self {
        Self {
            phase: Phase::Free,
            order: StoreOrder::Restore,
            requester: 0,
            bytes: [0; ParameterBank::MAX_BYTES],
            length: 0,
        }
    }

    /// An order is on its way, or its answer waits to be collected: no other one is taken.
    pub fn is_busy(&self) -> bool {
        self.phase != Phase::Free
    }

    /// Orders `bank` to be kept. False, and nothing changes, while busy or when the bank has no bytes.
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

    /// Orders the newest set to be brought back. False, and nothing changes, while busy.
    pub fn restore(&mut self, requester: u16) -> bool {
        !self.is_busy() && self.post(requester, StoreOrder::Restore)
    }

    fn post(&mut self, requester: u16, order: StoreOrder) -> bool {
        (self.requester, self.order, self.phase) = (requester, order, Phase::Waiting);
        true
    }

    /// The order that waits, for the housekeeping to carry out. A copy, so that the flash is written without a lock.
    pub fn begin(&mut self) -> Option<StoreJob> {
        if self.phase != Phase::Waiting {
            return None;
        }
        self.phase = Phase::Away;
        Some(StoreJob {
            order: self.order,
            bytes: self.bytes,
            length: self.length,
        })
    }

    /// Hands an order back with what came of it.
    pub fn finish(&mut self, job: &StoreJob, outcome: Result<(), StoreError>) {
        if job.order == StoreOrder::Restore {
            (self.bytes, self.length) = (job.bytes, job.length);
        }
        self.phase = Phase::Done(outcome);
    }

    /// Result of an order, returned once.
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
