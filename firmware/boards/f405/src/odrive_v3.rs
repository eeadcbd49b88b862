//! A joint controller of the ODrive v3 class. Another board is another file like this one, and a binary that names it:
//! `joint-pyboard` is one. Sources: RM0090 (reference manual), DS8626 (data sheet).

use stm32f4xx_hal::gpio::PinState;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;

use crate::board::{Board, EnableOnly, Pin, Ports, start_link};

/// The board.
pub struct OdriveV3;

impl Board for OdriveV3 {
    const NAME: &'static str = "odrive-v3";
    /// Boards of this class carry 8 MHz.
    const CRYSTAL_HZ: u32 = 8_000_000;
    /// PB12, pulled low on the board (EN_GATE of a DRV8301).
    const ENABLE: Pin = Pin::B(12);
    /// PA1, which the connector calls GPIO 2.
    const BRAKE: Option<Pin> = Some(Pin::A(1));

    type Drive = EnableOnly<Self>;

    /// Link on PA2 (TX) and PA3 (RX), the two that the connector calls GPIO 3 and 4.
    fn start_pins(ports: Ports, rcc: &mut Rcc) {
        let a = ports.a.split(rcc);
        let b = ports.b.split(rcc);
        b.pb12.into_push_pull_output_in_state(PinState::Low);
        a.pa1.into_push_pull_output_in_state(PinState::Low);
        start_link(a.pa2, a.pa3);
    }
}
