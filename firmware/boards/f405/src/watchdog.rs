//! Independent watchdog, fed only after every task has checked in.
//!
//! The emulator has no such watchdog; what is proved there is that the feeding stops when a task hangs.

use core::sync::atomic::{AtomicU32, Ordering};

use foretorque_link::safety::TaskCheckIn;
use stm32f4xx_hal::pac::IWDG;

use crate::chip;
use crate::link::add;

/// Who has answered since the watchdog was fed last.
pub(crate) static TASKS: TaskCheckIn = TaskCheckIn::new();
static FEEDS: AtomicU32 = AtomicU32::new(0);

/// Keys of RM0090 21.4.1.
const FEED: u16 = 0xAAAA;
const UNLOCK: u16 = 0x5555;
const START: u16 = 0xCCCC;
/// Division by 256 and all counts: 22 to 60 s.
const LONGEST_PRESCALER: u8 = 6;
const LONGEST_RELOAD: u16 = 0xFFF;
/// Reads of the busy flags, 75 ms and more: five periods of 17 kHz divided by 256, at six cycles a read and 168 MHz.
const CHANGE_POLLS: u32 = 0x1F_FFFF;

/// The watchdog; once started it runs until the next reset.
pub(crate) struct Watchdog(IWDG);

impl Watchdog {
    /// Starts it with [`chip::WATCHDOG_RELOAD`].
    pub(crate) fn start(iwdg: IWDG) -> Self {
        let watchdog = Self(iwdg);
        watchdog.key(START);
        watchdog.set(chip::WATCHDOG_PRESCALER, chip::WATCHDOG_RELOAD);
        watchdog
    }

    /// Gives `work` the longest time there is: erasing the flash stalls every task for seconds, and only a board without
    /// torque does it. To be called after [`feed_if_all_present`](Self::feed_if_all_present) has fed.
    pub(crate) fn with_longest_time<T>(&self, work: impl FnOnce() -> T) -> T {
        self.set(LONGEST_PRESCALER, LONGEST_RELOAD);
        let done = work();
        self.set(chip::WATCHDOG_PRESCALER, chip::WATCHDOG_RELOAD);
        done
    }

    /// Changes the time and begins it anew.
    fn set(&self, prescaler: u8, reload: u16) {
        // The registers take a change when the one before has reached the slow oscillator (RM0090 21.4.4): five of its
        // periods, the divided ones as ST's own driver has it. Should it stand still, so does the watchdog.
        let _ = (0..CHANGE_POLLS).any(|_| self.0.sr().read().bits() == 0);
        self.key(UNLOCK);
        self.0.pr().write(|w| w.pr().set(prescaler));
        self.0.rlr().write(|w| w.rl().set(reload));
        let _ = (0..CHANGE_POLLS).any(|_| self.0.sr().read().bits() == 0);
        self.feed();
    }

    /// Feeds it if every task has checked in since it was fed last; false if not.
    pub(crate) fn feed_if_all_present(&self) -> bool {
        let complete = TASKS.complete();
        if complete {
            self.feed();
        }
        complete
    }

    fn feed(&self) {
        self.key(FEED);
        add(&FEEDS, 1);
    }

    fn key(&self, key: u16) {
        // SAFETY: the key register takes any word, and these three have an effect.
        self.0.kr().write(|w| unsafe { w.bits(key) });
    }
}

/// Times that the watchdog was fed since boot. Wraps.
pub(crate) fn feeds() -> u32 {
    FEEDS.load(Ordering::Relaxed)
}
