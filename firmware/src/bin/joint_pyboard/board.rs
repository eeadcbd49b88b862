//! The board in one file: pyboard v1.1, an STM32F405RG on a card that anybody can buy, in front of a servo drive.
//!
//! What differs from `joint`: the crystal, and with it the division in front of the PLL; where the enable is.
//! Sources: RM0090 (reference manual), DS8626 (data sheet), and for the card its schematics PYBv1.1.

use stm32f4xx_hal::gpio::PinState;
use stm32f4xx_hal::pac::{GPIOA, GPIOB};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;

/// What the log calls it.
pub(crate) const NAME: &str = "pyboard-v1.1";

/// The arm this firmware is for, its joints and its base parameters.
pub(crate) use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5 as Arm};

/// Crystal, Hz: the card carries 12 MHz (v1.0 carried 8).
pub(crate) const HSE_HZ: u32 = 12_000_000;
/// Internal oscillator, Hz, ± 1 % at room temperature (DS8626 table 41).
pub(crate) const HSI_HZ: u32 = 16_000_000;
/// Processor clock from the PLL, Hz: the most the chip allows at voltage scale 1, its reset state (DS8626 table 14).
pub(crate) const PLL_HZ: u32 = 168_000_000;
/// Input of the PLL after division by M = 6, Hz: RM0090 7.3.2 recommends 2 MHz against jitter.
pub(crate) const PLL_INPUT_HZ: u32 = 2_000_000;
/// Factor N: 2 MHz × 168 = 336 MHz, inside 100 to 432 MHz (RM0090 7.3.2).
pub(crate) const PLL_N: u16 = 168;
/// Factor Q: 336 MHz / 7 = 48 MHz for USB and the random number generator.
pub(crate) const PLL_Q: u8 = 7;
/// Wait states of the flash at 168 MHz and 2.7 to 3.6 V (RM0090 table 10).
pub(crate) const FLASH_WAIT_STATES: u8 = 5;
/// Reads of a ready flag before a clock source is given up; see `joint`.
pub(crate) const CLOCK_POLLS: u32 = 100_000;
/// Division of the slow peripheral bus while the PLL runs: 42 MHz, its maximum (DS8626 table 14).
pub(crate) const APB1_DIVIDER: u32 = 4;

/// Bit rate of the link, as on `joint`: both clocks reach it exactly.
pub(crate) const LINK_BAUD: u32 = 2_000_000;

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
