//! Start of a board: clocks, pins, session, learner and link.

use core::mem::MaybeUninit;

use foretorque::arm::Arm as _;
use foretorque_link::session::BoardDescription;
use foretorque_link::store::Store;
use foretorque_link::telemetry::CostMeter;
use foretorque_link::wire::size::LinkCapacity;
use foretorque_link::wire::{Capabilities, ClockSource, FrameBuffer};
use heapless::spsc::Queue;
use stm32f4xx_hal::pac;
use stm32f4xx_hal::prelude::*;

use super::{Idle, Tick};
use crate::arm::{Arm, BoardHousekeeping, BoardMailboxes, BoardSession, Learner, init_learner};
use crate::board::{Board, Drive as _, Ports};
use crate::chip::LINK_BYTES_S;
use crate::clock;
use crate::counter::{self, Counter};
use crate::fault::{self, Reason};
use crate::flash_driver::{Registers, StoreFlash};
use crate::frame_bound::FrameBound;
use crate::key_slot;
use crate::link::{self, RECEIVE_RING, TRANSMIT_RING, Wire};
use crate::log;
use crate::tick_timer::TickTimer;
use crate::watchdog::Watchdog;

/// Static memory of the large parts.
pub struct Statics {
    mailboxes: MaybeUninit<BoardMailboxes>,
    housekeeping: BoardHousekeeping,
    session: MaybeUninit<BoardSession>,
    learner: MaybeUninit<Learner>,
    receive_ring: Queue<u8, RECEIVE_RING>,
    transmit_ring: Queue<u8, TRANSMIT_RING>,
    out: FrameBuffer,
}

impl Statics {
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
pub struct Started<B: Board> {
    /// Shared by tick, learner and idle loop.
    pub mailboxes: &'static mut BoardMailboxes,
    /// Of the link's interrupt.
    pub wire: Wire,
    /// Of the tick.
    pub tick: Tick<B>,
    /// Of the learner.
    pub learner: &'static mut Learner,
    /// Of the idle loop.
    pub idle: Idle,
}

/// Starts clocks, pins, session, learner and link; leaves by a reset if a constant of the board cannot work.
#[inline(always)]
pub fn start<B: Board>(
    chip: pac::Peripherals,
    mut core: cortex_m::Peripherals,
    statics: &'static mut Statics,
) -> Started<B> {
    let (reason, place) = fault::take();
    let reset_reason = fault::reset_reason(reason, &chip.RCC);
    let kept = fault::latched();
    let clocks = clock::start(&chip.RCC, &chip.FLASH, B::CRYSTAL_HZ);
    let emulated = clocks.source == ClockSource::Virtual;
    let seed = key_slot::seed(&chip.RNG, &chip.RCC, emulated);
    let mut status = clock::status(&clocks, &chip.FLASH);

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
    let Some(mut drive) = B::Drive::start(&clocks) else {
        fault::leave::<B>(Reason::Setup, line!());
    };
    status.shortest_period_us = status.shortest_period_us.max(drive.shortest_period_us());

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
    let Ok(session) = BoardSession::init_in_place(&mut statics.session, description) else {
        fault::leave::<B>(Reason::Setup, line!());
    };
    drive.limit(session);
    let mailboxes = statics.mailboxes.write(BoardMailboxes::default());
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

    let (receive_in, received) = link::split(&mut statics.receive_ring);
    let (mut waiting, transmit_out) = link::split(&mut statics.transmit_ring);
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
    let tick = Tick {
        session,
        received,
        waiting,
        out,
        timer,
        drive,
        brake_open: false,
        kept,
        losses: 0,
        missed: 0,
        bound: FrameBound::default(),
        latency: CostMeter::default(),
    };
    let idle = Idle {
        watchdog: Watchdog::start(chip.IWDG),
        housekeeping,
        drain,
    };
    Started {
        mailboxes,
        wire,
        tick,
        learner,
        idle,
    }
}
