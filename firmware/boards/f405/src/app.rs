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
//! the next timer tick or byte.
//!
//! `tick` and `learn` sit on the vectors of two external interrupts that no pin uses, and are pended by software.

use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use foretorque::arm::Arm;
use foretorque::learning::Learner;
use foretorque_link::safety::{SafetyReason, Task};
use foretorque_link::session::{BoardDescription, Mailboxes};
use foretorque_link::store::Store;
use foretorque_link::telemetry::CostMeter;
use foretorque_link::wire::size::LinkCapacity;
use foretorque_link::wire::{Capabilities, ClockSource, FrameBuffer, MAX_FRAME};
use heapless::spsc::Queue;
use rtic::Mutex;
use stm32f4xx_hal::pac::{self, Interrupt};
use stm32f4xx_hal::prelude::*;

use crate::arm::{BoardHousekeeping, BoardSession};
use crate::board::{Board, Drive as _, Ports};
use crate::chip::LINK_BYTES_S;
use crate::clock;
use crate::counter::{self, Counter};
use crate::fault::{self, Reason};
use crate::frame_bound::FrameBound;
use crate::key_slot;
use crate::link::{self, RECEIVE_RING, RECEIVED, TRANSMIT_RING, Wire};
use crate::log;
use crate::ring::{self, Receiver, Sender};
use crate::statics::{init_learner, init_session};
use crate::store_flash::{Registers, StoreFlash};
use crate::tick_timer::{self, TickTimer};
use crate::watchdog::{self, TASKS, Watchdog};

/// Interrupt of the tick's task.
pub(crate) const TICK: Interrupt = Interrupt::EXTI1;
/// Interrupt of the learner's task.
const LEARN: Interrupt = Interrupt::EXTI2;
/// Ticks between two lines of the log.
const LOG_EVERY: u32 = 1000;

/// Ticks run, for the log.
static TICKS: AtomicU32 = AtomicU32::new(0);
/// The tick's task has run since `idle` looked last.
static TICKED: AtomicBool = AtomicBool::new(false);

