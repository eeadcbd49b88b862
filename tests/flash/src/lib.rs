//! Simulated flash of the tests: two sectors that wear out, forget, protect themselves and lose power at any step.
//!
//! A step is one word programmed or one sector erased. Programming clears bits and sets none, as it does in silicon.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Bytes programmed at once: 32-bit parallelism (RM0090 3.6.2).
pub const WORD: usize = 4;
/// Bytes at both ends of a sector that some ways of losing power treat unlike the rest.
const EDGE: usize = 64;
const SECTORS: usize = 2;

/// Effect of the step in which the power fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Torn {
    /// The step has not begun.
    Before,
    /// The step is complete, without an answer.
    After,
    /// Every bit for itself has changed or not.
    Bits,
    /// As [`Bits`](Self::Bits), and those between two levels read differently every time.
    Unstable,
    /// Erase only: the first half is blank, the second as before.
    FirstHalf,
    /// Erase only: the second half is blank, the first as before.
    SecondHalf,
    /// Erase only: all is blank but both ends.
    EndsLeft,
    /// Erase only: both ends are blank, the rest as before.
    EndsBlank,
    /// Erase only: every bit is programmed, as some flashes begin an erase.
    Programmed,
}

impl Torn {
    /// All ways, for the erasing of a sector.
    pub const SECTOR: [Self; 9] = [
        Self::Before,
        Self::After,
        Self::Bits,
        Self::Unstable,
        Self::FirstHalf,
        Self::SecondHalf,
        Self::EndsLeft,
        Self::EndsBlank,
        Self::Programmed,
    ];
}

/// How a write-protected flash takes what it does not keep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Protection {
    /// It is not protected.
    #[default]
    None,
    /// It answers "done".
    Silent,
    /// It reports an error.
    Reported,
}

/// Two sectors of `SECTOR` bytes.
#[derive(Clone, Debug)]
pub struct SimulatedFlash<const SECTOR: usize> {
    bytes: Vec<u8>,
    /// Step in which the power goes, and what is left of it.
    cut: Option<(u64, Torn)>,
    powered: bool,
    protection: Protection,
    steps: u64,
    erases: [u64; SECTORS],
    rewritten: u64,
    /// Bits that stay 1 and bits that stay 0, by place.
    stuck: BTreeMap<usize, (u8, u8)>,
    /// Bits between two levels, by place.
    unstable: BTreeMap<usize, u8>,
    random: ChaCha8Rng,
}

