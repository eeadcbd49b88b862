//! Driver of the flash interface over its registers (RM0090 3.9), for the two sectors of the store.
//!
//! The chip has one bank: while a word is programmed or a sector erased, every fetch from the flash waits, and with it
//! every interrupt.

use crate::chip::{FLASH_POLLS, STORE_SECTOR, STORE_SECTOR_BYTES};
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// Keys that unlock the control register (RM0090 3.6.1).
pub const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// Status: OPERR, WRPERR, PGAERR, PGPERR, PGSERR. They are sticky; writing a one clears.
pub const SR_ERRORS: u32 = 0b1111_0010;
/// Status: busy.
pub const SR_BUSY: u32 = 1 << 16;
/// Control: program.
pub const CR_PROGRAM: u32 = 1 << 0;
/// Control: erase a sector; its number is in bits 3 to 6.
pub const CR_ERASE: u32 = 1 << 1;
/// Control: 32-bit parallelism, for 2.7 to 3.6 V (RM0090 3.6.2).
pub const CR_WORD: u32 = 2 << 8;
/// Control: start an erase.
pub const CR_START: u32 = 1 << 16;
/// Control: locked.
pub const CR_LOCK: u32 = 1 << 31;

/// Bytes programmed at once.
const WORD: usize = 4;

/// Registers of the flash interface, and the memory of the store.
pub trait FlashRegisters {
    /// Status register.
    fn status(&self) -> u32;
    /// Writes the status register: ones clear.
    fn clear_status(&mut self, ones: u32);
    /// Control register.
    fn control(&self) -> u32;
    /// Writes the control register.
    fn set_control(&mut self, bits: u32);
    /// Writes the key register.
    fn key(&mut self, key: u32);
    /// Discards cached data: the cache does not notice an erase (RM0090 3.6.4).
    fn discard_cache(&mut self);
    /// Byte at `offset` of the store.
    fn read(&self, offset: u32) -> u8;
    /// Writes a word at `offset` of the store, which programs it in program mode.
    fn program(&mut self, offset: u32, word: u32);
}

/// The two sectors as one piece of flash that begins at 0. The control register is locked except during an operation.
pub struct FlashDriver<R> {
    registers: R,
}

impl<R: FlashRegisters> FlashDriver<R> {
    /// A driver over `registers`. Accesses nothing yet.
    pub const fn new(registers: R) -> Self {
        Self { registers }
    }

    /// Runs `work` with the control register unlocked.
    fn unlocked(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<(), NorFlashErrorKind>,
    ) -> Result<(), NorFlashErrorKind> {
        // Flags of an earlier operation stay until they are cleared: this one does not fail for them.
        self.idle()?;
        self.registers.clear_status(SR_ERRORS);
        if self.registers.control() & CR_LOCK != 0 {
            for key in KEYS {
                self.registers.key(key);
            }
        }
        let done = work(self);
        self.registers.set_control(CR_LOCK);
        done
    }

    /// Waits for the end of an operation, at most [`FLASH_POLLS`] reads; returns the status.
    fn idle(&self) -> Result<u32, NorFlashErrorKind> {
        let mut polls = 0..FLASH_POLLS;
        let status = polls.find_map(|_| {
            let status = self.registers.status();
            (status & SR_BUSY == 0).then_some(status)
        });
        status.ok_or(NorFlashErrorKind::Other)
    }

    /// Waits for the end of an operation. Errors: a flag that it has set.
    fn finished(&self) -> Result<(), NorFlashErrorKind> {
        let sound = self.idle()? & SR_ERRORS == 0;
        sound.then_some(()).ok_or(NorFlashErrorKind::Other)
    }
}

impl<R> ErrorType for FlashDriver<R> {
    type Error = NorFlashErrorKind;
}

impl<R: FlashRegisters> ReadNorFlash for FlashDriver<R> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        for (place, byte) in (offset..).zip(bytes) {
            *byte = self.registers.read(place);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * STORE_SECTOR_BYTES
    }
}

