//! What a stretch of code costs: processor cycles on silicon, executed instructions in the emulator.

use core::sync::atomic::{AtomicBool, Ordering};

use stm32f4xx_hal::pac;

/// The emulator's cycle counter reads zero; its TIM2 counts nanoseconds of virtual time, which under
/// `-icount shift=S` are executed instructions × 2^S.
static EMULATED: AtomicBool = AtomicBool::new(false);

/// Starts the counter that works on this machine.
pub(crate) fn start(core: &mut cortex_m::Peripherals, timer: &pac::TIM2, emulated: bool) {
    EMULATED.store(emulated, Ordering::Relaxed);
    if emulated {
        timer.psc().reset();
        // SAFETY: every value of the reload register is allowed; the largest makes differences wrap at 2^32.
        timer.arr().write(|w| unsafe { w.bits(u32::MAX) });
        timer.cr1().write(|w| w.cen().enabled());
    } else {
        core.DCB.enable_trace();
        core.DWT.enable_cycle_counter();
    }
}

/// The free-running count; only wrapping differences mean something.
#[inline(always)]
pub(crate) fn now() -> u32 {
    if EMULATED.load(Ordering::Relaxed) {
        // SAFETY: a read of a counter nobody writes after `start`; it has no side effect.
        unsafe { &*pac::TIM2::ptr() }.cnt().read().bits()
    } else {
        cortex_m::peripheral::DWT::cycle_count()
    }
}
