//! The pins that the drive reads and writes, without state.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};

use crate::board::{self, DIRECTION_PIN, FAULT_PIN, SELECT_PIN};
use crate::fault::EnablePin;
use crate::pulse;

/// Direction of the torque.
pub(crate) struct DirectionPin;

impl ErrorType for DirectionPin {
    type Error = Infallible;
}

impl OutputPin for DirectionPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        direct(1 << (DIRECTION_PIN + 16));
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        direct(1 << DIRECTION_PIN);
        Ok(())
    }
}

fn direct(bits: u32) {
    // SAFETY: BSRR is write-only and changes the named bits in one access (RM0090 8.4.7); no other code drives them.
    unsafe {
        (*board::DirectionPort::ptr())
            .bsrr()
            .write(|w| w.bits(bits))
    };
}

/// Selects the encoder or lets go of it.
pub(crate) fn select(on: bool) {
    let bits = 1 << if on { SELECT_PIN + 16 } else { SELECT_PIN };
    // SAFETY: as above.
    unsafe { (*board::SelectPort::ptr()).bsrr().write(|w| w.bits(bits)) };
}

/// Enable of the stage: the enable pin, and the gate in front of the pulses.
pub(crate) struct StageEnable(pub(crate) EnablePin);

impl ErrorType for StageEnable {
    type Error = Infallible;
}

impl OutputPin for StageEnable {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.set_low()?;
        pulse::gate(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        pulse::gate(true);
        self.0.set_high()
    }
}

/// Fault of the stage: high while there is none, and none was since it was read last.
pub(crate) struct FaultInput;

impl ErrorType for FaultInput {
    type Error = Infallible;
}

impl InputPin for FaultInput {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        // A fault shorter than a tick has ended the pulses all the same.
        let broken = pulse::take_break();
        Ok(pin_high() && !broken)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// Level of the fault pin. Not inlined: the tests stand in for the pin here, because the emulator has none.
#[inline(never)]
fn pin_high() -> bool {
    // SAFETY: a read of the input register, which has no side effect.
    let levels = unsafe { (*board::FaultPort::ptr()).idr().read().bits() };
    levels & 1 << FAULT_PIN != 0
}
