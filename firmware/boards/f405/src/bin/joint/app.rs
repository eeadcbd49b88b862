//! The schedule: who may interrupt whom.
//!
//! | priority | task | woken by | deadline |
//! |---|---|---|---|
//! | 4 | `byte`: one byte from or to the link | USART2 | 5 µs, the next byte at 2 Mbaud |
//! | 4 | `timer`: notes that a tick is due | SysTick | the period |
//! | 3 | `tick`: decode, feed-forward, reply | the end of a frame, or `timer` | the period |
//! | 2 | `learn`: one lesson a tick | `tick` | N/2 ticks; later is counted, and changes which set is in force |
//! | 0 | `idle`: log, store, watchdog | every interrupt | the watchdog's time |
//!
//! The answer of a tick whose sample asks for it is kept until `learn` is done with its lesson and wakes `tick` once more: a
//! host that keeps no time cannot be too fast for the learner then.
//!
//! `tick` and `learn` sit on the vectors of two external interrupts that no pin uses, and are pended by software.

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use core::mem::MaybeUninit;
    use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

    use foretorque::arm::Arm as _;
    use foretorque_link::safety::{SafetyReason, Task};
    use foretorque_link::session::{BoardDescription, Desk};
    use foretorque_link::store::Store;
    use foretorque_link::telemetry::CostMeter;
    use foretorque_link::wire::{Capabilities, FrameBuffer};
    use heapless::spsc::{Consumer, Producer, Queue};
    use stm32f4xx_hal::pac::Interrupt;
    use stm32f4xx_hal::prelude::*;

    use crate::board::{self, Arm, JOINTS, PARAMETERS};
    use crate::clock::{self, ClockSource};
    use crate::counter::{self, Counter};
    use crate::drive::Drive;
    use crate::fault::{self, Reason};
    use crate::link::{self, RECEIVE_RING, RECEIVED, TRANSMIT_RING, Wire};
    use crate::log;
    use crate::pace::{self, Pace};
    use crate::rooms::{BoardLearner, BoardSession, furnish, open};
    use crate::secret;
    use crate::store_flash::StoreFlash;
    use crate::watchdog::{self, ROLL, Watchdog};

    /// Ticks between two lines of the log.
    const LOG_EVERY: u32 = 1000;
    /// Bytes handed to the session at once.
    const CHUNK: usize = 64;

    /// Ticks run, for the log.
    static TICKS: AtomicU32 = AtomicU32::new(0);
    /// The tick's task has run since `idle` looked last.
    static TICKED: AtomicBool = AtomicBool::new(false);

    #[shared]
    struct Shared {
        desk: &'static mut Desk<JOINTS, PARAMETERS>,
    }

    #[local]
    struct Local {
        wire: Wire,
        session: &'static mut BoardSession,
        received: Consumer<'static, u8>,
        waiting: Producer<'static, u8>,
        out: FrameBuffer,
        pace: Pace,
        drive: Drive,
        kept: SafetyReason,
        watchdog: Watchdog,
        store: Store<StoreFlash>,
        learner: &'static mut BoardLearner,
        drain: Option<log::Drain>,
    }

    #[init(local = [
        desk_room: MaybeUninit<Desk<JOINTS, PARAMETERS>> = MaybeUninit::uninit(),
        session_room: MaybeUninit<BoardSession> = MaybeUninit::uninit(),
        learner_room: MaybeUninit<BoardLearner> = MaybeUninit::uninit(),
        receive_ring: Queue<u8, RECEIVE_RING> = Queue::new(),
        transmit_ring: Queue<u8, TRANSMIT_RING> = Queue::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let (reason, place) = fault::take();
        let reset_reason = fault::reset_reason(reason, &cx.device.RCC);
        let kept = fault::latched();
        let clocks = clock::start(&cx.device.RCC, &cx.device.FLASH);
        let seed = secret::seed(&cx.device.RNG, &cx.device.RCC);
        let emulated = clocks.source == ClockSource::Emulated;

        cx.device.RCC.apb1enr().modify(|_, w| {
            w.usart2en()
                .enabled()
                .usart3en()
                .enabled()
                .tim2en()
                .enabled()
        });
        let mut rcc = cx.device.RCC.constrain();
        let ports = board::Ports {
            a: cx.device.GPIOA,
            b: cx.device.GPIOB,
        };
        board::start_pins(ports, &mut rcc);
        let Some(mut drive) = Drive::start() else {
            fault::leave(Reason::Setup, line!());
        };

        let mut core = cx.core;
        let (counter, counter_hz) = if emulated {
            (counter::start_instructions(&cx.device.TIM2), 0)
        } else {
            (counter::start_cycles(&mut core), clocks.cpu_hz)
        };
        let booting = counter::now();
        let drain = emulated.then(|| log::Drain::start(cx.device.USART3));
        defmt::info!(
            "boot: {=str}, clock {} at {=u32} Hz, started by {}, left before by {} at {=u32:#x}",
            board::NAME,
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
            link_baud: board::LINK_BAUD,
            write_key: secret::write_key(),
            seed,
            ..BoardDescription::plain(Counter)
        };
        let Some(session) = open(cx.local.session_room, description) else {
            fault::leave(Reason::Setup, line!());
        };
        let desk = cx.local.desk_room.write(Desk::new());
        let mut store = Store::new(StoreFlash::new(cx.device.FLASH));
        let stored = session.boot_from(&mut store, desk);
        defmt::info!("store: {}", stored);
        let period_s = session.configuration().period_us as f32 * 1e-6;
        let prior = &session.feed_forward().state().active;
        let Some(learner) = furnish(cx.local.learner_room, period_s, prior) else {
            fault::leave(Reason::Setup, line!());
        };
        if let Some(joint) = board::OWN_JOINT {
            learner.learn_only(joint);
        }
        let mut pace = Pace::new(core.SYST, clocks.cpu_hz, !emulated);
        pace.follow(session.configuration());

        let (receive_in, received) = cx.local.receive_ring.split();
        let (mut waiting, transmit_out) = cx.local.transmit_ring.split();
        let wire = Wire::start(cx.device.USART2, clocks.apb1_hz, receive_in, transmit_out);
        let mut out = FrameBuffer::new();
        let boot_counts = counter::now().wrapping_sub(booting);
        session.note_boot(boot_counts);
        drive.watch(session);
        session.greet(&mut out);
        link::send(&mut waiting, out.as_bytes());
        out.clear();
        defmt::info!(
            "hello: arm {=str} {=u32:#x}, {} counter, {}, {}, {=u32} counts ({=u32} us) from clock to hello",
            Arm::NAME,
            Arm::HASH,
            counter,
            session.configuration(),
            session.safety(),
            boot_counts,
            boot_counts
                .checked_div(counter_hz / 1_000_000)
                .unwrap_or_default()
        );
        (
            Shared { desk },
            Local {
                wire,
                session,
                received,
                waiting,
                out,
                pace,
                drive,
                kept,
                watchdog: Watchdog::start(cx.device.IWDG),
                store,
                learner,
                drain,
            },
        )
    }

    #[task(binds = USART2, priority = 4, local = [wire])]
    fn byte(cx: byte::Context) {
        if cx.local.wire.interrupt() {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = SysTick, priority = 4)]
    fn timer(_: timer::Context) {
        pace::elapsed();
        rtic::pend(Interrupt::EXTI1);
    }

    #[task(
        binds = EXTI1,
        priority = 3,
        local = [
            session, received, waiting, out, pace, drive, kept,
            troubles: u32 = 0,
            latency: CostMeter = CostMeter::new(),
        ],
        shared = [desk]
    )]
    fn tick(mut cx: tick::Context) {
        let tick::LocalResources {
            session,
            received,
            waiting,
            out,
            pace,
            drive,
            kept,
            troubles,
            latency,
            ..
        } = cx.local;
        cx.shared.desk.lock(|desk| {
            drive.watch(session);
            if pace::take_due() {
                session.timer_tick_with(desk, out, drive.own());
            }
            session.collect(desk, out);
            loop {
                let mut chunk = [0; CHUNK];
                let mut count = 0;
                for slot in &mut chunk {
                    let Some(byte) = received.dequeue() else {
                        break;
                    };
                    *slot = byte;
                    count += 1;
                }
                let bytes = chunk.get(..count).unwrap_or_default();
                session.receive_with(bytes, desk, out, drive.own());
                // Before the host reads of it: what is told is done.
                drive.follow(session);
                let latched = session.latched_fault();
                if *kept != latched {
                    *kept = latched;
                    fault::keep_latched(latched);
                }
                if session.reboot_wanted() {
                    fault::leave(Reason::Asked, 0);
                }
                // An answer that waits for the learner is sent when that has woken this task again.
                let waits = desk.holds_answer();
                if !out.is_empty() {
                    if !waits && !link::send(waiting, out.as_bytes()) {
                        session.note_reply_lost();
                    } else if count > 0 {
                        latency.note(link::since_frame());
                    }
                }
                if !waits {
                    out.clear();
                }
                if count == 0 {
                    break;
                }
            }
        });
        // Whether there are lessons or not: the learner shall say that it lives.
        rtic::pend(Interrupt::EXTI2);
        pace.follow(session.configuration());
        session.note_line(link::receive_cost(), latency.cost());
        session.note_feeds(watchdog::feeds());
        // What went wrong below the frames since the last tick. Counters wrap; only their difference counts.
        let now = link::troubles().wrapping_add(pace::missed());
        while *troubles != now {
            *troubles = troubles.wrapping_add(1);
            session.note_overrun();
        }
        TICKS.store(session.feed_forward().state().tick, Ordering::Relaxed);
        TICKED.store(true, Ordering::Relaxed);
        ROLL.present(Task::Tick);
        if session.link_alive() {
            ROLL.present(Task::Link);
        }
    }

    #[task(binds = EXTI2, priority = 2, local = [learner], shared = [desk])]
    fn learn(mut cx: learn::Context) {
        let learner = cx.local.learner;
        while let Some(lesson) = cx.shared.desk.lock(|desk| desk.begin(learner)) {
            let start = counter::now();
            learner.study(&lesson);
            let cost = counter::now().wrapping_sub(start);
            cx.shared.desk.lock(|desk| desk.finish(learner, cost));
        }
        if cx.shared.desk.lock(|desk| desk.release_answer()) {
            rtic::pend(Interrupt::EXTI1);
        }
        ROLL.present(Task::Learner);
    }

    #[idle(local = [drain, watchdog, store], shared = [desk])]
    fn idle(mut cx: idle::Context) -> ! {
        let mut logged = 0;
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
                    pace::missed()
                );
            }
            Drive::report();
            if let Some(drain) = cx.local.drain {
                drain.empty();
            }
            if let Some(mut job) = cx.shared.desk.lock(|desk| desk.store.begin()) {
                let store = &mut *cx.local.store;
                let outcome = cx
                    .local
                    .watchdog
                    .patient(|| job.carry_out(store, Arm::HASH));
                cx.shared.desk.lock(|desk| desk.store.finish(&job, outcome));
                // It answers the host.
                rtic::pend(Interrupt::EXTI1);
            }
            ROLL.present(Task::Housekeeping);
            cx.local.watchdog.feed_if_all_present();
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
