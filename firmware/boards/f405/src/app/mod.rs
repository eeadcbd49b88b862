//! The schedule: who may interrupt whom. [`image!`](crate::image) binds the functions of this module to their interrupts.
//!
//! | priority | task | woken by | deadline |
//! |---|---|---|---|
//! | 5 | `byte`: one byte from or to the link | USART2 | 5 µs, the next byte at 2 Mbaud |
//! | 5 | `timer`: notes that a tick is due | SysTick | the period |
//! | 4 | frames of a drive bus, on the board that has one | CAN, UART4, USART6 | a frame, 47 µs |
//! | 3 | `tick`: decode, feed-forward, reply | the end of a frame, or `timer` | the period |
//! | 2 | `learn`: one learning sample a tick | `tick` | N/2 ticks; later is counted, and changes which set is in force |
//! | 0 | `idle`: log, banks, store, watchdog | every interrupt | the watchdog's time |
//!
//! Where a sample requests it, the reply waits until `learn` has used the learning sample and wakes `tick` again.
//!
//! `tick` reads the frames that [`FrameBound`] allows, and none while replies have no space. The rest stays in the ring until
//! the next timer tick, end of a frame, or end of the replies.
//!
//! `tick` and `learn` sit on the vectors of two external interrupts that no pin uses, and are pended by software.

mod start;

pub use start::{Started, Statics, start};

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use foretorque_link::safety::{SafetyReason, Task};
use foretorque_link::telemetry::CostMeter;
use foretorque_link::wire::{FrameBuffer, MAX_FRAME};
use rtic::Mutex;
use stm32f4xx_hal::pac::Interrupt;

use crate::arm::{BoardHousekeeping, BoardMailboxes, BoardSession, Learner};
use crate::board::{Board, Drive as _};
use crate::counter;
use crate::fault::{self, Reason};
use crate::frame_bound::FrameBound;
use crate::link::{self, RECEIVE_RING, RECEIVED, Receiver, Sender, TRANSMIT_RING, Wire};
use crate::log;
use crate::tick_timer::{self, TickTimer};
use crate::watchdog::{self, TASKS, Watchdog};

pub(crate) const TICK: Interrupt = Interrupt::EXTI1;
const LEARN: Interrupt = Interrupt::EXTI2;

/// Ticks run, for the log.
static TICKS: AtomicU32 = AtomicU32::new(0);
/// The tick's task has run since `idle` looked last.
static TICKED: AtomicBool = AtomicBool::new(false);

/// One interrupt of the link: wakes the tick's task at the end of a frame.
#[inline(always)]
pub fn byte(wire: &mut Wire) {
    if wire.interrupt() {
        rtic::pend(TICK);
    }
}

/// The interrupt of the timer: a tick is due.
#[inline(always)]
pub fn timer() {
    tick_timer::elapsed();
    rtic::pend(TICK);
}

/// The tick's task: session, link and drive.
pub struct Tick<B: Board> {
    session: &'static mut BoardSession,
    received: Receiver<RECEIVE_RING>,
    waiting: Sender<TRANSMIT_RING>,
    out: &'static mut FrameBuffer,
    timer: TickTimer,
    drive: B::Drive,
    brake_open: bool,
    kept: SafetyReason,
    losses: u32,
    missed: u32,
    bound: FrameBound,
    latency: CostMeter,
}

impl<B: Board> Tick<B> {
    /// Runs what is due: ticks, commands, replies.
    #[inline(always)]
    pub fn run(&mut self, mailboxes: &mut impl Mutex<T = &'static mut BoardMailboxes>) {
        mailboxes.lock(|mailboxes| self.run_locked(mailboxes));
        // Without a learning sample too: the learner checks in.
        rtic::pend(LEARN);
        let session = &mut *self.session;
        self.timer.configure(session.configuration());
        session.note_line(link::receive_cost(), self.latency.cost());
        session.note_feeds(watchdog::feeds());
        // Losses below the frames since the last tick. Counters wrap; only their difference counts.
        session.note_overruns(newly(&mut self.losses, link::losses()));
        TICKS.store(session.feed_forward().state().tick, Ordering::Relaxed);
        TICKED.store(true, Ordering::Relaxed);
        TASKS.check_in(Task::Tick);
        if session.link_alive() {
            TASKS.check_in(Task::Link);
        }
    }

    #[inline(always)]
    fn run_locked(&mut self, mailboxes: &mut BoardMailboxes) {
        self.drive.watch(self.session);
        if tick_timer::take_due() {
            // Time that passed before this period.
            let missed = newly(&mut self.missed, tick_timer::missed());
            self.session.note_missed(missed);
            self.bound.refill(self.session.configuration().period_us);
            self.session
                .timer_tick(mailboxes, self.out, &mut self.drive);
        }
        self.session.poll_parameters(mailboxes, self.out);
        self.put_out(mailboxes, false);
        let timer = self.timer.runs();
        while self.waiting.free() >= FrameBuffer::CAPACITY && self.out.has_space() {
            let mut frame = [0; MAX_FRAME];
            let received = &mut self.received;
            let count = self.bound.take(timer, &mut frame, || received.take());
            if count == 0 {
                break;
            }
            // Reports of the drives from before this frame belong to its tick.
            self.drive.watch(self.session);
            let bytes = frame.get(..count).unwrap_or_default();
            self.session
                .receive(bytes, mailboxes, self.out, &mut self.drive);
            self.put_out(mailboxes, true);
        }
    }

