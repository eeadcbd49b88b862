//! The fourth board: a pyboard v1.1 between a host and the drives of an arm on CAN, or one moteus on a UART.
//!
//! Role, ports and drives are data in the flash (memory.x, `_wiring`): `host-sim wiring` makes them from a profile. A board
//! without them cannot be armed and passes every frame.
//!
//! | port | pins | role |
//! |---|---|---|
//! | CAN1 | PB8 (Y3) RX, PB9 (Y4) TX | master: bus 0; in line: the host |
//! | CAN2 | PB12 (Y5) RX, PB13 (Y6) TX | master: bus 1; in line: the drives |
//! | UART4 | PA0 (X1) TX, PA1 (X2) RX | the drive: bus 1, or in line |
//! | USART6 | PC6 (Y1) TX, PC7 (Y2) RX | the host of a drive on UART4 |
//! | USART2 | PA2 (X3) TX, PA3 (X4) RX | link |
//!
//! The frames have a task of their own above the tick, [`interrupt`]: a tick that hangs lets its torque expire, and frames
//! go on passing. In the emulator USART6 and UART4 carry the frames of both CAN ports. It has not run on silicon.

mod ports;

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use foretorque::joint::JointSample;
use foretorque_link::bus::{BoardDrives, Role, Wiring};
use foretorque_link::drives::Frame;
use foretorque_link::drives::in_line::{Bridge, InLine};
use foretorque_link::hal::TorqueEnable;
use foretorque_link::safety::SafetyReason;
use foretorque_link::session::LocalSensor;
use foretorque_link::wire::ClockSource;
use heapless::spsc::Queue;
use stm32f4xx_hal::gpio::PinState;
use stm32f4xx_hal::pac::{Interrupt, TIM2};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;

use crate::app::TICK;
use crate::arm::{Arm, BoardSession, JOINTS, PARAMETERS};
use crate::board::{Board, Drive, EnablePin, Pin, Ports, start_link, switch};
use crate::clock::Clocks;
use crate::link::{self, Receiver, Sender};
use crate::pyboard::Pyboard;
use ports::FramePort;

/// Time for which a torque is added after the last tick, and for which a frame waits, s: that without a reply after which
/// a master ends the torque.
const EXPIRY_S: f32 = foretorque_link::bus::SILENCE_S;
/// Frames that have arrived and wait for the tick; frames on their way to the ports.
const ARRIVED: usize = 16;
const LEAVING: usize = 4;
/// The interrupt by which the tick wakes the task of the frames.
const WAKE: Interrupt = Interrupt::CAN1_TX;

/// A port has left its bus since the last tick.
static OFF: AtomicBool = AtomicBool::new(false);
/// Frames dropped on the way to the tick or to a bus that stood still, or overrun. Wraps.
static LOST: AtomicU32 = AtomicU32::new(0);

/// Orders of the tick to the task of the frames.
enum Order {
    /// Send a frame of the board.
    Send(u8, Frame),
    /// Add these torques, or none.
    Add(Option<[f32; JOINTS]>),
}

/// The task of the frames: both ports and what passes between them.
struct FrameTask {
    bridge: Bridge<FramePort, JOINTS>,
    orders: Receiver<LEAVING, Order>,
    arrived: Sender<ARRIVED, (u8, Frame)>,
}

static mut TASK: Option<FrameTask> = None;

/// Counts of TIM2. The cycle counter of the core stands still while it sleeps (RM0090 38.16.3).
fn now() -> u32 {
    // SAFETY: a read without side effect of a register that nothing writes.
    unsafe { &*TIM2::ptr() }.cnt().read().bits()
}

