//! The independent watchdog: fed only when every task has answered the roll.
//!
//! The emulator has no such watchdog; what is proved there is that the feeding stops when a task hangs.

use core::sync::atomic::{AtomicU32, Ordering};

use foretorque::edge::safety::RollCall;
use stm32f4xx_hal::pac::IWDG;

use crate::board;

/// Who has answered since the watchdog was fed last.
pub(crate) static ROLL: RollCall = RollCall::new();
/// Times that it was fed.
static FEEDS: AtomicU32 = AtomicU32::new(0);

/// Keys of RM0090 21.4.1.
const FEED: u16 = 0xAAAA;
const UNLOCK: u16 = 0x5555;
const START: u16 = 0xCCCC;

/// The watchdog; once started it runs until the next reset.
pub(crate) struct Watchdog(IWDG);

impl Watchdog {
    /// Starts it with [`board::WATCHDOG_RELOAD`].
    pub(crate) fn start(iwdg: IWDG) -> Self {
        let watchdog = Self(iwdg);
        watchdog.key(START);
        watchdog.key(UNLOCK);
        watchdog
            .0
            .pr()
            .write(|w| w.pr().set(board::WATCHDOG_PRESCALER));
        watchdog
            .0
            .rlr()
            .write(|w| w.rl().set(board::WATCHDOG_RELOAD));
        watchdog.feed();
        watchdog
    }

    /// Feeds it if everybody has answered since it was fed last.
    pub(crate) fn feed_if_all_present(&self) {
        if ROLL.complete() {
            self.feed();
        }
    }

    fn feed(&self) {
        self.key(FEED);
        FEEDS.store(
            FEEDS.load(Ordering::Relaxed).wrapping_add(1),
            Ordering::Relaxed,
        );
    }

    fn key(&self, key: u16) {
        // SAFETY: the key register takes any word and obeys these three.
        self.0.kr().write(|w| unsafe { w.bits(key) });
    }
}

/// Times that the watchdog was fed since boot. Wraps.
pub(crate) fn feeds() -> u32 {
    FEEDS.load(Ordering::Relaxed)
}