impl<R: FlashRegisters> NorFlash for FlashDriver<R> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = STORE_SECTOR_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        let sectors = from as usize / STORE_SECTOR_BYTES..to as usize / STORE_SECTOR_BYTES;
        let erased = self.unlocked(|flash| {
            for sector in sectors {
                let number = u32::from(STORE_SECTOR) + sector as u32;
                let erase = CR_ERASE | CR_WORD | number << 3;
                flash.registers.set_control(erase);
                flash.registers.set_control(erase | CR_START);
                flash.finished()?;
            }
            Ok(())
        });
        self.registers.discard_cache();
        erased
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let (words, _) = bytes.as_chunks::<WORD>();
        self.unlocked(|flash| {
            flash.registers.set_control(CR_PROGRAM | CR_WORD);
            for (place, word) in (offset..).step_by(WORD).zip(words) {
                flash.registers.program(place, u32::from_le_bytes(*word));
                flash.finished()?;
            }
            Ok(())
        })
    }
}

/// Flash of the store.
#[cfg(target_os = "none")]
pub type StoreFlash = FlashDriver<Registers>;

/// Registers of the flash interface of the chip.
///
/// The HAL's own driver reads the size of the chip, which faults in the emulator. There these registers do nothing, which
/// the store notices by reading back.
#[cfg(target_os = "none")]
pub struct Registers(pub stm32f4xx_hal::pac::FLASH);

/// Address of `offset` in the store.
#[cfg(target_os = "none")]
fn address(offset: u32) -> usize {
    unsafe extern "C" {
        static _store_start: u8;
    }
    (&raw const _store_start) as usize + offset as usize
}

#[cfg(target_os = "none")]
impl FlashRegisters for Registers {
    fn status(&self) -> u32 {
        cortex_m::asm::dsb();
        self.0.sr().read().bits()
    }

    fn clear_status(&mut self, ones: u32) {
        // SAFETY: ones clear flags, which is all that this register can do.
        self.0.sr().write(|w| unsafe { w.bits(ones) });
    }

    fn control(&self) -> u32 {
        self.0.cr().read().bits()
    }

    fn set_control(&mut self, bits: u32) {
        // SAFETY: the driver names sectors 10 and 11 only, and memory.x keeps the program out of them.
        self.0.cr().write(|w| unsafe { w.bits(bits) });
    }

    fn key(&mut self, key: u32) {
        self.0.keyr().write(|w| w.key().set(key));
    }

    fn discard_cache(&mut self) {
        let acr = self.0.acr();
        if acr.read().dcen().bit() {
            acr.modify(|_, w| w.dcen().clear_bit());
            acr.modify(|_, w| w.dcrst().set_bit());
            acr.modify(|_, w| w.dcrst().clear_bit());
            acr.modify(|_, w| w.dcen().set_bit());
        }
    }

    fn read(&self, offset: u32) -> u8 {
        // SAFETY: inside the two sectors, as the driver has checked; volatile, because flash changes unseen by the compiler.
        unsafe { (address(offset) as *const u8).read_volatile() }
    }

