use embedded_storage::nor_flash::NorFlash;

use super::{HEADER_BYTES, Header, SLOT_BYTES};
use super::{SECTORS, StoreError, slots};
use crate::bank::ParameterBank;
use crate::copy;
use crate::wire::CRC;

/// Bytes read or written at once. A header is one piece, and a slot is whole pieces.
const PIECE: usize = HEADER_BYTES;
/// Slots that one save tries in a sector.
const ATTEMPTS: usize = 4;

#[derive(Clone, Copy, Debug)]
struct Record {
    /// Slot, counted over both sectors.
    slot: u32,
    header: Header,
}

impl Record {
    fn age(&self) -> (u32, u32) {
        (self.header.sequence, self.slot)
    }
}

/// Parameter banks in two sectors of flash.
///
/// Blocking; the [module](super) lists what stalls. Cost: a load reads every header, and the bank it loads, a few times; a
/// save also reads the sector of the newest set.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
}

impl<F: NorFlash> Store<F> {
    /// The store in `flash`, whose capacity is exactly two sectors. Accesses nothing yet.
    pub const fn new(flash: F) -> Self {
        const {
            assert!(
                F::ERASE_SIZE.is_multiple_of(SLOT_BYTES as usize),
                "join small pages of the flash: a part to erase holds whole slots of 4 KiB"
            );
            assert!(PIECE.is_multiple_of(F::WRITE_SIZE) && PIECE.is_multiple_of(F::READ_SIZE));
            assert!(HEADER_BYTES + ParameterBank::MAX_BYTES <= SLOT_BYTES as usize);
        }
        Self { flash }
    }

    /// The flash inside.
    pub const fn flash(&self) -> &F {
        &self.flash
    }

    /// The flash inside, for simulated defects.
    pub const fn flash_mut(&mut self) -> &mut F {
        &mut self.flash
    }

