//! The second board: pyboard v1.1, an STM32F405RG on a card that anybody can buy, in front of a servo drive.
//!
//! The chip is that of `joint`, whose file says all that follows from the chip alone; here is what this board has of its
//! own and puts in the place of it: the crystal, and the pins. Sources: as there, and the card's schematics PYBv1.1.

use stm32f4xx_hal::gpio::PinState;
use stm32f4xx_hal::pac::{GPIOA, GPIOB};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;

#[path = "../joint/board.rs"]
#[expect(
    dead_code,
    reason = "what this board puts something else in the place of"
)]
mod first;

pub(crate) use first::*;

/// What the log calls it.
pub(crate) const NAME: &str = "pyboard-v1.1";

/// Crystal, Hz: the card carries 12 MHz (v1.0 carried 8). The division in front of the PLL, M = 6, follows from it.
pub(crate) const HSE_HZ: u32 = 12_000_000;

/// Torque enable of the motor stage: PB8, the card's Y3, active high. The card pulls it nowhere: give the drive's input a
/// pull-down of 10 kΩ, or torque is enabled while the chip is in reset.
pub(crate) const ENABLE_PIN: u8 = 8;
/// Port of the enable, written by the fault handlers without the owner of its pins.
pub(crate) type EnablePort = GPIOB;

/// The ports whose pins are used here.
pub(crate) struct Ports {
    pub(crate) a: GPIOA,
    pub(crate) b: GPIOB,
}

/// Gives every pin its job: enable low, link on PA2 (TX, the card's X3) and PA3 (RX, X4).
pub(crate) fn start_pins(ports: Ports, rcc: &mut Rcc) {
    let a = ports.a.split(rcc);
    let b = ports.b.split(rcc);
    b.pb8.into_push_pull_output_in_state(PinState::Low);
    // Alternate function 7 is USART2 (DS8626 table 9).
    a.pa2.into_alternate::<7>();
    // Held high while nobody is plugged in: an open line is full of start bits.
    a.pa3.into_alternate::<7>().internal_pull_up(true);
}