impl<const SECTOR: usize> SimulatedFlash<SECTOR> {
    /// A new flash, blank.
    pub fn new(seed: u64) -> Self {
        Self {
            bytes: vec![0xFF; SECTORS * SECTOR],
            cut: None,
            powered: true,
            protection: Protection::None,
            steps: 0,
            erases: [0; SECTORS],
            rewritten: 0,
            stuck: BTreeMap::new(),
            unstable: BTreeMap::new(),
            random: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// A flash with this content.
    pub fn holding(bytes: [[u8; SECTOR]; SECTORS]) -> Self {
        Self {
            bytes: bytes.concat(),
            ..Self::new(0)
        }
    }

    /// Content as a perfect reader has it.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Words programmed and sectors erased so far, those that did nothing included.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Erases of each sector so far.
    pub fn erases(&self) -> [u64; SECTORS] {
        self.erases
    }

    /// Words programmed that were not blank, which some flashes refuse and all wear by.
    pub fn rewritten(&self) -> u64 {
        self.rewritten
    }

    /// Takes the power away in the step after `steps` more ones.
    pub fn cut_after(&mut self, steps: u64, torn: Torn) {
        self.cut = Some((self.steps + steps, torn));
    }

    /// Power is back, and stays.
    pub fn power_on(&mut self) {
        (self.cut, self.powered) = (None, true);
    }

    /// From now on, erase and program are refused this way.
    pub fn protect(&mut self, protection: Protection) {
        self.protection = protection;
    }

    /// Wears the flash: `bits` of them anywhere in `places` take random values, whatever is written or erased
    /// there. What is kept there today stays.
    pub fn wear(&mut self, places: std::ops::Range<usize>, bits: usize) {
        for _ in 0..bits {
            let place = self.random.random_range(places.clone());
            let bit = 1 << self.random.random_range(0..8);
            let (ones, zeros) = self.stuck.entry(place).or_default();
            if self.random.random() {
                *ones |= bit;
            } else {
                *zeros |= bit;
            }
        }
    }

    /// A bit of the byte at `place` is lost.
    pub fn rot(&mut self, place: usize, bit: u8) {
        self.bytes[place] ^= 1 << bit;
    }

    fn has_power(&self) -> Result<(), NorFlashErrorKind> {
        let powered = self.powered.then_some(());
        powered.ok_or(NorFlashErrorKind::Other)
    }

    /// Counts one step; what the power leaves of it.
    fn step(&mut self) -> Result<Torn, NorFlashErrorKind> {
        self.has_power()?;
        let step = self.steps;
        self.steps += 1;
        match self.cut {
            Some((at, torn)) if at == step => {
                self.powered = false;
                Ok(torn)
            }
            _ => Ok(Torn::After),
        }
    }

    /// Makes `wanted` of the bytes at `start`, as far as `torn` and worn cells let it.
    fn change(&mut self, start: usize, wanted: &[u8], torn: Torn) {
        let places = start..start + wanted.len();
        if !self.unstable.is_empty() {
            self.unstable.retain(|place, _| !places.contains(place));
        }
        if torn == Torn::After {
            self.bytes[places.clone()].copy_from_slice(wanted);
        } else {
            self.tear(start, wanted, torn);
        }
        for (&place, (ones, zeros)) in self.stuck.range(places) {
            self.bytes[place] = (self.bytes[place] | ones) & !zeros;
        }
    }

    fn tear(&mut self, start: usize, wanted: &[u8], torn: Torn) {
        let (length, half) = (wanted.len(), wanted.len() / 2);
        for (index, &wanted) in wanted.iter().enumerate() {
            let place = start + index;
            let end = index < EDGE || index + EDGE >= length;
            let old = self.bytes[place];
            let changed = old ^ wanted;
            self.bytes[place] = match torn {
                Torn::After => wanted,
                Torn::Bits | Torn::Unstable => old ^ (changed & self.random.random::<u8>()),
                Torn::FirstHalf if index < half => wanted,
                Torn::SecondHalf if index >= half => wanted,
                Torn::EndsLeft if !end => wanted,
                Torn::EndsBlank if end => wanted,
                Torn::Programmed => 0,
                _ => old,
            };
            if torn == Torn::Unstable && changed != 0 {
                self.unstable.insert(place, changed);
            }
        }
    }

    fn refused(&self) -> Result<bool, NorFlashErrorKind> {
        match self.protection {
            Protection::None => Ok(false),
            Protection::Silent => Ok(true),
            Protection::Reported => Err(NorFlashErrorKind::Other),
        }
    }
}

impl<const SECTOR: usize> ErrorType for SimulatedFlash<SECTOR> {
    type Error = NorFlashErrorKind;
}

impl<const SECTOR: usize> ReadNorFlash for SimulatedFlash<SECTOR> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        self.has_power()?;
        let start = offset as usize;
        bytes.copy_from_slice(&self.bytes[start..start + bytes.len()]);
        for (place, between) in self.unstable.range(start..start + bytes.len()) {
            bytes[place - start] ^= between & self.random.next_u32() as u8;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const SECTOR: usize> NorFlash for SimulatedFlash<SECTOR> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        for sector in from as usize / SECTOR..to as usize / SECTOR {
            let torn = self.step()?;
            if self.refused()? {
                continue;
            }
            self.erases[sector] += 1;
            self.change(sector * SECTOR, &vec![0xFF; SECTOR], torn);
        }
        self.has_power()
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        for (index, word) in bytes.chunks(WORD).enumerate() {
            let torn = self.step()?;
            if self.refused()? {
                continue;
            }
            let start = offset as usize + index * WORD;
            let old = &self.bytes[start..start + WORD];
            let blank = old.iter().all(|&byte| byte == 0xFF);
            let wanted: Vec<u8> = old.iter().zip(word).map(|(old, new)| old & new).collect();
            self.rewritten += u64::from(!blank);
            self.change(start, &wanted, torn);
        }
        self.has_power()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Flash = SimulatedFlash<1024>;

    fn word(flash: &mut Flash, offset: u32) -> [u8; 4] {
        let mut word = [0; 4];
        flash.read(offset, &mut word).unwrap();
        word
    }

    #[test]
    fn programming_clears_bits_and_only_an_erase_sets_them() {
        let mut flash = Flash::new(1);
        flash.write(8, &[0xF0, 0, 1, 2]).unwrap();
        flash.write(8, &[0x1F; 4]).unwrap();
        assert_eq!(word(&mut flash, 8), [0x10, 0, 1, 2]);
        assert_eq!((flash.rewritten(), flash.steps()), (1, 2));
        flash.erase(0, 1024).unwrap();
        assert_eq!(word(&mut flash, 8), [0xFF; 4]);
        assert_eq!(flash.erases(), [1, 0]);
    }

    #[test]
    fn after_a_cut_nothing_changes_until_power_is_back() {
        let mut flash = Flash::new(1);
        flash.cut_after(1, Torn::Before);
        assert!(flash.write(0, &[0; 12]).is_err());
        assert!(flash.write(0, &[0; 4]).is_err());
        assert!(flash.erase(0, 1024).is_err());
        flash.power_on();
        assert_eq!(word(&mut flash, 0), [0; 4]);
        assert_eq!(word(&mut flash, 4), [0xFF; 4]);
    }

    #[test]
    fn an_unstable_word_reads_differently_until_it_is_erased() {
        let mut flash = Flash::new(1);
        flash.cut_after(0, Torn::Unstable);
        assert!(flash.write(0, &[0; 4]).is_err());
        flash.power_on();
        let seen: std::collections::BTreeSet<_> = (0..50).map(|_| word(&mut flash, 0)).collect();
        assert!(seen.len() > 10);
        flash.erase(0, 1024).unwrap();
        assert_eq!(word(&mut flash, 0), [0xFF; 4]);
    }

    #[test]
    fn worn_cells_and_silent_protection_are_seen_by_reading_back_only() {
        let mut flash = Flash::new(1);
        flash.wear(0..4, 40);
        flash.write(0, &[0xA5; 4]).unwrap();
        assert_ne!(word(&mut flash, 0), [0xA5; 4]);
        flash.protect(Protection::Silent);
        flash.write(512, &[0; 4]).unwrap();
        assert_eq!(word(&mut flash, 512), [0xFF; 4]);
        flash.protect(Protection::Reported);
        assert!(flash.write(512, &[0; 4]).is_err());
    }
}
