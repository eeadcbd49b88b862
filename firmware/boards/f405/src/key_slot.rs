//! The write key in its sector of the flash, and the seed of its challenges.

use core::mem::MaybeUninit;

use foretorque_link::wire::MAC_BYTES;
use foretorque_link::write_key::{KEY_BYTES, WriteKey};
use stm32f4xx_hal::pac::{RCC, RNG};

/// Reads of the random number generator's ready flag for one word: it takes 40 periods of 48 MHz (RM0090 24.3.1), 140
/// cycles of the core.
const RANDOM_POLLS: u32 = 1000;

/// Starts of the board since power came on, from whatever the memory held then. The linker leaves the section alone.
#[unsafe(link_section = ".uninit.starts")]
static mut STARTS: MaybeUninit<u32> = MaybeUninit::uninit();

/// The key that was written to the start of sector 9, if one was; see memory.x.
pub(crate) fn write_key() -> Option<WriteKey> {
    unsafe extern "C" {
        static _write_key: [u8; KEY_BYTES];
    }
    // SAFETY: the address is in the flash, aligned for bytes, and never changes while the firmware runs. Volatile, because
    // the compiler must not assume what is there.
    WriteKey::from_slot(unsafe { (&raw const _write_key).read_volatile() })
}

/// Bytes that differ from start to start: random words and the number of the start. `None` where the generator fails; then
/// the board gives no challenge.
///
/// * `emulated` the chip has no generator; the number alone differs, until the emulator ends
pub(crate) fn seed(rng: &RNG, rcc: &RCC, emulated: bool) -> Option<[u8; MAC_BYTES]> {
    // First: its clock takes two cycles (ES0182 2.1.13), in which the start is counted. A write before them has no effect.
    rcc.ahb2enr().modify(|_, w| w.rngen().enabled());
    let starts = &raw mut STARTS;
    // SAFETY: called once, from `init`, with interrupts off; any bit pattern is a u32.
    let number = unsafe {
        let number = starts.cast::<u32>().read_volatile().wrapping_add(1);
        starts.cast::<u32>().write_volatile(number);
        number
    };
    rng.cr().write(|w| w.rngen().set_bit());
    // The first word is discarded, and no word may equal the one before (RM0090 24.3.1, FIPS 140-2).
    let first = random(rng);
    let words = [random(rng), random(rng), random(rng)];
    rng.cr().reset();
    let [a, b, c] = words;
    let random = a != 0 && b != 0 && c != 0 && first != a && a != b && b != c;
    let mut seed = [0; MAC_BYTES];
    let bytes = [number, a, b, c].into_iter().flat_map(u32::to_le_bytes);
    for (slot, byte) in seed.iter_mut().zip(bytes) {
        *slot = byte;
    }
    (random || emulated).then_some(seed)
}

/// A random word; 0 when none comes, or the generator reports an error.
fn random(rng: &RNG) -> u32 {
    let ready = (0..RANDOM_POLLS).any(|_| rng.sr().read().drdy().bit_is_set());
    let status = rng.sr().read();
    if ready && status.secs().bit_is_clear() && status.cecs().bit_is_clear() {
        rng.dr().read().bits()
    } else {
        0
    }
}