/// The interrupts of both ports, at one priority above the tick's.
///
/// Cost: the frames that have arrived, at most 16 taken and 24 sent each way.
pub fn interrupt() {
    let task = &raw mut TASK;
    // SAFETY: written once, before these interrupts are unmasked, and they all have one priority: none preempts another.
    let Some(task) = (unsafe { &mut *task }) else {
        return;
    };
    let FrameTask {
        bridge,
        orders,
        arrived,
    } = task;
    let now = now();
    while let Some(order) = orders.take() {
        match order {
            Order::Send(port, frame) => bridge.send(port, frame, now),
            Order::Add(torques) => bridge.add(torques.as_ref(), now),
        }
    }
    let before = bridge.lost();
    let (mut any, mut full) = (false, 0);
    bridge.pass(now, |port, frame| {
        any = true;
        full += u32::from(!arrived.put((port, *frame)));
    });
    // Reading clears the latch of a port, so both are read.
    let off = bridge.ports().iter_mut().map(FramePort::is_off);
    let off = off.fold(false, |off, own| off | own);
    // A bus that comes back between two ticks was off all the same.
    OFF.fetch_or(off, Ordering::Relaxed);
    LOST.fetch_add(full + bridge.lost().wrapping_sub(before), Ordering::Relaxed);
    if any {
        rtic::pend(TICK);
    }
}

/// Drives of the arm, behind their ports.
pub struct BusDrive {
    enable: TorqueEnable<EnablePin<CanBoard>>,
    /// `None` without a wiring in the flash.
    drives: Option<BoardDrives<Arm, JOINTS, PARAMETERS>>,
    /// That of the wiring, µs.
    shortest_period_us: u32,
    orders: Sender<LEAVING, Order>,
    arrived: Receiver<ARRIVED, (u8, Frame)>,
}

impl LocalSensor<JOINTS> for BusDrive {
    const SAMPLES_AT_ONCE: u8 =
        <BoardDrives<Arm, JOINTS, PARAMETERS> as LocalSensor<JOINTS>>::SAMPLES_AT_ONCE;

    #[inline(never)]
    fn measure(&mut self, sample: &mut Option<JointSample<JOINTS>>, at_rest: bool) -> SafetyReason {
        match &mut self.drives {
            Some(drives) => drives.measure(sample, at_rest),
            None => SafetyReason::Drive,
        }
    }

    fn silence(&mut self) {
        if let Some(drives) = &mut self.drives {
            drives.silence();
        }
    }

    fn holds(&self) -> bool {
        self.drives.as_ref().is_some_and(LocalSensor::holds)
    }

    fn is_off(&self) -> bool {
        self.drives.as_ref().is_none_or(LocalSensor::is_off)
    }
}

impl Drive for BusDrive {
    #[inline(never)]
    fn start(clocks: &Clocks) -> Option<Self> {
        let wiring = wiring();
        let role = wiring.as_ref().map_or(Role::InLine, |wiring| wiring.role);
        let ports = ports::start(clocks, wiring.as_ref());
        let mut profiles = [None; JOINTS];
        let joints = wiring.iter().flat_map(|wiring| &wiring.joints);
        for (slot, joint) in profiles.iter_mut().zip(joints) {
            *slot = joint.map(|joint| joint.drive);
        }
        let expiry = if clocks.source == ClockSource::Virtual {
            // Its time does not follow the host's.
            u32::MAX
        } else {
            // SAFETY: on silicon nothing else uses the timer, whose clock runs.
            let timer = unsafe { &*TIM2::ptr() };
            timer.cr1().write(|w| w.cen().enabled());
            (EXPIRY_S * clocks.timer_hz() as f32) as u32
        };
        let in_line = (role == Role::InLine).then(|| InLine::new(profiles, expiry));
        let orders = cortex_m::singleton!(: Queue<Order, LEAVING> = Queue::new())?;
        let arrived = cortex_m::singleton!(: Queue<(u8, Frame), ARRIVED> = Queue::new())?;
        let (order, orders) = link::split(orders);
        let (arrive, arrived) = link::split(arrived);
        let task = &raw mut TASK;
        // SAFETY: the interrupts that read it are still masked.
        unsafe {
            *task = Some(FrameTask {
                bridge: Bridge::new(ports, in_line, expiry),
                orders,
                arrived: arrive,
            });
        }
        ports::unmask();
        // Switched off by its constructor; only a session that a host has armed switches it on.
        let Ok(enable) = TorqueEnable::new(EnablePin::default());
        Some(Self {
            enable,
            drives: wiring.as_ref().map(BoardDrives::new),
            shortest_period_us: wiring.map_or(0, |wiring| wiring.shortest_period_us),
            orders: order,
            arrived,
        })
    }

    fn shortest_period_us(&self) -> u32 {
        self.shortest_period_us
    }

    fn limit(&self, session: &mut BoardSession) {
        if let Some(drives) = &self.drives {
            session.limit_torques(drives.torque_limits());
        }
    }

