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
