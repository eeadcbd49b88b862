//! The board in one file: chip constants, clocks and pins. Another board is another file like this one, and a binary
//! that names it: `joint-pyboard` is one.
//!
//! STM32F405RG on a joint controller of the ODrive v3 class. Sources: RM0090 (reference manual), DS8626 (data sheet).

use stm32f4xx_hal::gpio::PinState;
use stm32f4xx_hal::pac::{GPIOA, GPIOB};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;

/// What the log calls it.
pub(crate) const NAME: &str = "odrive-v3";
/// The arm this firmware is for, its joints and its base parameters.
pub(crate) use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5 as Arm};

/// Crystal, Hz (DS8626 5.3.9: 4 to 26 MHz; boards of this class carry 8 MHz).
pub(crate) const HSE_HZ: u32 = 8_000_000;
/// Internal oscillator, Hz, ± 1 % at room temperature (DS8626 table 41).
pub(crate) const HSI_HZ: u32 = 16_000_000;
/// Processor clock from the PLL, Hz: the most the chip allows at voltage scale 1, its reset state (DS8626 table 14).
pub(crate) const PLL_HZ: u32 = foretorque_link::wire::size::PROCESSOR_HZ as u32;
/// Input of the PLL after division by M, Hz: RM0090 7.3.2 recommends 2 MHz against jitter.
pub(crate) const PLL_INPUT_HZ: u32 = 2_000_000;
/// Factor N: 2 MHz × 168 = 336 MHz, inside 100 to 432 MHz (RM0090 7.3.2).
pub(crate) const PLL_N: u16 = 168;
/// Factor Q: 336 MHz / 7 = 48 MHz for USB and the random number generator.
pub(crate) const PLL_Q: u8 = 7;
/// Wait states of the flash at 168 MHz and 2.7 to 3.6 V (RM0090 table 10).
pub(crate) const FLASH_WAIT_STATES: u8 = 5;
/// Reads of a ready flag before a clock source is given up. One read takes at least three cycles at 16 MHz, so this
/// is more than 18 ms; the crystal needs about 2 ms (DS8626 table 39), the PLL at most 0.3 ms (table 43).
pub(crate) const CLOCK_POLLS: u32 = 100_000;
/// First sector of the store, and bytes of each of its two: the last ones of the chip (RM0090 table 5; memory.x).
pub(crate) const STORE_SECTOR: u8 = 10;
/// Bytes of a sector of the store.
pub(crate) const STORE_SECTOR_BYTES: usize = 128 * 1024;
/// Reads of the busy flag before the flash is given up. One takes at least three cycles at 168 MHz, so this is more than
/// 3.5 s; erasing takes at most 2 s (DS8626 table 48).
pub(crate) const FLASH_POLLS: u32 = 200_000_000;
/// Division of the slow peripheral bus while the PLL runs: 42 MHz, its maximum (DS8626 table 14).
pub(crate) const APB1_DIVIDER: u32 = 4;

/// Bit rate of the link. USART2 sits on APB1; eight-fold oversampling reaches it from 42 MHz (divider 21/8, exact)
/// and from the bare 16 MHz oscillator (divider 8/8, exact).
pub(crate) const LINK_BAUD: u32 = foretorque_link::wire::size::BAUD;

/// Torque enable of the motor stage: PB12, active high, pulled low on the board (EN_GATE of a DRV8301).
pub(crate) const ENABLE_PIN: u8 = 12;
/// Port of the enable, written by the fault handlers without the owner of its pins.
pub(crate) type EnablePort = GPIOB;

/// Division of the watchdog's oscillator, 17 to 47 kHz (DS8626 table 42): 16, which its register calls 2.
pub(crate) const WATCHDOG_PRESCALER: u8 = 2;
/// Counts after which an unfed watchdog bites: 68 to 188 ms. The longest legal period of the tick is 100 ms, but torque
/// ends after 50 ms of silence all the same; what takes longer is a hung task.
pub(crate) const WATCHDOG_RELOAD: u16 = 200;

/// The only joint that this board drives, from 0, and so the only one whose rows it learns from; `None` for all. The
/// torques of all joints are computed either way: the recursion passes through all of them.
pub(crate) const OWN_JOINT: Option<usize> = None;

/// The ports whose pins are used here.
pub(crate) struct Ports {
    pub(crate) a: GPIOA,
    pub(crate) b: GPIOB,
}

/// Gives every pin its job: enable low, link on PA2 (TX) and PA3 (RX), the two that the connector calls GPIO 3 and 4.
pub(crate) fn start_pins(ports: Ports, rcc: &mut Rcc) {
    let a = ports.a.split(rcc);
    let b = ports.b.split(rcc);
    b.pb12.into_push_pull_output_in_state(PinState::Low);
    // Alternate function 7 is USART2 (DS8626 table 9).
    a.pa2.into_alternate::<7>();
    // Held high while nobody is plugged in: an open line is full of start bits.
    a.pa3.into_alternate::<7>().internal_pull_up(true);
}
