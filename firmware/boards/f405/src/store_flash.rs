//! Registers of the flash interface of the chip. The HAL's own driver reads the size of the chip, which faults in the
//! emulator. There these registers do nothing, which the store notices by reading back.

use cortex_m::asm::dsb;
use stm32f4xx_hal::pac::FLASH;

use crate::flash_driver::{FlashDriver, FlashRegisters};

/// Flash of the store.
pub type StoreFlash = FlashDriver<Registers>;

/// Registers of the flash interface.
pub struct Registers(pub FLASH);

/// Address of `offset` in the store.
fn address(offset: u32) -> usize {
    unsafe extern "C" {
        static _store_start: u8;
    }
    (&raw const _store_start) as usize + offset as usize
}

impl FlashRegisters for Registers {
    fn status(&self) -> u32 {
        dsb();
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
