//! The pins that the drive reads and writes, without state.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};

use super::{DIRECTION, FAULT, PyboardDrive, SELECT, pulse};
use crate::fault::EnablePin;

/// Direction of the torque.
pub(crate) struct DirectionPin;

impl ErrorType for DirectionPin {
    type Error = Infallible;
}

impl OutputPin for DirectionPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        DIRECTION.write(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        DIRECTION.write(true);
        Ok(())
    }
}

/// Selects the encoder or lets go of it.
pub(crate) fn select(on: bool) {
    SELECT.write(!on);
}

/// Enable of the stage: the enable pin, and the gate in front of the pulses.
pub(crate) struct StageEnable;

impl ErrorType for StageEnable {
    type Error = Infallible;
}

impl OutputPin for StageEnable {
    fn set_low(&mut self) -> Result<(), Infallible> {
        EnablePin::<PyboardDrive>::default().set_low()?;
        pulse::gate(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        pulse::gate(true);
        EnablePin::<PyboardDrive>::default().set_high()
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
    FAULT.is_high()
}
