//! The flash interface of the chip, for the two sectors of the store.
//!
//! The chip has one bank: while a word is programmed or a sector erased, every fetch from the flash waits, and with it
//! every interrupt. The emulator has no flash interface: there all this does nothing, which the store notices by reading
//! back. The HAL's own driver asks the chip for its size, which faults in the emulator.

use cortex_m::asm::dsb;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use stm32f4xx_hal::pac::FLASH;

use crate::chip::{FLASH_POLLS, STORE_SECTOR, STORE_SECTOR_BYTES};

/// Keys that unlock the control register (RM0090 3.6.1).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// Bytes programmed at once: 32-bit parallelism, for 2.7 to 3.6 V (RM0090 3.6.2).
const WORD: usize = 4;

/// The two sectors, as one piece of flash that begins at 0.
pub struct StoreFlash {
    registers: FLASH,
}

impl StoreFlash {
    /// Takes the flash interface, whose control register stays locked but while something changes.
    pub(crate) fn new(registers: FLASH) -> Self {
        Self { registers }
    }

    /// Runs `work` with the control register open.
    fn unlocked(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<(), NorFlashErrorKind>,
    ) -> Result<(), NorFlashErrorKind> {
        self.finished()?;
        if self.registers.cr().read().lock().is_locked() {
            for key in KEYS {
                self.registers.keyr().write(|w| w.key().set(key));
            }
        }
        // What an earlier operation left would be taken for a fault of this one; a one clears.
        self.registers.sr().write(|w| {
            w.operr()
                .clear()
                .wrperr()
                .clear()
                .pgaerr()
                .clear()
                .pgperr()
                .clear()
                .pgserr()
                .clear()
        });
        let done = work(self);
        self.registers.cr().write(|w| w.lock().locked());
        done
    }

    /// Waits for the end of an operation, at most [`FLASH_POLLS`] reads, and says whether the chip found fault with it.
    fn finished(&self) -> Result<(), NorFlashErrorKind> {
        dsb();
        for _ in 0..FLASH_POLLS {
            let status = self.registers.sr().read();
            if status.bsy().is_busy() {
                continue;
            }
            let fault = status.operr().bit()
                || status.wrperr().bit()
                || status.pgaerr().bit()
                || status.pgperr().bit()
                || status.pgserr().bit();
            return if fault {
                Err(NorFlashErrorKind::Other)
            } else {
                Ok(())
            };
        }
        Err(NorFlashErrorKind::Other)
    }

    /// The data cache does not notice that a sector was erased (RM0090 3.6.4).
    fn forget_cache(&self) {
        let acr = self.registers.acr();
        if acr.read().dcen().bit() {
            acr.modify(|_, w| w.dcen().clear_bit());
            acr.modify(|_, w| w.dcrst().set_bit());
            acr.modify(|_, w| w.dcrst().clear_bit());
            acr.modify(|_, w| w.dcen().set_bit());
        }
    }

    /// Where `offset` lies in memory.
    fn address(offset: u32) -> usize {
        unsafe extern "C" {
            static _store_start: u8;
        }
        (&raw const _store_start) as usize + offset as usize
    }
}

impl ErrorType for StoreFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for StoreFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        for (place, byte) in (Self::address(offset)..).zip(bytes) {
            // SAFETY: inside the two sectors, as was checked; volatile, because flash changes behind the compiler's back.
            *byte = unsafe { (place as *const u8).read_volatile() };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * STORE_SECTOR_BYTES
    }
}

impl NorFlash for StoreFlash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = STORE_SECTOR_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        let sectors = from as usize / STORE_SECTOR_BYTES..to as usize / STORE_SECTOR_BYTES;
        let erased = self.unlocked(|flash| {
            for sector in sectors {
                let number = STORE_SECTOR + sector as u8;
                let cr = flash.registers.cr();
                cr.write(|w| {
                    // SAFETY: 10 and 11 are sectors of this chip, and memory.x keeps the program out of them.
                    let w = unsafe { w.snb().bits(number) };
                    w.psize().psize32().ser().set_bit()
                });
                cr.modify(|_, w| w.strt().set_bit());
                flash.finished()?;
            }
            Ok(())
        });
        self.forget_cache();
        erased
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let (words, _) = bytes.as_chunks::<WORD>();
        self.unlocked(|flash| {
            flash
                .registers
                .cr()
                .write(|w| w.psize().psize32().pg().set_bit());
            for (place, word) in (Self::address(offset)..).step_by(WORD).zip(words) {
                // SAFETY: a word inside the two sectors, aligned, as was checked; the interface is in programming mode.
                unsafe { (place as *mut u32).write_volatile(u32::from_le_bytes(*word)) };
                flash.finished()?;
            }
            Ok(())
        })
    }
}
