//! Check of the program in flash against the checksum that was written into it after linking.
//!
//! An ELF file straight from the linker is unsealed: it starts, and its hello reports so. `cargo xtask flash` seals it.

use foretorque_link::wire::{ImageStatus, checksum};

/// Name of the seal in the ELF file.
pub const SYMBOL: &str = "FORETORQUE_SEAL";
/// Bytes of the seal.
pub const BYTES: usize = 8;

/// Length of a program, bytes, and the CRC-32 of it without these two words. Zeros: not sealed.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seal {
    /// Bytes of the program, the seal included.
    pub length: u32,
    /// CRC-32 of the bytes before and behind the seal.
    pub crc: u32,
}

impl Seal {
    /// The seal of `program`, in which it lies at `place`; `None` where it does not lie inside.
    pub fn of(program: &[u8], place: usize) -> Option<Self> {
        let before = program.get(..place)?;
        let behind = program.get(place.checked_add(BYTES)?..)?;
        Some(Self {
            length: program.len() as u32,
            crc: checksum([before, behind]),
        })
    }

    /// Checks the program that `flash` begins with.
    ///
    /// * `place` of this seal in the flash
    pub fn check(self, flash: &[u8], place: usize) -> ImageStatus {
        if self == Self::default() {
            return ImageStatus::Unsealed;
        }
        let program = flash.get(..self.length as usize);
        match program.and_then(|program| Self::of(program, place)) {
            Some(right) if right == self => ImageStatus::Sound,
            _ => ImageStatus::Damaged,
        }
    }
}

/// The seal of this program. The linker places it in the flash; `cargo xtask flash` finds it by its name.
#[cfg(target_os = "none")]
#[used]
// SAFETY: no other symbol has this name.
#[unsafe(export_name = "FORETORQUE_SEAL")]
static SEAL: Seal = Seal { length: 0, crc: 0 };

/// Checks the program that runs.
///
/// Cost: about 20 cycles a byte; nothing where it is not sealed.
#[cfg(target_os = "none")]
pub(crate) fn check() -> ImageStatus {
    unsafe extern "C" {
        static _image_start: u8;
        static _write_key: u8;
    }
    let (seal, start, end) = (
        &raw const SEAL,
        &raw const _image_start,
        &raw const _write_key,
    );
    let length = (end as usize).wrapping_sub(start as usize);
    // SAFETY: the seal is a constant of this program; volatile, because its value is written after linking.
    let read = unsafe { seal.read_volatile() };
    // SAFETY: both symbols are the ends of the flash of the program in memory.x, which never changes while it runs.
    let flash = unsafe { core::slice::from_raw_parts(start, length) };
    read.check(flash, (seal as usize).wrapping_sub(start as usize))
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque_link::wire::ImageStatus::{Damaged, Sound, Unsealed};

    const PLACE: usize = 300;

    fn write(flash: &mut [u8], seal: Seal) {
        flash[PLACE..PLACE + 4].copy_from_slice(&seal.length.to_le_bytes());
        flash[PLACE + 4..PLACE + BYTES].copy_from_slice(&seal.crc.to_le_bytes());
    }

    /// The seal as the program reads it from the flash.
    fn read(flash: &[u8]) -> Seal {
        let word = |at: usize| u32::from_le_bytes(flash[at..at + 4].try_into().unwrap());
        Seal {
            length: word(PLACE),
            crc: word(PLACE + 4),
        }
    }

    #[test]
    fn m7_every_flipped_bit_of_a_sealed_program_is_found() {
        let mut flash: Vec<u8> = (0..4096_u32).map(|k| ((k * 7) >> 2) as u8).collect();
        let program = 1000;
        write(&mut flash, Seal::default());
        assert_eq!(read(&flash).check(&flash, PLACE), Unsealed);
        let seal = Seal::of(&flash[..program], PLACE).unwrap();
        write(&mut flash, seal);
        assert_eq!(read(&flash).check(&flash, PLACE), Sound);
        for bit in 0..8 * flash.len() {
            flash[bit / 8] ^= 1 << (bit % 8);
            let wanted = if bit / 8 < program { Damaged } else { Sound };
            assert_eq!(read(&flash).check(&flash, PLACE), wanted, "bit {bit}");
            flash[bit / 8] ^= 1 << (bit % 8);
        }
        assert_eq!(Seal::of(&flash[..PLACE + BYTES - 1], PLACE), None);
    }
}
