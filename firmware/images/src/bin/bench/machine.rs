//! The emulated machine: its counter, its command line, its way out.

use core::cell::Cell;
use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m_semihosting::{debug, hprintln, syscall};
use stm32f4xx_hal::pac::TIM2;

use crate::stage::Stage;

/// Calls of each row when the command line names no number.
const CALLS: u32 = 64;

/// Lets TIM2 run freely.
pub(crate) fn start_counter() {
    // SAFETY: nothing else in this program touches the timer.
    let timer = unsafe { &*TIM2::ptr() };
    timer.psc().reset();
    // SAFETY: every value of the reload register is allowed; the largest makes differences wrap at 2^32.
    timer.arr().write(|w| unsafe { w.bits(u32::MAX) });
    timer.cr1().write(|w| w.cen().enabled());
}

fn now() -> u32 {
    // SAFETY: a read of a counter nobody writes after `start_counter`; it has no side effect.
    unsafe { &*TIM2::ptr() }.cnt().read().bits()
}

/// Counts between two readings around one call. Not inlined: every row has the same bracket.
#[inline(never)]
pub(crate) fn count(run: fn(&mut Stage), stage: &mut Stage) -> u32 {
    let before = now();
    black_box(run)(black_box(stage));
    now().wrapping_sub(before)
}

/// The numbers on the command line that the host passes by semihosting: calls of each row, ticks of the long run.
pub(crate) fn numbers() -> (u32, u32) {
    const SYS_GET_CMDLINE: usize = 0x15;
    let mut text = [0u8; 32];
    // Cells, because the host writes the length of the text back.
    let block = [text.as_mut_ptr() as usize, text.len()].map(Cell::new);
    // SAFETY: the block holds the address and the size of a buffer that outlives the call, as the operation requires
    // (ARM semihosting 2.0, SYS_GET_CMDLINE); the host writes both.
    let failed = unsafe { syscall(SYS_GET_CMDLINE, &block) };
    if failed != 0 {
        return (CALLS, 0);
    }
    let mut words = black_box(&text)
        .split(|byte| !byte.is_ascii_digit())
        .filter(|word| !word.is_empty());
    let mut number = || {
        let digits = words.next().unwrap_or_default().iter();
        digits.fold(0u32, |n, byte| {
            n.wrapping_mul(10).wrapping_add(u32::from(byte - b'0'))
        })
    };
    let calls = number();
    (if calls == 0 { CALLS } else { calls }, number())
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    hprintln!("{}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}
