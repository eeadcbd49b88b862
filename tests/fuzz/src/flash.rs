use crate::{CRC, sealing};
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use foretorque_link::store::SLOT_BYTES;

const SECTOR: usize = SLOT_BYTES as usize;

/// Flash of two sectors with one slot each, that begins with the fuzzer's bytes.
pub(crate) struct TinyFlash {
    bytes: [u8; 2 * SECTOR],
}

impl TinyFlash {
    /// The first half of `content` at the front of the first sector, the rest at that of the second. An even first byte
    /// seals what follows it in each: the checksum of the header is put right.
    pub(crate) fn with(content: &[u8]) -> Self {
        let mut bytes = [0xFF; 2 * SECTOR];
        let (seal, content) = sealing(content);
        let halves = content.split_at(content.len() / 2);
        for (sector, half) in bytes.chunks_mut(SECTOR).zip([halves.0, halves.1]) {
            for (to, from) in sector.iter_mut().zip(half) {
                *to = *from;
            }
            if let (true, Some((header, body))) = (seal, sector.split_at_mut_checked(32)) {
                let length = u32::from_le_bytes([header[16], header[17], header[18], header[19]]);
                let body = body.get(..length as usize).unwrap_or_default();
                header[20..24].copy_from_slice(&CRC.checksum(body).to_le_bytes());
                let check = CRC.checksum(&header[..28]);
                header[28..].copy_from_slice(&check.to_le_bytes());
            }
        }
        Self { bytes }
    }
}

impl ErrorType for TinyFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for TinyFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let start = offset as usize;
        let from = self.bytes.get(start..start + bytes.len());
        bytes.copy_from_slice(from.ok_or(NorFlashErrorKind::OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for TinyFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        let sectors = self.bytes.get_mut(from as usize..to as usize);
        sectors.ok_or(NorFlashErrorKind::OutOfBounds)?.fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let start = offset as usize;
        let words = self.bytes.get_mut(start..start + bytes.len());
        let words = words.ok_or(NorFlashErrorKind::OutOfBounds)?;
        for (to, from) in words.iter_mut().zip(bytes) {
            *to &= from;
        }
        Ok(())
    }
}