    fn program(&mut self, offset: u32, word: u32) {
        // SAFETY: a word inside the two sectors, aligned, as the driver has checked.
        unsafe { (address(offset) as *mut u32).write_volatile(word) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    /// Flash interface whose error flags stay until they are cleared, as those of the chip.
    struct Fake {
        memory: Vec<u8>,
        status: u32,
        control: u32,
        keys: usize,
        busy: u32,
        /// Flag that the next operation sets.
        fails: u32,
        sectors: Vec<u32>,
    }

    impl Fake {
        fn end(&mut self) -> bool {
            self.status |= SR_BUSY | std::mem::take(&mut self.fails);
            self.busy = 3;
            self.status & SR_ERRORS == 0
        }
    }

    struct Shared(RefCell<Fake>);

    impl FlashRegisters for Shared {
        fn status(&self) -> u32 {
            let mut fake = self.0.borrow_mut();
            let status = fake.status;
            fake.busy = fake.busy.saturating_sub(1);
            if fake.busy == 0 {
                fake.status &= !SR_BUSY;
            }
            status
        }
        fn clear_status(&mut self, ones: u32) {
            self.0.get_mut().status &= !ones;
        }
        fn control(&self) -> u32 {
            self.0.borrow().control
        }
        fn set_control(&mut self, bits: u32) {
            let fake = self.0.get_mut();
            assert_eq!(fake.control & CR_LOCK, 0, "the register is locked");
            fake.control = bits;
            if bits & CR_LOCK != 0 {
                fake.keys = 0;
            } else if bits & CR_START != 0 {
                let sector = bits >> 3 & 0xF;
                assert_eq!(bits & (CR_ERASE | CR_WORD), CR_ERASE | CR_WORD);
                let own = (10..12).contains(&sector);
                assert!(own, "sector {sector} is not the store's");
                fake.sectors.push(sector);
                if fake.end() {
                    let start = (sector as usize - 10) * STORE_SECTOR_BYTES;
                    fake.memory[start..][..STORE_SECTOR_BYTES].fill(0xFF);
                }
            }
        }
        fn key(&mut self, key: u32) {
            let fake = self.0.get_mut();
            assert_eq!(key, KEYS[fake.keys]);
            fake.keys += 1;
            if fake.keys == KEYS.len() {
                fake.control &= !CR_LOCK;
            }
        }
        fn discard_cache(&mut self) {}
        fn read(&self, offset: u32) -> u8 {
            self.0.borrow().memory[offset as usize]
        }
        fn program(&mut self, offset: u32, word: u32) {
            let fake = self.0.get_mut();
            assert_eq!(fake.control, CR_PROGRAM | CR_WORD);
            if fake.end() {
                fake.memory[offset as usize..][..4].copy_from_slice(&word.to_le_bytes());
            }
        }
    }

    fn driver() -> FlashDriver<Shared> {
        FlashDriver::new(Shared(RefCell::new(Fake {
            memory: vec![0; 2 * STORE_SECTOR_BYTES],
            status: 0,
            control: CR_LOCK,
            keys: 0,
            busy: 0,
            fails: 0,
            sectors: Vec::new(),
        })))
    }

    #[test]
    fn m9_an_error_of_one_operation_does_not_fail_the_next() {
        for flag in [1 << 1, 1 << 4, 1 << 5, 1 << 6, 1 << 7] {
            let mut flash = driver();
            flash.erase(0, STORE_SECTOR_BYTES as u32).unwrap();
            flash.registers.0.get_mut().fails = flag;
            assert!(flash.write(0, &[1, 2, 3, 4]).is_err());
            flash.write(4, &[5, 6, 7, 8]).unwrap();
            flash.registers.0.get_mut().fails = flag;
            let sector = STORE_SECTOR_BYTES as u32;
            assert!(flash.erase(sector, 2 * sector).is_err());
            flash.erase(sector, 2 * sector).unwrap();
            let mut read = [0; 8];
            flash.read(0, &mut read).unwrap();
            assert_eq!(read[4..], [5, 6, 7, 8]);
            let fake = flash.registers.0.get_mut();
            assert_eq!(fake.sectors, [10, 11, 11]);
            assert_eq!(fake.control, CR_LOCK);
        }
    }

    #[test]
    fn accesses_outside_or_across_words_are_refused() {
        let mut flash = driver();
        let end = 2 * STORE_SECTOR_BYTES as u32;
        assert!(flash.write(end, &[0; 4]).is_err() && flash.write(2, &[0; 4]).is_err());
        assert!(flash.erase(4, end).is_err() && flash.read(end - 1, &mut [0; 2]).is_err());
        assert!(flash.registers.0.get_mut().sectors.is_empty());
    }
}
