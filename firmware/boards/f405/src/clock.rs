//! The best clock that this board can give, in bounded time, and its supervision.

use foretorque_link::wire::{ChipStatus, ClockSource};
use stm32f4xx_hal::pac::{FLASH, RCC};

use crate::arm::JOINTS;
use crate::{chip, image};

/// Result of the bring-up.
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// Source of the clock.
    pub source: ClockSource,
    /// Processor and SysTick clock, Hz.
    pub cpu_hz: u32,
    /// Clock of the slow peripheral bus, Hz.
    pub apb1_hz: u32,
}

impl Clocks {
    /// Clock of the timers on the slow peripheral bus, Hz: twice the bus's, where that is divided (RM0090 7.2).
    pub fn timer_hz(&self) -> u32 {
        self.cpu_hz.min(2 * self.apb1_hz)
    }
}

/// Starts the best clock: crystal and PLL, else internal oscillator and PLL, else the internal oscillator.
///
/// * `crystal_hz` crystal of the board
///
/// Cannot fail. Cost: at most two bounded waits of [`chip::CLOCK_POLLS`] reads each.
pub fn start(rcc: &RCC, flash: &FLASH, crystal_hz: u32) -> Clocks {
    // On silicon HSION and HSIRDY are 1 after reset (RM0090 7.3.1): all zeros can only be the emulator, whose clock
    // block is not modelled.
    if rcc.cr().read().bits() == 0 {
        return Clocks {
            source: ClockSource::Virtual,
            cpu_hz: chip::PLL_HZ,
            apb1_hz: chip::PLL_HZ / 4,
        };
    }
    rcc.cr().modify(|_, w| w.hseon().on());
    let crystal = soon(|| rcc.cr().read().hserdy().is_ready());
    if !crystal {
        rcc.cr().modify(|_, w| w.hseon().off());
    }
    let input_hz = if crystal { crystal_hz } else { chip::HSI_HZ };
    rcc.pllcfgr().modify(|_, w| {
        let source = w.pllsrc();
        let w = if crystal { source.hse() } else { source.hsi() };
        // SAFETY: M = 4 or 8, N = 168 and Q = 7 lie in the ranges of RM0090 7.3.2.
        unsafe {
            w.pllm()
                .bits((input_hz / chip::PLL_INPUT_HZ) as u8)
                .plln()
                .bits(chip::PLL_N)
                .pllq()
                .bits(chip::PLL_Q)
        }
        .pllp()
        .div2()
    });
    rcc.cr().modify(|_, w| w.pllon().on());
    if !soon(|| rcc.cr().read().pllrdy().is_ready()) {
        rcc.cr().modify(|_, w| w.pllon().off());
        return Clocks {
            source: ClockSource::Bare,
            cpu_hz: chip::HSI_HZ,
            apb1_hz: chip::HSI_HZ,
        };
    }
    // Wait states before speed, or the next fetch fails (RM0090 3.5.1); prefetch and both caches hide most of them.
    flash.acr().modify(|_, w| {
        w.latency().set(chip::FLASH_WAIT_STATES);
        w.prften().set_bit().icen().set_bit().dcen().set_bit()
    });
    rcc.cfgr().modify(|_, w| w.ppre1().div4().ppre2().div2());
    rcc.cfgr().modify(|_, w| w.sw().pll());
    // The switch takes a few cycles of the slow clock; should it fail, the flag of the report is all that is wrong.
    soon(|| rcc.cfgr().read().sws().is_pll());
    let source = if crystal {
        // A crystal that dies from now on is a non-maskable interrupt: outputs off, restart on the internal oscillator. The
        // chip itself breaks the pulses of TIM1 (RM0090 7.2.7).
        rcc.cr().modify(|_, w| w.csson().on());
        ClockSource::Crystal
    } else {
        ClockSource::Internal
    };
    Clocks {
        source,
        cpu_hz: chip::PLL_HZ,
        apb1_hz: chip::PLL_HZ / chip::APB1_DIVIDER,
    }
}

/// Clock, option bytes and program for the hello.
pub fn status(clocks: &Clocks, flash: &FLASH) -> ChipStatus {
    if clocks.source == ClockSource::Virtual {
        return ChipStatus {
            image: image::check(),
            ..ChipStatus::VIRTUAL
        };
    }
    let options = flash.optcr().read();
    ChipStatus {
        clock: clocks.source,
        shortest_period_us: chip::period_cycles(JOINTS) / (clocks.cpu_hz / 1_000_000),
        // 0 is the highest level, 3 is off (RM0090 table 14).
        brown_out: 3 - options.bor_lev().bits(),
        read_out_protection: match options.rdp().bits() {
            0xAA => 0,
            0xCC => 2,
            _ => 1,
        },
        image: image::check(),
    }
}

/// Reads `ready` until it is true, at most [`chip::CLOCK_POLLS`] times.
fn soon(mut ready: impl FnMut() -> bool) -> bool {
    (0..chip::CLOCK_POLLS).any(|_| ready())
}
