//! The second board: pyboard v1.1, an STM32F405RG on a card that is sold everywhere, in front of a servo drive.
//!
//! Sources: as of [`crate::odrive_v3`], and the card's schematics PYBv1.1.

use stm32f4xx_hal::gpio::PinState;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;

use crate::board::{Board, EnableOnly, Pin, Ports, start_link};

/// The board.
pub struct Pyboard;

impl Board for Pyboard {
    const NAME: &'static str = "pyboard-v1.1";
    /// The card carries 12 MHz (v1.0 carried 8). The division in front of the PLL, M = 6, follows from it.
    const CRYSTAL_HZ: u32 = 12_000_000;
    /// PB8, the card's Y3. The card pulls it nowhere: give the drive's input a pull-down of 10 kΩ, or torque is enabled
    /// while the chip is in reset.
    const ENABLE: Pin = Pin::B(8);
    /// PB10, the card's Y9.
    const BRAKE: Option<Pin> = Some(Pin::B(10));

    type Drive = EnableOnly<Self>;

    /// Link on PA2 (TX, the card's X3) and PA3 (RX, X4).
    fn start_pins(ports: Ports, rcc: &mut Rcc) {
        let a = ports.a.split(rcc);
        let b = ports.b.split(rcc);
        b.pb8.into_push_pull_output_in_state(PinState::Low);
        b.pb10.into_push_pull_output_in_state(PinState::Low);
        start_link(a.pa2, a.pa3);
    }
}
