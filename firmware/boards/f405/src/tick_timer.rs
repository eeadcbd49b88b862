//! SysTick at the period of the tick: it runs the tick, or supervises the link that paces it.
//!
//! In the emulator it stands still while the link paces: time there advances while the host computes.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use foretorque_link::wire::{Configuration, Pacing};

use crate::link::add;

/// A timer tick waits to be run.
static DUE: AtomicBool = AtomicBool::new(false);
/// Timer ticks that came while another one still waited.
static MISSED: AtomicU32 = AtomicU32::new(0);

pub(crate) struct TickTimer {
    timer: SYST,
    /// Counts per microsecond: an eighth of the processor clock, with which 24 bits reach the longest period.
    counts_per_us: u32,
    configuration: Option<Configuration>,
    /// Runs while the link paces, too.
    supervises: bool,
}

impl TickTimer {
    /// A timer that stands still.
    ///
    /// * `supervises` it runs while the link paces, too
    pub(crate) fn new(timer: SYST, cpu_hz: u32, supervises: bool) -> Self {
        Self {
            supervises,
            timer,
            counts_per_us: cpu_hz / 8_000_000,
            configuration: None,
        }
    }

    /// The timer runs in this configuration.
    pub(crate) fn runs(&self) -> bool {
        self.supervises
            || self
                .configuration
                .is_some_and(|c| c.pacing == Pacing::SysTick)
    }

    /// Starts, stops or changes the timer when the configuration has changed.
    pub(crate) fn configure(&mut self, wanted: Configuration) {
        if self.configuration == Some(wanted) {
            return;
        }
        self.configuration = Some(wanted);
        self.timer.disable_interrupt();
        self.timer.disable_counter();
        DUE.store(false, Ordering::Relaxed);
        if self.runs() {
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
        add(&MISSED, 1);
    }
}

/// Takes the timer tick that is due; false if none is.
pub(crate) fn take_due() -> bool {
    DUE.swap(false, Ordering::Relaxed)
}

/// Timer ticks that were never run. Wraps.
pub(crate) fn missed() -> u32 {
    MISSED.load(Ordering::Relaxed)
}
