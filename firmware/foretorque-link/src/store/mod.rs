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

mod log;

use crate::bank::{BankError, ParameterBank};
use crate::copy;
use crate::wire::CRC;
pub use log::Store;
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

errors! {
    /// Reason why a set was not stored or loaded. The board then runs on from RAM.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    pub enum StoreError {
        Empty = "no stored set";
        /// (All sets belong to other arms.)
        WrongArm {
            /// Identity of the arm of the newest one.
            #[serde(with = "postcard::fixint::le")]
            found: u32
        } = "stored set for another arm ({found:08x})";
        /// (All sets of this arm.)
        Version(version: u8) = "stored set of bank format version {version}";
        /// (None is whole.)
        Damaged = "stored sets damaged";
        Bank(error: BankError) = "stored set refused: {error}";
        TooLong = "set too long for the store";
        /// (Worn out, write-protected or absent.)
        NotKept = "the flash does not keep what is written";
        Flash = "the flash reported an error";
    }
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
    /// The state after one more access: a flash that failed to store is not sound because it can be read.
    ///
    /// * `wrote` the access was a save
    pub(crate) fn after<T>(self, wrote: bool, outcome: &Result<T, StoreError>) -> Self {
        match (self, outcome) {
            (Self::Failing, _) if !wrote => Self::Failing,
            (_, Ok(_)) => Self::Sound,
            (_, Err(StoreError::Empty)) => Self::Empty,
            (_, Err(StoreError::NotKept | StoreError::Flash)) => Self::Failing,
            (_, Err(_)) => Self::Refused,
        }
    }
}

/// Bytes of a slot, part of the format: sets stay readable when a later firmware has longer banks.
pub const SLOT_BYTES: u32 = 4096;
/// Bytes of a header: eight words.
pub const HEADER_BYTES: usize = 32;

const MAGIC: [u8; 4] = *b"FTSL";
/// Version of slot and header.
const LAYOUT: u16 = 1;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    /// Number of the save, from 1.
    pub(super) sequence: u32,
    /// Identity of the arm.
    pub(super) arm_hash: u32,
    /// Bytes of the bank.
    pub(super) length: u32,
    /// CRC-32 over them.
    pub(super) crc: u32,
    /// Version of their format.
    pub(super) bank_version: u8,
}

impl Header {
    pub(super) fn of(bank: &[u8], arm_hash: u32, sequence: u32) -> Self {
        Self {
            sequence,
            arm_hash,
            length: bank.len() as u32,
            crc: CRC.checksum(bank),
            bank_version: ParameterBank::FORMAT_VERSION,
        }
    }

    /// True if this firmware can read the set, and it belongs to this arm.
    pub(super) fn is_for(&self, arm_hash: u32) -> bool {
        self.arm_hash == arm_hash && self.bank_version == ParameterBank::FORMAT_VERSION
    }

    /// Magic, layout, bank version, blank, sequence, arm, length, CRC of the bank, blank word, CRC of all that.
    pub(super) fn to_bytes(self) -> [u8; HEADER_BYTES] {
        let [l0, l1] = LAYOUT.to_le_bytes();
        let mut words = [
            MAGIC,
            [l0, l1, self.bank_version, 0xFF],
            self.sequence.to_le_bytes(),
            self.arm_hash.to_le_bytes(),
            self.length.to_le_bytes(),
            self.crc.to_le_bytes(),
            [0xFF; 4],
            [0; 4],
        ];
        let [content @ .., crc] = &mut words;
        *crc = CRC.checksum(content.as_flattened()).to_le_bytes();
        let mut bytes = [0; HEADER_BYTES];
        copy(&mut bytes, words.as_flattened());
        bytes
    }

    /// Decodes a header; `None` for a damaged or missing one.
    pub(super) fn from_bytes(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let (words, _) = bytes.as_chunks::<4>();
        let [
            magic,
            [l0, l1, bank_version, _],
            sequence,
            arm_hash,
            length,
            crc,
            _,
            check,
        ] = *words
        else {
            return None;
        };
        let content = bytes.split_last_chunk::<4>()?.0;
        let whole = CRC.checksum(content) == u32::from_le_bytes(check);
        let header = Self {
            sequence: u32::from_le_bytes(sequence),
            arm_hash: u32::from_le_bytes(arm_hash),
            length: u32::from_le_bytes(length),
            crc: u32::from_le_bytes(crc),
            bank_version,
        };
        let fits = header.length <= SLOT_BYTES - HEADER_BYTES as u32;
        (whole && fits && magic == MAGIC && u16::from_le_bytes([l0, l1]) == LAYOUT)
            .then_some(header)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: Header = Header {
        sequence: 0x0102_0304,
        arm_hash: 0xDEAD_BEEF,
        length: 1234,
        crc: 0x5555_AAAA,
        bank_version: 1,
    };

    #[test]
    fn a_header_survives_and_one_wrong_bit_is_detected() {
        let bytes = HEADER.to_bytes();
        assert_eq!(Header::from_bytes(&bytes), Some(HEADER));
        for bit in 0..8 * HEADER_BYTES {
            let mut damaged = bytes;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Header::from_bytes(&damaged), None, "bit {bit}");
        }
    }

    #[test]
    fn blank_and_programmed_flash_and_a_length_beyond_the_slot_are_no_header() {
        for filling in [0x00, 0xFF] {
            assert_eq!(Header::from_bytes(&[filling; HEADER_BYTES]), None);
        }
        let mut header = HEADER;
        header.length = SLOT_BYTES - HEADER_BYTES as u32;
        assert_eq!(Header::from_bytes(&header.to_bytes()), Some(header));
        header.length += 1;
        assert_eq!(Header::from_bytes(&header.to_bytes()), None);
    }
}
