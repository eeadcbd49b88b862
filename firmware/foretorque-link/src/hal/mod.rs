//! Hardware adapters, generic over embedded-hal 1.0: encoder, torque output and enable pin of a joint.
//!
//! ```text
//! encoder (SPI) ──► q                      tau ──► MotorStage ──► TorqueOutput: PWM and direction, or SPI DAC
//!                                                     │  ▲
//!                                       enable output ┘  └ fault input
//! ```
//! Every call is bounded: at most three bus transfers and a few pin accesses, without loops.

mod encoder;
mod output;
mod stage;

use embedded_hal::digital::OutputPin;
#[cfg(test)]
pub(crate) use encoder::tests::Chip;
pub use encoder::{AbsoluteEncoder, Direction, EncoderConfig, EncoderError};
pub use output::{DacModel, OutputError, PwmWithDirection, SpiDac, TorqueOutput};
pub use stage::{MotorStage, StageError, TorqueScale};

/// The torque enable input of a motor stage, active high. Off after construction.
///
/// ```
/// # use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};
/// # let pin = Mock::new(&[Transaction::set(State::Low), Transaction::set(State::High), Transaction::set(State::Low)]);
/// let mut enable = foretorque_link::hal::TorqueEnable::new(pin)?;
/// enable.on()?;
/// assert!(enable.is_on());
/// enable.off()?;
/// # enable.release().done();
/// # Ok::<(), embedded_hal_mock::eh1::MockError>(())
/// ```
#[derive(Debug)]
pub struct TorqueEnable<Pin> {
    pin: Pin,
    on: bool,
}

impl<Pin: OutputPin> TorqueEnable<Pin> {
    /// Takes the pin and switches torque off.
    ///
    /// Errors: those of the pin; it is then in an unknown state.
    pub fn new(mut pin: Pin) -> Result<Self, Pin::Error> {
        pin.set_low()?;
        Ok(Self { pin, on: false })
    }

    /// Lets torque through. Errors: those of the pin; torque then counts as off.
    pub fn on(&mut self) -> Result<(), Pin::Error> {
        self.pin.set_high()?;
        self.on = true;
        Ok(())
    }

    /// Switches torque off. Errors: those of the pin; torque then counts as on, so that the caller tries again.
    pub fn off(&mut self) -> Result<(), Pin::Error> {
        self.pin.set_low()?;
        self.on = false;
        Ok(())
    }

    /// Torque may flow.
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Gives the pin back, as it is.
    pub fn release(self) -> Pin {
        self.pin
    }
}

#[cfg(test)]
mod tests {
    use super::TorqueEnable;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};
    use std::io::ErrorKind;

    #[test]
    fn a_pin_that_stays_counts_as_what_it_is() {
        let [low, high] = [State::Low, State::High].map(Transaction::set);
        let broken = |set: &Transaction| {
            let error = MockError::Io(ErrorKind::BrokenPipe);
            set.clone().with_error(error)
        };
        for (sets, on) in [
            (vec![low.clone(), high.clone(), broken(&low)], true),
            (vec![low.clone(), broken(&high)], false),
        ] {
            let mut enable = TorqueEnable::new(Mock::new(&sets)).unwrap();
            assert_eq!(enable.on().is_ok(), on);
            assert!(!on || enable.off().is_err());
            assert_eq!(enable.is_on(), on);
            enable.release().done();
        }
    }
}
