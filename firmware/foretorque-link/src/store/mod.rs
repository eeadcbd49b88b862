//! Store of parameter banks over power-off, in two sectors of flash.
//!
//! A log of fixed slots, each a header and one bank. A save writes the first blank slot of the sector of the newest set. Only
//! when that sector is full does it erase the other one. So no erase touches the sector of the last good set, and no write
//! touches a slot that is not blank. A power cut leaves partial words or half an erase; the newest whole set is still found
//! by its checksum, arm and sequence number.
//!
//! A save succeeds only when everything reads back as written. On a worn or write-protected flash it tries the next slots;
//! then it fails, and the board runs on from RAM.
//!
//! The map of `sequential-storage` 8.0 lost sets on the simulated flash: after half an erase, and because it does not read
//! back.
//!
//! Cost: erasing stalls the flash bank of an STM32F405, and with it every interrupt, for 1 s, at most 2 s (DS8626 table 48,
//! 32-bit parallelism); a save without erase programs 16 µs a word. So the store needs a disarmed board and the lowest
//! priority.
//!
//! Wear: a sector lasts [`ERASE_CYCLES`] erases and takes [`slots`] saves between two of them; see [`saves`].

mod health;
mod log;
mod record;

pub use health::StoreHealth;
pub use log::Store;
pub use record::{HEADER_BYTES, SLOT_BYTES};

use core::fmt;

use super::bank::BankError;
use serde::{Deserialize, Serialize};

/// Sectors of a store.
pub const SECTORS: u32 = 2;
/// Erases that a sector survives at least (STM32F405, -40 to 105 °C: DS8626 table 49).
pub const ERASE_CYCLES: u32 = 10_000;

/// Sets in a sector of `sector_bytes`.
pub const fn slots(sector_bytes: u32) -> u32 {
    sector_bytes / SLOT_BYTES
}

/// Saves that two sectors of `sector_bytes` survive at least: every slot once an erase.
///
/// ```
/// // Two sectors of 128 KiB: one save a minute, day and night, for more than a year.
/// assert_eq!(foretorque_link::store::saves(128 * 1024), 640_000);
/// ```
pub const fn saves(sector_bytes: u32) -> u32 {
    SECTORS * slots(sector_bytes) * ERASE_CYCLES
}

/// Reason why a set was not stored or loaded. The board then runs on from RAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreError {
    /// The store is empty.
    Empty,
    /// All sets belong to another arm.
    WrongArm {
        /// Identity of the newest one.
        #[serde(with = "postcard::fixint::le")]
        found: u32,
    },
    /// All sets of this arm have a bank format of another version.
    Version(u8),
    /// No set is whole.
    Damaged,
    /// The firmware refuses the bank of the set.
    Bank(BankError),
    /// The bank exceeds a slot.
    TooLong,
    /// The flash does not read back as written: worn out, write-protected or absent.
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