/// Static memory of the large parts.
pub struct Statics<A: Arm<N, P>, const N: usize, const P: usize> {
    mailboxes: MaybeUninit<Mailboxes<N, P>>,
    housekeeping: BoardHousekeeping<A, N, P>,
    session: MaybeUninit<BoardSession<A, N, P>>,
    learner: MaybeUninit<Learner<A, N, P>>,
    receive_ring: Queue<u8, RECEIVE_RING>,
    transmit_ring: Queue<u8, TRANSMIT_RING>,
    out: FrameBuffer,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Statics<A, N, P> {
    /// Nothing in it.
    pub const fn empty() -> Self {
        Self {
            mailboxes: MaybeUninit::uninit(),
            housekeeping: BoardHousekeeping::empty(),
            session: MaybeUninit::uninit(),
            learner: MaybeUninit::uninit(),
            receive_ring: Queue::new(),
            transmit_ring: Queue::new(),
            out: FrameBuffer::new(),
        }
    }
}

/// The parts of a started board, one for each task.
pub struct Started<B: Board, A: Arm<N, P>, const N: usize, const P: usize> {
    /// Shared by tick, learner and idle loop.
    pub mailboxes: &'static mut Mailboxes<N, P>,
    /// Of the link's interrupt.
    pub wire: Wire,
    /// Of the tick.
    pub tick: Tick<B, A, N, P>,
    /// Of the learner.
    pub learner: &'static mut Learner<A, N, P>,
    /// Of the idle loop.
    pub idle: Idle<A, N, P>,
}

/// Starts clocks, pins, session, learner and link; leaves by a reset if a constant of the board cannot work.
#[inline(always)]
pub fn start<B: Board, A: Arm<N, P>, const N: usize, const P: usize>(
    chip: pac::Peripherals,
    mut core: cortex_m::Peripherals,
    statics: &'static mut Statics<A, N, P>,
) -> Started<B, A, N, P> {
    let (reason, place) = fault::take();
    let reset_reason = fault::reset_reason(reason, &chip.RCC);
    let kept = fault::latched();
    let clocks = clock::start(&chip.RCC, &chip.FLASH, B::CRYSTAL_HZ);
    let emulated = clocks.source == ClockSource::Virtual;
    let seed = key_slot::seed(&chip.RNG, &chip.RCC, emulated);
    let status = clock::status(&clocks, &chip.FLASH);

    chip.RCC.apb1enr().modify(|_, w| {
        w.usart2en()
            .enabled()
            .usart3en()
            .enabled()
            .tim2en()
            .enabled()
    });
    let mut rcc = chip.RCC.constrain();
    let ports = Ports {
        a: chip.GPIOA,
        b: chip.GPIOB,
        c: chip.GPIOC,
    };
    B::start_pins(ports, &mut rcc);
    let Some(mut drive) = B::Drive::<A, N, P>::start(&clocks) else {
        fault::leave::<B>(Reason::Setup, line!());
    };

    let (counter, counter_hz) = if emulated {
        (counter::start_instructions(&chip.TIM2), 0)
    } else {
        (counter::start_cycles(&mut core), clocks.cpu_hz)
    };
    let booting = counter::now();
    let drain = emulated.then(|| log::Drain::start(chip.USART3));
    defmt::info!(
        "boot: {=str}, clock {} at {=u32} Hz, started by {}, left before by {} at {=u32:#x}",
        B::NAME,
        clocks.source,
        clocks.cpu_hz,
        reset_reason,
        reason,
        place
    );

    let description = BoardDescription {
        capabilities: Capabilities::LEARNING
            | Capabilities::TIMER
            | Capabilities::STORE
            | Capabilities::WATCHDOG
            | Capabilities::REBOOT,
        counter,
        counter_hz,
        reset_reason,
        kept_fault: kept,
        link: LinkCapacity::stream(LINK_BYTES_S),
        write_key: key_slot::write_key(),
        seed,
        chip: status,
        ..BoardDescription::plain(Counter)
    };
    let Some(session) = init_session(&mut statics.session, description) else {
        fault::leave::<B>(Reason::Setup, line!());
    };
    let mailboxes = statics.mailboxes.write(Mailboxes::new());
    let housekeeping = &mut statics.housekeeping;
    housekeeping.start(Some(Store::new(StoreFlash::new(Registers(chip.FLASH)))));
    let stored = session.boot_from(housekeeping, mailboxes);
    defmt::info!("store: {}", stored);
    let period_s = session.configuration().period_us as f32 * 1e-6;
    let prior = &session.feed_forward().state().active;
    let Some(learner) = init_learner(&mut statics.learner, period_s, prior) else {
        fault::leave::<B>(Reason::Setup, line!());
    };
    if let Some(joint) = B::OWN_JOINT {
        learner.learn_only(joint);
    }
    let mut timer = TickTimer::new(core.SYST, clocks.cpu_hz, !emulated);
    timer.configure(session.configuration());

    let (receive_in, received) = ring::split(&mut statics.receive_ring);
    let (mut waiting, transmit_out) = ring::split(&mut statics.transmit_ring);
    let wire = Wire::start(chip.USART2, clocks.apb1_hz, receive_in, transmit_out);
    let out = &mut statics.out;
    let boot_counts = counter::now().wrapping_sub(booting);
    session.note_boot(boot_counts);
    drive.watch(session);
    session.send_hello(out);
    link::send(&mut waiting, out.as_bytes());
    out.clear();
    defmt::info!(
        "hello: arm {=str} {=u32:#x}, {} counter, {}, {}, {=u32} counts ({=u32} us) from clock to hello",
        A::NAME,
        A::HASH,
        counter,
        session.configuration(),
        session.safety(),
        boot_counts,
        boot_counts
            .checked_div(counter_hz / 1_000_000)
            .unwrap_or_default()
    );
    Started {
        mailboxes,
        wire,
        tick: Tick {
            session,
            received,
            waiting,
            out,
            timer,
            drive,
            brake_open: false,
            kept,
            losses: 0,
            bound: FrameBound::default(),
            latency: CostMeter::new(),
        },
        learner,
        idle: Idle {
            watchdog: Watchdog::start(chip.IWDG),
            housekeeping,
            drain,
        },
    }
}

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
pub struct Tick<B: Board, A: Arm<N, P>, const N: usize, const P: usize> {
    session: &'static mut BoardSession<A, N, P>,
    received: Receiver<RECEIVE_RING>,
    waiting: Sender<TRANSMIT_RING>,
    out: &'static mut FrameBuffer,
    timer: TickTimer,
    drive: B::Drive<A, N, P>,
    brake_open: bool,
    kept: SafetyReason,
    losses: u32,
    bound: FrameBound,
    latency: CostMeter,
}

impl<B: Board, A: Arm<N, P>, const N: usize, const P: usize> Tick<B, A, N, P> {
    /// Runs what is due: ticks, commands, replies.
    #[inline(always)]
    pub fn run(&mut self, mailboxes: &mut impl Mutex<T = &'static mut Mailboxes<N, P>>) {
        mailboxes.lock(|mailboxes| self.run_locked(mailboxes));
        // Without a learning sample too: the learner checks in.
        rtic::pend(LEARN);
        let Self {
            session,
            timer,
            losses,
            latency,
            ..
        } = self;
        timer.configure(session.configuration());
        session.note_line(link::receive_cost(), latency.cost());
        session.note_feeds(watchdog::feeds());
        // Losses below the frames since the last tick. Counters wrap; only their difference counts.
        let now = link::losses().wrapping_add(tick_timer::missed());
        while *losses != now {
            *losses = losses.wrapping_add(1);
            session.note_overrun();
        }
        TICKS.store(session.feed_forward().state().tick, Ordering::Relaxed);
        TICKED.store(true, Ordering::Relaxed);
        TASKS.check_in(Task::Tick);
        if session.link_alive() {
            TASKS.check_in(Task::Link);
        }
    }

