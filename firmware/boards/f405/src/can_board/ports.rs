//! The two ports: CAN controllers, or serial ports.
//!
//! A serial port carries frames as lines of text: for a moteus on its UART, its client on the other port, and in the emulator,
//! which has no CAN, both buses.

use foretorque_link::bus::{Role, Wires, Wiring};
use foretorque_link::drives::Frame;
use foretorque_link::drives::in_line::Port;
use foretorque_link::drives::text::{Direction, Line, read_line, write_line};
use foretorque_link::wire::ClockSource;
use stm32f4xx_hal::pac::Interrupt;

use crate::arm::JOINTS;
use crate::can::{Bxcan, Peripheral, Registers as _, open_filters, timing};
use crate::clock::Clocks;

/// Bit rate of a board without a wiring, bit/s.
const BIT_S: u32 = 1_000_000;
/// Reads of a status before a controller is given up: 100 µs and more.
const POLLS: u32 = 10_000;
/// Priority of the frames, as the core counts it: RTIC's 4 of 16, between link and tick.
const PRIORITY: u8 = (16 - 4) << 4;

#[expect(
    clippy::large_enum_variant,
    reason = "there are two, in a static, and no heap"
)]
pub(super) enum FramePort {
    Can(Bxcan<Peripheral>),
    Text(TextPort),
    /// A controller that does not answer.
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
            Self::Can(can) => can.receive(),
            Self::Text(text) => text.receive(),
            Self::Dead => None,
        }
    }

    fn send(&mut self, frame: &Frame, since: u32) -> bool {
        match self {
            Self::Can(can) => can.send(frame, since),
            Self::Text(text) => text.send(frame),
            Self::Dead => false,
        }
    }

    fn expire(&mut self, now: u32, timeout: u32) -> u32 {
        match self {
            Self::Can(can) => can.expire(now, timeout),
            // Nothing stops a line.
            Self::Text(_) | Self::Dead => 0,
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
        // SAFETY: the first and only values of both, whose clocks run.
        let [usart6, uart4] =
            unsafe { [Peripheral::USART6, Peripheral::UART4].map(|at| Peripheral::new(at)) };
        return [
            TextPort::start(usart6, apb2_hz, first, acknowledges),
            TextPort::start(uart4, clocks.apb1_hz, Direction::Send, emulated),
        ]
        .map(FramePort::Text);
    }
    let bit_s = wiring.map_or(BIT_S, |wiring| wiring.bit_s);
    // SAFETY: the first and only values of both, whose clocks run.
    let [mut can1, can2] =
        unsafe { [Peripheral::CAN1, Peripheral::CAN2].map(|at| Peripheral::new(at)) };
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

/// Bit rate of moteus and its client.
const BAUD: u32 = 921_600;
/// Bytes taken and put in one call, at most: a line; it bounds the time of a port with wrong flags.
const CHUNK_BYTES: usize = 176;

/// Acknowledgement of a line, with its sum: the client of moteus drops a line without one.
const ACKNOWLEDGEMENT: &[u8] = b"OK *BD\n";

const RXNE: u32 = 1 << 5;
const ORE: u32 = 1 << 3;
const TXE: u32 = 1 << 7;
const TXEIE: u32 = 1 << 7;
/// Port, receiver, its interrupt and transmitter.
const ON: u32 = 1 << 13 | RXNE | 1 << 3 | 1 << 2;

// Registers of a serial port (RM0090 30.6).
const SR: usize = 0x00;
const DR: usize = 0x04;
const BRR: usize = 0x08;
const CR1: usize = 0x0c;

/// Port whose frames are lines.
pub(super) struct TextPort {
    uart: Peripheral,
    direction: Direction,
    /// Lines that arrive are acknowledged, as an adapter does: for moteus' client, and for the tests.
    acknowledges: bool,
    waiting_acks: u8,
    received: Line,
    /// The line under way is longer than any frame.
    overlong: bool,
    sending: Line,
    sent: usize,
}

impl TextPort {
    /// Starts the port on UART4 or USART6.
    ///
    /// * `direction` of the lines that this port sends
    fn start(
        mut uart: Peripheral,
        clock_hz: u32,
        direction: Direction,
        acknowledges: bool,
    ) -> Self {
        uart.write(BRR, (clock_hz + BAUD / 2) / BAUD);
        uart.write(CR1, ON);
        Self {
            uart,
            direction,
            acknowledges,
            waiting_acks: 0,
            received: Line::new(),
            overlong: false,
            sending: Line::new(),
            sent: 0,
        }
    }

    /// Moves bytes of the line under way to the port while it takes them.
    fn pump(&mut self) {
        for _ in 0..2 * CHUNK_BYTES {
            if self.uart.read(SR) & TXE == 0 {
                break;
            }
            if self.sent == self.sending.len() && self.waiting_acks > 0 {
                self.waiting_acks -= 1;
                self.sent = 0;
                self.sending.clear();
                // It has room for more.
                let _ = self.sending.extend_from_slice(ACKNOWLEDGEMENT);
            }
            let Some(&byte) = self.sending.get(self.sent) else {
                break;
            };
            self.uart.write(DR, byte.into());
            self.sent += 1;
        }
        let unfinished = self.sent < self.sending.len() || self.waiting_acks > 0;
        self.uart
            .write(CR1, if unfinished { ON | TXEIE } else { ON });
    }

    fn receive(&mut self) -> Option<Frame> {
        self.pump();
        for _ in 0..CHUNK_BYTES {
            // Reading status and then data also clears the error flags (RM0090 30.6.1).
            let status = self.uart.read(SR);
            if status & (RXNE | ORE) == 0 {
                return None;
            }
            let byte = self.uart.read(DR) as u8;
            if status & RXNE == 0 {
                // An overrun alone leaves the byte before it there.
                continue;
            }
            if byte != b'\n' {
                self.overlong |= self.received.push(byte).is_err();
                continue;
            }
            let overlong = core::mem::take(&mut self.overlong);
            let frame = read_line(&self.received).filter(|_| !overlong);
            self.received.clear();
            if frame.is_some() {
                self.waiting_acks += u8::from(self.acknowledges && self.waiting_acks < u8::MAX);
                return frame;
            }
        }
        None
    }

    fn send(&mut self, frame: &Frame) -> bool {
        let free = self.sent == self.sending.len();
        if free {
            self.sending = write_line(frame, self.direction);
            self.sent = 0;
            self.pump();
        }
        free
    }
}
