//! Peripherals of the drive: the pins, without state; the pulse width of the torque command, channel 1N of an advanced timer
//! with its break input; the encoder's bus, SPI mode 1 with eight bits, never waiting for ever.

use core::convert::Infallible;

use cortex_m::asm;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use embedded_hal::spi::{self, ErrorKind, Operation, SpiDevice};
use stm32f4xx_hal::pac::{spi1, tim1};

use super::{
    DIRECTION, ENCODER_DIVIDER, ENCODER_POLLS, EncoderBus, FAULT, PULSE_TOP, PulseTimer,
    PyboardDrive, SELECT, SELECT_CYCLES,
};
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

fn timer() -> &'static tim1::RegisterBlock {
    // SAFETY: start-up and the tick's task alone use the timer, one after the other.
    unsafe { &*PulseTimer::ptr() }
}

/// Result of [`exchange`] without a byte: beyond every byte.
const NONE: u32 = 1 << 8;

pub(crate) struct EncoderDevice;

impl EncoderDevice {
    /// Sets the bus up. Its clock must run.
    pub(crate) fn start() -> Self {
        // Master, select by hand, mode 1: data change with the leading edge (RM0090 28.3.1).
        bus().cr1().write(|w| {
            w.mstr().master();
            w.ssm().enabled();
            w.ssi().slave_not_selected();
            w.cpol().idle_low();
            w.cpha().second_edge();
            w.br().set(ENCODER_DIVIDER);
            w.spe().enabled()
        });
        Self
    }
}

impl spi::ErrorType for EncoderDevice {
    type Error = ErrorKind;
}

impl SpiDevice for EncoderDevice {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        // What a transfer that was given up has left.
        let _ = bus().dr().read();
        select(true);
        asm::delay(SELECT_CYCLES);
        let done = operations.iter_mut().try_for_each(execute);
        asm::delay(SELECT_CYCLES);
        select(false);
        asm::delay(SELECT_CYCLES);
        done
    }
}

/// One operation of a frame. Request and answer are one transfer.
fn execute(operation: &mut Operation<'_, u8>) -> Result<(), ErrorKind> {
    let Operation::TransferInPlace(bytes) = operation else {
        return Err(ErrorKind::Other);
    };
    for byte in bytes.iter_mut() {
        *byte = u8::try_from(exchange(u32::from(*byte))).map_err(|_| ErrorKind::Overrun)?;
    }
    Ok(())
}

/// One byte each way, at most [`ENCODER_POLLS`] reads of the flag; [`NONE`] when none came. Not inlined: the tests stand
/// in for the encoder here, because the emulator has none.
#[inline(never)]
extern "C" fn exchange(byte: u32) -> u32 {
    bus().dr8().write(|w| w.dr().set(byte as u8));
    let come = (0..ENCODER_POLLS).any(|_| bus().sr().read().rxne().bit_is_set());
    if come {
        u32::from(bus().dr8().read().dr().bits())
    } else {
        NONE
    }
}

fn bus() -> &'static spi1::RegisterBlock {
    // SAFETY: start-up and the tick's task alone use the bus, one after the other.
    unsafe { &*EncoderBus::ptr() }
}
