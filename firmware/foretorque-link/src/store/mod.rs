//! The store: parameter banks kept over power-off, in two sectors of flash.
//!
//! A log of fixed slots. A slot holds one bank behind a header; a save writes the first blank slot of the sector that holds
//! the newest set, and only when that sector has none left does it erase the other one. So no erase ever touches the sector
//! of the last good set, and no write touches a slot that is not blank. Whatever a power cut leaves in the slot or the
//! sector under way (partial words, half an erase), the newest set that is whole stays where it is and is found by its
//! checksum, robot and sequence number. A save is believed only when everything reads back as written: a worn or
//! write-protected flash that answers "done" is noticed, the next slots are tried, and in the end the board runs on from
//! RAM and says so.
//!
//! Why not the map of `sequential-storage` 8.0: it judges a sector by its first and last word, so half an erase can make
//! the old sector look like the one in use, and the repair that follows costs the only copy. It does not read back either,
//! so flash that silently keeps nothing is erased all the same. On the simulated flash that proves this room it lost sets
//! both ways.
//!
//! Cost: erasing stalls the one bank of an STM32F405, and with it every interrupt, for 1 s, at most 2 s (DS8626 table 48,
//! 32-bit parallelism); a save without erase programs 16 µs a word. So the store is for a disarmed board and for its
//! lowest priority.
//!
//! Wear: a sector lasts [`ERASE_CYCLES`] erases and takes [`slots`] saves between two of them; see [`saves`].

mod log;
mod mailbox;
mod record;

pub use log::Store;
pub use mailbox::{StoreHealth, StoreJob, StoreMailbox, StoreOrder, StoreReply, StoreState};
pub use record::{HEADER_BYTES, SLOT_BYTES};

use core::fmt;

use super::bank::BankError;
use serde::{Deserialize, Serialize};

/// Sectors of a store.
pub const SECTORS: u32 = 2;
/// Erases that a sector survives at least (STM32F405, -40 to 105 °C: DS8626 table 49).
pub const ERASE_CYCLES: u32 = 10_000;

/// Sets that a sector of `sector_bytes` holds.
pub const fn slots(sector_bytes: u32) -> u32 {
    sector_bytes / SLOT_BYTES
}

/// Saves that two sectors of `sector_bytes` survive at least: every one of their slots once for every erase.
///
/// ```
/// // Two sectors of 128 KiB: one save a minute, day and night, for more than a year.
/// assert_eq!(foretorque_link::store::saves(128 * 1024), 640_000);
/// ```
pub const fn saves(sector_bytes: u32) -> u32 {
    SECTORS * slots(sector_bytes) * ERASE_CYCLES
}

/// Why a set was not stored, or none was loaded. Whatever it is, the board runs on from RAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreError {
    /// There is no set.
    Empty,
    /// There are sets, but for the arm with this identity.
    WrongArm {
        /// Identity of the newest one.
        #[serde(with = "postcard::fixint::le")]
        found: u32,
    },
    /// There are sets of this arm, but in a bank format of another version.
    Version(u8),
    /// Something is written, but no set is whole.
    Damaged,
    /// The set is whole and for this arm, and yet no bank that this firmware takes.
    Bank(BankError),
    /// The bank is longer than a slot.
    TooLong,
    /// Bytes read back differ from those written: the flash is worn out, write-protected, or not there.
    NotKept,
    /// The flash reported an error.
    Flash,
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("no stored set"),
            Self::WrongArm { found } => write!(f, "stored set for another arm ({found:08x})"),
            Self::Version(version) => write!(f, "stored set of bank format version {version}"),
            Self::Damaged => f.write_str("stored sets damaged"),
            Self::Bank(error) => write!(f, "stored set refused: {error}"),
            Self::TooLong => f.write_str("set too long for the store"),
            Self::NotKept => f.write_str("the flash does not keep what is written"),
            Self::Flash => f.write_str("the flash reported an error"),
        }
    }
}

impl core::error::Error for StoreError {}