    /// Loads the newest whole set of the arm to the front of `buffer`: bytes of a bank, not checked yet.
    ///
    /// Errors: [`Empty`](StoreError::Empty), [`WrongArm`](StoreError::WrongArm), [`Version`](StoreError::Version),
    /// [`Damaged`](StoreError::Damaged) for a store without such a set; [`TooLong`](StoreError::TooLong) for a short
    /// buffer; [`Flash`](StoreError::Flash).
    pub fn load<'r>(
        &mut self,
        arm_hash: u32,
        buffer: &'r mut [u8],
    ) -> Result<&'r [u8], StoreError> {
        let mut newer = None;
        while let Some(record) = self.newest(newer, |header| header.is_for(arm_hash))? {
            newer = Some(record);
            let length = record.header.length as usize;
            if length > buffer.len() {
                return Err(StoreError::TooLong);
            }
            self.read(record, buffer)?;
            let bytes = buffer.get(..length).unwrap_or_default();
            if CRC.checksum(bytes) == record.header.crc {
                return Ok(buffer.get(..length).unwrap_or_default());
            }
        }
        Err(self.absence(arm_hash)?)
    }

    /// Stores the bytes of a bank and returns its number, counted from 1.
    ///
    /// The set before stays loadable until this one reads back as written.
    ///
    /// Errors: [`TooLong`](StoreError::TooLong), [`NotKept`](StoreError::NotKept), [`Flash`](StoreError::Flash). Sets that
    /// were loadable before still are.
    pub fn save(&mut self, arm_hash: u32, bank: &[u8]) -> Result<u32, StoreError> {
        if bank.len() > SLOT_BYTES as usize - HEADER_BYTES {
            return Err(StoreError::TooLong);
        }
        let newest = self.newest(None, |_| true)?;
        let sequence = newest.map_or(0, |record| record.header.sequence);
        // No flash lasts for so many saves: the counter is damaged.
        let sequence = sequence.checked_add(1).ok_or(StoreError::NotKept)?;
        let header = Header::of(bank, arm_hash, sequence);

        let keep = self.keep(arm_hash)?;
        if let Some(sector) = keep
            && self.save_in(sector, header, bank)?
        {
            return Ok(sequence);
        }
        let sector = keep.map_or(0, |sector| (sector + 1) % SECTORS);
        self.erase(sector)?;
        if self.save_in(sector, header, bank)? {
            return Ok(sequence);
        }
        Err(StoreError::NotKept)
    }

    /// The sector that must not be erased: that of the newest whole set, preferably of this arm.
    fn keep(&mut self, arm_hash: u32) -> Result<Option<u32>, StoreError> {
        for own in [true, false] {
            let mut newer = None;
            while let Some(record) = self.newest(newer, |header| !own || header.is_for(arm_hash))? {
                if self.is_whole(record)? {
                    return Ok(Some(record.slot / Self::slots()));
                }
                newer = Some(record);
            }
        }
        Ok(None)
    }

    /// Tries the first blank slots of `sector` in turn; true if one of them keeps the set.
    fn save_in(&mut self, sector: u32, header: Header, bank: &[u8]) -> Result<bool, StoreError> {
        let first = sector * Self::slots();
        let mut attempts = 0;
        for slot in first..first + Self::slots() {
            if !self.is_blank(slot)? {
                continue;
            }
            // After an error the slot is not whole, reported or not.
            let written = self.write(slot, header, bank);
            if written.is_ok() && self.is_kept(slot, header, bank)? {
                return Ok(true);
            }
            attempts += 1;
            if attempts == ATTEMPTS {
                break;
            }
        }
        Ok(false)
    }

    /// Writes one slot, the header last: without it there is no record.
    fn write(&mut self, slot: u32, header: Header, bank: &[u8]) -> Result<(), StoreError> {
        for (place, piece) in places(slot, 1).zip(bank.chunks(PIECE)) {
            let mut padded = [0xFF; PIECE];
            copy(&mut padded, piece);
            let length = piece.len().next_multiple_of(F::WRITE_SIZE);
            let words = padded.get(..length).unwrap_or_default();
            self.flash
                .write(place, words)
                .map_err(|_| StoreError::Flash)?;
        }
        self.flash
            .write(slot * SLOT_BYTES, &header.to_bytes())
            .map_err(|_| StoreError::Flash)
    }

    fn erase(&mut self, sector: u32) -> Result<(), StoreError> {
        let size = F::ERASE_SIZE as u32;
        self.flash
            .erase(sector * size, (sector + 1) * size)
            .map_err(|_| StoreError::Flash)
    }

    fn is_kept(&mut self, slot: u32, header: Header, bank: &[u8]) -> Result<bool, StoreError> {
        let mut kept = self.piece(slot * SLOT_BYTES)? == header.to_bytes();
        for (place, piece) in places(slot, 1).zip(bank.chunks(PIECE)) {
            kept &= self.piece(place)?.starts_with(piece);
        }
        Ok(kept)
    }

    /// True if the checksum fits the set.
    fn is_whole(&mut self, record: Record) -> Result<bool, StoreError> {
        let mut crc = CRC.digest();
        let mut left = record.header.length as usize;
        for place in places(record.slot, 1) {
            let length = left.min(PIECE);
            if length == 0 {
                break;
            }
            crc.update(self.piece(place)?.get(..length).unwrap_or_default());
            left -= length;
        }
        Ok(crc.finalize() == record.header.crc)
    }

    /// Reads the set into the front of `buffer`, which is long enough.
    fn read(&mut self, record: Record, buffer: &mut [u8]) -> Result<(), StoreError> {
        let set = buffer.get_mut(..record.header.length as usize);
        let parts = set.unwrap_or_default().chunks_mut(PIECE);
        for (place, part) in places(record.slot, 1).zip(parts) {
            copy(part, &self.piece(place)?);
        }
        Ok(())
    }

    /// The newest record that `wanted` accepts and that is older than `newer`, by its header alone.
    fn newest(
        &mut self,
        newer: Option<Record>,
        wanted: impl Fn(&Header) -> bool,
    ) -> Result<Option<Record>, StoreError> {
        let mut newest: Option<Record> = None;
        for slot in 0..SECTORS * Self::slots() {
            let Some(header) = Header::from_bytes(&self.piece(slot * SLOT_BYTES)?) else {
                continue;
            };
            let record = Record { slot, header };
            let older = newer.is_none_or(|newer| record.age() < newer.age());
            let best = newest.is_none_or(|newest| record.age() > newest.age());
            if wanted(&header) && older && best {
                newest = Some(record);
            }
        }
        Ok(newest)
    }

    /// Reason why there is no set of this arm.
    fn absence(&mut self, arm_hash: u32) -> Result<StoreError, StoreError> {
        let mut newer = None;
        while let Some(record) = self.newest(newer, |header| !header.is_for(arm_hash))? {
            newer = Some(record);
            if !self.is_whole(record)? {
                continue;
            }
            let found = record.header.arm_hash;
            return Ok(if found == arm_hash {
                StoreError::Version(record.header.bank_version)
            } else {
                StoreError::WrongArm { found }
            });
        }
        for slot in 0..SECTORS * Self::slots() {
            if !self.is_blank(slot)? {
                return Ok(StoreError::Damaged);
            }
        }
        Ok(StoreError::Empty)
    }

    fn is_blank(&mut self, slot: u32) -> Result<bool, StoreError> {
        for place in places(slot, 0) {
            if self.piece(place)? != [0xFF; PIECE] {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn piece(&mut self, place: u32) -> Result<[u8; PIECE], StoreError> {
        let mut bytes = [0; PIECE];
        self.flash
            .read(place, &mut bytes)
            .map_err(|_| StoreError::Flash)?;
        Ok(bytes)
    }

    const fn slots() -> u32 {
        slots(F::ERASE_SIZE as u32)
    }
}

/// Places of the pieces of a slot from number `first` on; number 0 is its header.
fn places(slot: u32, first: u32) -> impl Iterator<Item = u32> {
    let start = slot * SLOT_BYTES + first * PIECE as u32;
    (start..(slot + 1) * SLOT_BYTES).step_by(PIECE)
}
