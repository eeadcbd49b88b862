//! The flash driver over a register-level fake: keys, lock, sticky flags, sectors.

use embedded_storage::nor_flash::{NorFlash as _, ReadNorFlash as _};
use foretorque_f405::chip::STORE_SECTOR_BYTES;
use foretorque_f405::flash_driver::*;
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
            assert!(
                (10..12).contains(&sector),
                "sector {sector} is not the store's"
            );
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
        flash.registers_mut().0.get_mut().fails = flag;
        assert!(flash.write(0, &[1, 2, 3, 4]).is_err());
        flash.write(4, &[5, 6, 7, 8]).unwrap();
        flash.registers_mut().0.get_mut().fails = flag;
        let sector = STORE_SECTOR_BYTES as u32;
        assert!(flash.erase(sector, 2 * sector).is_err());
        flash.erase(sector, 2 * sector).unwrap();
        let mut read = [0; 8];
        flash.read(0, &mut read).unwrap();
        assert_eq!(read[4..], [5, 6, 7, 8]);
        let fake = flash.registers_mut().0.get_mut();
        assert_eq!(
            (&fake.sectors[..], fake.control),
            (&[10, 11, 11][..], CR_LOCK)
        );
    }
}

#[test]
fn accesses_outside_or_across_words_are_refused() {
    let mut flash = driver();
    let end = 2 * STORE_SECTOR_BYTES as u32;
    assert!(flash.write(end, &[0; 4]).is_err() && flash.write(2, &[0; 4]).is_err());
    assert!(flash.erase(4, end).is_err() && flash.read(end - 1, &mut [0; 2]).is_err());
    assert!(flash.registers_mut().0.get_mut().sectors.is_empty());
}
