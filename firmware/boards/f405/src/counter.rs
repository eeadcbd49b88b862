//! Cost counter: processor cycles on silicon, executed instructions in the emulator.

use core::arch::asm;
use core::sync::atomic::{AtomicU8, Ordering};

use foretorque_link::session::Clock;
use foretorque_link::wire::CounterKind;
use stm32f4xx_hal::pac::TIM2;

const NONE: u8 = 0;
const CYCLES: u8 = 1;
const INSTRUCTIONS: u8 = 2;

/// Which counter works here.
static KIND: AtomicU8 = AtomicU8::new(NONE);

/// Instructions between the two reads of [`elapsed`]; far more than those of a read.
const LOOP_INSTRUCTIONS: u32 = 256;

/// Starts the cycle counter of the core.
pub fn start_cycles(core: &mut cortex_m::Peripherals) -> CounterKind {
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    KIND.store(CYCLES, Ordering::Relaxed);
    CounterKind::Cycles
}

/// Starts the emulator's counter. Its cycle counter reads zero, but TIM2 counts nanoseconds of virtual time, which under
/// `-icount shift=S` are executed instructions × 2^S; the prescaler takes the 2^S out.
///
/// Without `-icount` virtual time does not count instructions, and costs are not counted.
pub fn start_instructions(timer: &TIM2) -> CounterKind {
    timer.psc().reset();
    timer.cr1().write(|w| w.cen().enabled());
    let (first, second) = (elapsed(timer), elapsed(timer));
    let scale = first / LOOP_INSTRUCTIONS;
    if first != second || !scale.is_power_of_two() || scale > 1 << 10 {
        return CounterKind::None;
    }
    timer.psc().write(|w| w.psc().set((scale - 1) as u16));
    KIND.store(INSTRUCTIONS, Ordering::Relaxed);
    CounterKind::Instructions
}

/// The counter as the session reads it.
#[derive(Clone, Copy, Debug)]
pub struct Counter;

impl Clock for Counter {
    #[inline(always)]
    fn now(&self) -> u32 {
        now()
    }
}

/// The free-running count; only wrapping differences mean something.
#[inline(always)]
pub fn now() -> u32 {
    match KIND.load(Ordering::Relaxed) {
        CYCLES => cortex_m::peripheral::DWT::cycle_count(),
        // SAFETY: a read of a counter that is not written after the start; it has no side effect.
        INSTRUCTIONS => unsafe { &*TIM2::ptr() }.cnt().read().bits(),
        _ => 0,
    }
}

/// Counts that [`LOOP_INSTRUCTIONS`] instructions, two in a round of the loop, and one read of the timer take.
#[inline(never)]
fn elapsed(timer: &TIM2) -> u32 {
    let start = timer.cnt().read().bits();
    // SAFETY: counts a register down.
    unsafe {
        asm!(
            "2: subs {rounds}, #1",
            "bne 2b",
            rounds = inout(reg) LOOP_INSTRUCTIONS / 2 => _,
            options(nomem, nostack)
        )
    };
    timer.cnt().read().bits().wrapping_sub(start)
}
