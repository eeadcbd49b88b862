//! The emulated machine: its counter, its command line, its way out.

use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m_semihosting::{debug, hprintln};
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
    let mut text = [0u8; 32];
    let mut words = foretorque_images::words(&mut text).into_iter().flatten();
    let mut number = || core::str::from_utf8(words.next()?).ok()?.parse().ok();
    (number().unwrap_or(CALLS), number().unwrap_or(0))
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    hprintln!("{}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}
