//! The pins that the drive reads and writes, without state, and the pulse width of the torque command: channel 1N of an
//! advanced timer, with its break input.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use stm32f4xx_hal::pac::tim1::RegisterBlock;

use super::{DIRECTION, FAULT, PULSE_TOP, PulseTimer, PyboardDrive, SELECT};
use crate::board::EnablePin;

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
        gate(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        gate(true);
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
        let broken = take_break();
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

pub(crate) struct Pulse;

impl Pulse {
    /// Starts the timer with no width and the gate shut. Its clock must run.
    pub(crate) fn start() -> Self {
        let timer = timer();
        timer.psc().reset();
        timer.arr().write(|w| w.arr().set(PULSE_TOP - 1));
        timer.ccr1().reset();
        // PWM mode 1: high below the compare value, which is preloaded, so that a width changes between two pulses.
        timer
            .ccmr1_output()
            .write(|w| w.oc1m().pwm_mode1().oc1pe().enabled());
        // Alone, OC1N is the reference and not its complement (RM0090 17.4.9).
        timer.ccer().write(|w| w.cc1ne().set_bit());
        // Break by the pin, low; then the output is held low, and stays so until the gate is opened by hand.
        timer.bdtr().write(|w| {
            w.bke().enabled();
            w.bkp().active_low();
            w.ossr().idle_level();
            w.ossi().idle_level()
        });
        timer.egr().write(|w| w.ug().update());
        timer.cr1().write(|w| w.arpe().enabled().cen().enabled());
        Self
    }
}

impl pwm::ErrorType for Pulse {
    type Error = Infallible;
}

impl SetDutyCycle for Pulse {
    fn max_duty_cycle(&self) -> u16 {
        // One more than the counter reaches is high throughout.
        PULSE_TOP
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        timer().ccr1().write(|w| w.ccr().set(duty));
        if duty == 0 {
            // Taken over at once, within a running pulse too: the direction may change next.
            timer().egr().write(|w| w.ug().update());
        }
        Ok(())
    }
}

/// Lets pulses through, or holds the output low. A fault at the break input keeps it shut whatever is written here.
pub(crate) fn gate(open: bool) {
    timer().bdtr().modify(|_, w| w.moe().bit(open));
}

/// The break input has shut the gate since the last call.
pub(crate) fn take_break() -> bool {
    let status = timer().sr();
    let broken = status.read().bif().bit_is_set();
    if broken {
        // The flags are cleared by a zero; a one leaves the others alone.
        // SAFETY: every flag of the register may be written.
        status.write(|w| unsafe { w.bits(!(1 << 7)) });
    }
    broken
}

fn timer() -> &'static RegisterBlock {
    // SAFETY: start-up and the tick's task alone use the timer, one after the other.
    unsafe { &*PulseTimer::ptr() }
}
