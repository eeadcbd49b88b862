//! SysTick at the period of the tick, whoever paces it: the tick itself, or the watch for silence while the link paces.
//!
//! Not in the emulator while the link paces: its time leaps ahead while it waits for the host, and would end the torque.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use foretorque_link::wire::{Configuration, Pacing};

/// A timer tick waits to be run.
static DUE: AtomicBool = AtomicBool::new(false);
/// Timer ticks that came while another one still waited.
static MISSED: AtomicU32 = AtomicU32::new(0);

/// The timer and the configuration it follows.
pub(crate) struct Pace {
    timer: SYST,
    /// Counts per microsecond: an eighth of the processor clock, with which 24 bits reach the longest period.
    counts_per_us: u32,
    follows: Option<Configuration>,
    /// Runs while the link paces, too.
    watches: bool,
}

impl Pace {
    /// A timer that stands still.
    ///
    /// * `watches` it shall run while the link paces, too
    pub(crate) fn new(timer: SYST, cpu_hz: u32, watches: bool) -> Self {
        Self {
            watches,
            timer,
            counts_per_us: cpu_hz / 8_000_000,
            follows: None,
        }
    }

    /// Starts, stops or changes the timer when the configuration has changed.
    pub(crate) fn follow(&mut self, wanted: Configuration) {
        if self.follows == Some(wanted) {
            return;
        }
        self.follows = Some(wanted);
        self.timer.disable_interrupt();
        self.timer.disable_counter();
        DUE.store(false, Ordering::Relaxed);
        if wanted.pacing == Pacing::SysTick || self.watches {
            self.timer.set_clock_source(SystClkSource::External);
            self.timer
                .set_reload(wanted.period_us * self.counts_per_us - 1);
            self.timer.clear_current();
            self.timer.enable_interrupt();
            self.timer.enable_counter();
        }
    }
}

/// The timer's interrupt.
pub(crate) fn elapsed() {
    if DUE.swap(true, Ordering::Relaxed) {
        MISSED.store(
            MISSED.load(Ordering::Relaxed).wrapping_add(1),
            Ordering::Relaxed,
        );
    }
}

/// A timer tick was due; now it is taken.
pub(crate) fn take_due() -> bool {
    DUE.swap(false, Ordering::Relaxed)
}

/// Timer ticks that were never run. Wraps.
pub(crate) fn missed() -> u32 {
    MISSED.load(Ordering::Relaxed)
}