    /// Drives the outputs by the result, then sends the replies.
    #[inline(never)]
    fn put_out(&mut self, mailboxes: &BoardMailboxes, answers: bool) {
        let session = &mut *self.session;
        // The outputs follow before the host reads of them.
        self.drive.follow(session);
        let open = session.brake_released();
        if self.brake_open != open {
            self.brake_open = open;
            fault::release_brake::<B>(open);
        }
        let kept = session.kept_fault();
        if self.kept != kept {
            self.kept = kept;
            fault::keep_latched(kept);
        }
        if session.reboot_wanted() {
            fault::leave::<B>(Reason::Requested, 0);
        }
        // A reply that waits for the learner is sent when that has woken this task again.
        if self.out.is_empty() || mailboxes.learner.holds_reply() {
            return;
        }
        if !link::send(&mut self.waiting, self.out.as_bytes()) {
            session.note_reply_lost();
        } else if answers {
            self.latency.note(link::since_frame());
        }
        self.out.clear();
    }
}

/// Counts since the last call.
fn newly(before: &mut u32, now: u32) -> u32 {
    now.wrapping_sub(core::mem::replace(before, now))
}

/// The learner's task: uses every learning sample that waits.
#[inline(always)]
pub fn learn(learner: &mut Learner, mailboxes: &mut impl Mutex<T = &'static mut BoardMailboxes>) {
    while let Some(sample) = mailboxes.lock(|mailboxes| mailboxes.learner.begin(learner)) {
        let start = counter::now();
        learner.study(&sample);
        let cost = counter::now().wrapping_sub(start);
        mailboxes.lock(|mailboxes| mailboxes.learner.finish(learner, cost));
    }
    if mailboxes.lock(|mailboxes| mailboxes.learner.release_reply()) {
        rtic::pend(TICK);
    }
    TASKS.check_in(Task::Learner);
}

/// Ticks between two lines of the log.
const LOG_EVERY: u32 = 1000;

/// The idle loop: log, store, watchdog.
pub struct Idle {
    watchdog: Watchdog,
    housekeeping: &'static mut BoardHousekeeping,
    drain: Option<log::Drain>,
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
            // A long order begins only after a complete check-in: it gives the watchdog a longer time.
            if ordered && (fed || !housekeeping.takes_long()) {
                ordered = false;
                let outcome = if housekeeping.takes_long() {
                    self.watchdog.with_longest_time(|| housekeeping.execute())
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

/// The firmware of a board, for the arm of [`arm`](crate::arm): its interrupts and fault handlers.
#[macro_export]
macro_rules! image {
    ($board:ty) => {
        $crate::fault_handlers!($board);

        #[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
        mod app {
            use $crate::app::{Idle, Statics, Tick, byte, learn, start, timer};
            use $crate::arm::{BoardMailboxes, Learner};
            use $crate::link::Wire;

            #[shared]
            struct Shared {
                mailboxes: &'static mut BoardMailboxes,
            }

            #[local]
            struct Local {
                wire: Wire,
                tick: Tick<$board>,
                learner: &'static mut Learner,
                idle: Idle,
            }

            #[init(local = [statics: Statics = Statics::empty()])]
            fn init(cx: init::Context) -> (Shared, Local) {
                let started = start::<$board>(cx.device, cx.core, cx.local.statics);
                let local = Local {
                    wire: started.wire,
                    tick: started.tick,
                    learner: started.learner,
                    idle: started.idle,
                };
                let mailboxes = started.mailboxes;
                (Shared { mailboxes }, local)
            }

            #[task(binds = USART2, priority = 5, local = [wire])]
            fn on_byte(cx: on_byte::Context) {
                byte(cx.local.wire);
            }

            #[task(binds = SysTick, priority = 5)]
            fn on_timer(_: on_timer::Context) {
                timer();
            }

            #[task(binds = EXTI1, priority = 3, local = [tick], shared = [mailboxes])]
            fn on_tick(mut cx: on_tick::Context) {
                cx.local.tick.run(&mut cx.shared.mailboxes);
            }

            #[task(binds = EXTI2, priority = 2, local = [learner], shared = [mailboxes])]
            fn on_learn(mut cx: on_learn::Context) {
                learn(cx.local.learner, &mut cx.shared.mailboxes);
            }

            #[idle(local = [idle], shared = [mailboxes])]
            fn on_idle(mut cx: on_idle::Context) -> ! {
                cx.local.idle.run::<$board>(&mut cx.shared.mailboxes)
            }
        }
    };
}
