//! The idle loop.

use core::sync::atomic::Ordering;

use foretorque_link::safety::Task;
use rtic::Mutex;

use super::{TICK, TICKED, TICKS};
use crate::arm::{BoardHousekeeping, BoardMailboxes};
use crate::board::{Board, Drive as _};
use crate::link::{self, RECEIVED};
use crate::log;
use crate::tick_timer;
use crate::watchdog::{TASKS, Watchdog};

/// Ticks between two lines of the log.
const LOG_EVERY: u32 = 1000;

/// The idle loop: log, store, watchdog.
pub struct Idle {
    pub(super) watchdog: Watchdog,
    pub(super) housekeeping: &'static mut BoardHousekeeping,
    pub(super) drain: Option<log::Drain>,
}

impl Idle {
    /// Never returns.
    #[inline(always)]
    pub fn run<B: Board>(
        &mut self,
        mailboxes: &mut impl Mutex<T = &'static mut BoardMailboxes>,
    ) -> ! {
        let (mut logged, mut ordered) = (0, false);
        loop {
            let ticks = TICKS.load(Ordering::Relaxed);
            if ticks.wrapping_sub(logged) >= LOG_EVERY {
                logged = ticks;
                let cost = link::receive_cost();
                defmt::info!(
                    "tick {=u32}: {=u32} bytes in at {=u32} counts (max {=u32}), {=u32} lost, {=u32} overruns, {=u32} ticks missed",
                    ticks,
                    RECEIVED.bytes.load(Ordering::Relaxed),
                    cost.mean,
                    cost.max,
                    RECEIVED.lost.load(Ordering::Relaxed),
                    RECEIVED.overruns.load(Ordering::Relaxed),
                    tick_timer::missed()
                );
            }
            B::Drive::report();
            if let Some(drain) = &self.drain {
                drain.empty();
            }
            TASKS.check_in(Task::Housekeeping);
            let fed = self.watchdog.feed_if_all_present();
            let housekeeping = &mut *self.housekeeping;
            ordered |= mailboxes.lock(|mailboxes| housekeeping.begin(&mut mailboxes.parameters));
            // An erase begins only after a complete check-in: it gives the watchdog a longer time.
            if ordered && (fed || !housekeeping.erases()) {
                ordered = false;
                let outcome = if housekeeping.erases() {
                    self.watchdog.patient(|| housekeeping.execute())
                } else {
                    housekeeping.execute()
                };
                mailboxes.lock(|mailboxes| housekeeping.finish(&mut mailboxes.parameters, outcome));
                // It replies to the host.
                rtic::pend(TICK);
            }
            // A tick that came since the beginning of this round may have left work: an interrupt that is only pending
            // ends the wait too, so none is slept through.
            cortex_m::interrupt::free(|_| {
                if !TICKED.swap(false, Ordering::Relaxed) {
                    cortex_m::asm::wfi();
                }
            });
        }
    }
}
