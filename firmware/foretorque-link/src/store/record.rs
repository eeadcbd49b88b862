//! One slot of the log: a header, then the bytes of a bank. What is not used stays blank.

use crate::bank::ParameterBank;
use crate::wire::CRC;

/// Bytes of a slot, part of the format: sets stay readable when a later firmware makes room for longer banks.
pub const SLOT_BYTES: u32 = 4096;
/// Bytes of a header: eight words.
pub const HEADER_BYTES: usize = 32;

const MAGIC: [u8; 4] = *b"FTSL";
/// Version of slot and header.
const LAYOUT: u16 = 1;

/// Header of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    /// Saves before this one, and one.
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
    /// The header of `bank`, the bytes of one that is for `arm_hash`.
    pub(super) fn of(bank: &[u8], arm_hash: u32, sequence: u32) -> Self {
        Self {
            sequence,
            arm_hash,
            length: bank.len() as u32,
            crc: CRC.checksum(bank),
            bank_version: ParameterBank::FORMAT_VERSION,
        }
    }

    /// Is this a set that this firmware can read, of this arm?
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
        for (slot, byte) in bytes.iter_mut().zip(words.as_flattened()) {
            *slot = *byte;
        }
        bytes
    }

    /// The header in `bytes`; `None` when they are none, or damaged.
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
    fn a_header_comes_back_and_one_wrong_bit_is_noticed() {
        let bytes = HEADER.to_bytes();
        assert_eq!(Header::from_bytes(&bytes), Some(HEADER));
        for bit in 0..8 * HEADER_BYTES {
            let mut damaged = bytes;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Header::from_bytes(&damaged), None, "bit {bit}");
        }
    }

    #[test]
    fn blank_and_programmed_flash_is_no_header() {
        for filling in [0x00, 0xFF] {
            assert_eq!(Header::from_bytes(&[filling; HEADER_BYTES]), None);
        }
    }

    #[test]
    fn a_length_beyond_the_slot_is_refused() {
        let mut header = HEADER;
        header.length = SLOT_BYTES - HEADER_BYTES as u32;
        assert_eq!(Header::from_bytes(&header.to_bytes()), Some(header));
        header.length += 1;
        assert_eq!(Header::from_bytes(&header.to_bytes()), None);
    }
}
