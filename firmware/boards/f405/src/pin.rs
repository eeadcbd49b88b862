//! Pins without an owner: written and read by number, also by the fault handlers.

use stm32f4xx_hal::pac::{GPIOA, GPIOB};

/// A port of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Port {
    /// Port A.
    A,
    /// Port B.
    B,
}

/// One pin of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// Its port.
    pub port: Port,
    /// Its number, 0 to 15.
    pub number: u8,
}

impl Pin {
    /// Drives the pin high or low.
    #[inline(always)]
    pub fn write(self, high: bool) {
        let bits = 1 << if high { self.number } else { self.number + 16 };
        // SAFETY: BSRR is write-only and changes the named bit in one access (RM0090 8.4.7); no other code drives it.
        unsafe {
            match self.port {
                Port::A => (*GPIOA::ptr()).bsrr().write(|w| w.bits(bits)),
                Port::B => (*GPIOB::ptr()).bsrr().write(|w| w.bits(bits)),
            }
        };
    }

    /// Level of the pin.
    #[inline(always)]
    pub fn is_high(self) -> bool {
        // SAFETY: a read of the input register, which has no side effect.
        let levels = unsafe {
            match self.port {
                Port::A => (*GPIOA::ptr()).idr().read().bits(),
                Port::B => (*GPIOB::ptr()).idr().read().bits(),
            }
        };
        levels & 1 << self.number != 0
    }
}