    fn watch(&mut self, _: &mut BoardSession) {
        for _ in 0..ARRIVED {
            let Some((port, frame)) = self.arrived.take() else {
                break;
            };
            if let Some(drives) = &mut self.drives {
                drives.receive(port, &frame);
            }
        }
    }

    fn follow(&mut self, session: &mut BoardSession) {
        self.follow_drives(session);
        let powered = |drives: &BoardDrives<_, _, _>| drives.powered(session);
        switch(&mut self.enable, self.drives.as_ref().is_some_and(powered));
    }

    fn report() {
        static LOGGED: AtomicU32 = AtomicU32::new(0);
        let lost = LOST.load(Ordering::Relaxed);
        if LOGGED.swap(lost, Ordering::Relaxed) != lost {
            defmt::warn!("bus: {=u32} frames lost", lost);
        }
    }
}

impl BusDrive {
    fn follow_drives(&mut self, session: &mut BoardSession) {
        // Frames that wait grow old, also where none arrives and none is sent.
        rtic::pend(WAKE);
        let Self { drives, orders, .. } = self;
        let Some(drives) = drives else { return };
        let mut give = |order| {
            if !orders.put(order) {
                LOST.fetch_add(1, Ordering::Relaxed);
            }
            // It runs at once, so the next order finds room.
            rtic::pend(WAKE);
        };
        if !drives.ticked() {
            // A stop does not wait for the next tick.
            if !session.torque_enabled() {
                drives.end(session);
                give(Order::Add(None));
            }
            return;
        }
        let off = OFF.swap(false, Ordering::Relaxed);
        let torques = drives.follow(session, off, |bus, frame| give(Order::Send(bus, *frame)));
        give(Order::Add(torques.map(Into::into)));
    }
}

fn wiring() -> Option<Wiring<JOINTS>> {
    const BYTES: usize = Wiring::<JOINTS>::BYTES;
    unsafe extern "C" {
        static _wiring: [u8; BYTES];
    }
    // SAFETY: the address is in the flash, aligned for bytes, and never changes while the firmware runs. Volatile, because
    // the compiler has no part in what is there.
    Wiring::decode::<Arm, PARAMETERS>(&unsafe { (&raw const _wiring).read_volatile() })
}

/// The board.
pub struct CanBoard;

impl Board for CanBoard {
    const NAME: &'static str = "pyboard-v1.1 on a drive bus";
    const CRYSTAL_HZ: u32 = Pyboard::CRYSTAL_HZ;
    /// PA4, the card's X5: contactor of the arm. CAN has the pin that [`Pyboard`] uses.
    const ENABLE: Pin = Pin::A(4);
    const BRAKE: Option<Pin> = Pyboard::BRAKE;

    type Drive = BusDrive;

    fn start_pins(ports: Ports, rcc: &mut Rcc) {
        rcc.apb1enr()
            .modify(|_, w| w.can1en().enabled().can2en().enabled().uart4en().enabled());
        rcc.apb2enr().modify(|_, w| w.usart6en().enabled());
        let a = ports.a.split(rcc);
        let b = ports.b.split(rcc);
        let c = ports.c.split(rcc);
        a.pa4.into_push_pull_output_in_state(PinState::Low);
        b.pb10.into_push_pull_output_in_state(PinState::Low);
        // Alternate functions 9 and 8 (DS8626 table 9).
        b.pb8.into_alternate::<9>().internal_pull_up(true);
        b.pb9.into_alternate::<9>();
        b.pb12.into_alternate::<9>().internal_pull_up(true);
        b.pb13.into_alternate::<9>();
        a.pa0.into_alternate::<8>();
        a.pa1.into_alternate::<8>().internal_pull_up(true);
        c.pc6.into_alternate::<8>();
        c.pc7.into_alternate::<8>().internal_pull_up(true);
        start_link(a.pa2, a.pa3);
    }
}

/// The handlers of the ports' interrupts.
#[macro_export]
macro_rules! frame_handlers {
    ($($name:ident)*) => {
        mod frame_handlers {
            use stm32f4xx_hal::pac::interrupt;
            $(
                #[interrupt]
                fn $name() {
                    $crate::can_board::interrupt();
                }
            )*
        }
    };
}
