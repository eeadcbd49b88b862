//! The two ports: CAN controllers, or serial ports with lines of text.

use foretorque_link::bus::{Role, Wires, Wiring};
use foretorque_link::drives::Frame;
use foretorque_link::drives::in_line::Port;
use foretorque_link::drives::text::Direction;
use foretorque_link::wire::ClockSource;
use stm32f4xx_hal::pac::Interrupt;

use super::text::{TextPort, Uart};
use crate::arm::JOINTS;
use crate::can::{Bxcan, Controller, Peripheral, open_filters, timing};
use crate::clock::Clocks;

/// Bit rate of a board without a wiring, bit/s.
const BIT_S: u32 = 1_000_000;
/// Reads of a status before a controller is given up: 100 µs and more.
const POLLS: u32 = 10_000;
/// Priority of the frames, as the core counts it: RTIC's 4 of 16, between link and tick.
const PRIORITY: u8 = (16 - 4) << 4;

/// One port.
#[expect(
    clippy::large_enum_variant,
    reason = "there are two, in a static, and no heap"
)]
pub(super) enum FramePort {
    /// CAN controller.
    Can(Bxcan<Peripheral>),
    /// Serial port.
    Text(TextPort),
    /// A controller that does not answer: frames wait for ever.
    Dead,
}

impl FramePort {
    /// The port carries no frames: off its bus, or dead.
    pub(super) fn is_off(&mut self) -> bool {
        match self {
            Self::Can(can) => can.is_off(),
            Self::Text(_) => false,
            Self::Dead => true,
        }
    }
}

impl Port for FramePort {
    fn receive(&mut self) -> Option<Frame> {
        match self {
            Self::Can(can) => Port::receive(can),
            Self::Text(text) => text.receive(),
            Self::Dead => None,
        }
    }

    fn send(&mut self, frame: &Frame) -> bool {
        match self {
            Self::Can(can) => Port::send(can, frame),
            Self::Text(text) => text.send(frame),
            Self::Dead => false,
        }
    }
}

/// Starts both ports; bounded.
pub(super) fn start(clocks: &Clocks, wiring: Option<&Wiring<JOINTS>>) -> [FramePort; 2] {
    let emulated = clocks.source == ClockSource::Virtual;
    let text = emulated || wiring.is_some_and(|wiring| wiring.wires == Wires::Uart);
    if text {
        let in_line = wiring.is_none_or(|wiring| wiring.role == Role::InLine);
        // In line the first port is that of a host, to whom the board is an adapter.
        let first = if in_line {
            Direction::Receive
        } else {
            Direction::Send
        };
        let bare = clocks.source == ClockSource::Bare;
        let apb2_hz = if bare {
            clocks.apb1_hz
        } else {
            2 * clocks.apb1_hz
        };
        let acknowledges = in_line || emulated;
        return [
            TextPort::start(Uart::Usart6, apb2_hz, first, acknowledges),
            TextPort::start(Uart::Uart4, clocks.apb1_hz, Direction::Send, emulated),
        ]
        .map(FramePort::Text);
    }
    let bit_s = wiring.map_or(BIT_S, |wiring| wiring.bit_s);
    // SAFETY: the first and only values of both, whose clocks run.
    let [mut can1, can2] =
        unsafe { [Controller::Can1, Controller::Can2].map(|c| Peripheral::new(c)) };
    open_filters(&mut can1);
    let started = |registers| {
        let timing = timing(clocks.apb1_hz, bit_s)?;
        Some(FramePort::Can(Bxcan::start(registers, timing, POLLS)?))
    };
    [can1, can2].map(|can| started(can).unwrap_or(FramePort::Dead))
}

/// Lets the interrupts of the ports through.
pub(super) fn unmask() {
    const ALL: [Interrupt; 6] = [
        Interrupt::CAN1_TX,
        Interrupt::CAN1_RX0,
        Interrupt::CAN2_TX,
        Interrupt::CAN2_RX0,
        Interrupt::UART4,
        Interrupt::USART6,
    ];
    // SAFETY: called once, from `init`, with interrupts off; RTIC binds none of these.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    for interrupt in ALL {
        // SAFETY: no critical section of RTIC relies on the priority of these.
        unsafe {
            core.NVIC.set_priority(interrupt, PRIORITY);
            cortex_m::peripheral::NVIC::unmask(interrupt);
        }
    }
}