    #[inline(always)]
    fn run_locked(&mut self, mailboxes: &mut Mailboxes<N, P>) {
        self.drive.watch(self.session);
        if tick_timer::take_due() {
            self.bound.refill(self.session.configuration().period_us);
            self.session
                .timer_tick(mailboxes, self.out, self.drive.own());
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
            let bytes = frame.get(..count).unwrap_or_default();
            self.session
                .receive(bytes, mailboxes, self.out, self.drive.own());
            self.put_out(mailboxes, true);
        }
    }

    /// Drives the outputs by the result, then sends the replies.
    #[inline(never)]
    fn put_out(&mut self, mailboxes: &Mailboxes<N, P>, answers: bool) {
        let Self {
            session,
            waiting,
            out,
            drive,
            brake_open,
            kept,
            latency,
            ..
        } = self;
        // The outputs follow before the host reads of them.
        drive.follow(session);
        let open = session.brake_released();
        if *brake_open != open {
            *brake_open = open;
            fault::release_brake::<B>(open);
        }
        let latched = session.latched_fault();
        if *kept != latched {
            *kept = latched;
            fault::keep_latched(latched);
        }
        if session.reboot_wanted() {
            fault::leave::<B>(Reason::Requested, 0);
        }
        // A reply that waits for the learner is sent when that has woken this task again.
        if out.is_empty() || mailboxes.learner.holds_reply() {
            return;
        }
        if !link::send(waiting, out.as_bytes()) {
            session.note_reply_lost();
        } else if answers {
            latency.note(link::since_frame());
        }
        out.clear();
    }
}

/// The learner's task: uses every learning sample that waits.
#[inline(always)]
pub fn learn<A: Arm<N, P>, const N: usize, const P: usize>(
    learner: &mut Learner<A, N, P>,
    mailboxes: &mut impl Mutex<T = &'static mut Mailboxes<N, P>>,
) {
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

/// The idle loop: log, store, watchdog.
pub struct Idle<A: Arm<N, P>, const N: usize, const P: usize> {
    watchdog: Watchdog,
    housekeeping: &'static mut BoardHousekeeping<A, N, P>,
    drain: Option<log::Drain>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Idle<A, N, P> {
    /// Never returns.
    #[inline(always)]
    pub fn run<B: Board>(
        &mut self,
        mailboxes: &mut impl Mutex<T = &'static mut Mailboxes<N, P>>,
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
            B::Drive::<A, N, P>::report();
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

/// The firmware of a board for an arm of `N` joints and `P` base parameters: its interrupts and fault handlers.
#[macro_export]
macro_rules! image {
    ($board:ty, $arm:ty, $n:expr, $p:expr) => {
        $crate::fault_handlers!($board);

        #[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
        mod app {
            use foretorque::learning::Learner;
            use foretorque_link::session::Mailboxes;
            use $crate::app::{Idle, Started, Statics, Tick, byte, learn, start, timer};
            use $crate::link::Wire;

            #[shared]
            struct Shared {
                mailboxes: &'static mut Mailboxes<{ $n }, { $p }>,
            }

            #[local]
            struct Local {
                wire: Wire,
                tick: Tick<$board, $arm, { $n }, { $p }>,
                learner: &'static mut Learner<$arm, { $n }, { $p }>,
                idle: Idle<$arm, { $n }, { $p }>,
            }

            #[init(local = [statics: Statics<$arm, { $n }, { $p }> = Statics::empty()])]
            fn init(cx: init::Context) -> (Shared, Local) {
                let Started {
                    mailboxes,
                    wire,
                    tick,
                    learner,
                    idle,
                } = start::<$board, $arm, { $n }, { $p }>(cx.device, cx.core, cx.local.statics);
                let local = Local {
                    wire,
                    tick,
                    learner,
                    idle,
                };
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
