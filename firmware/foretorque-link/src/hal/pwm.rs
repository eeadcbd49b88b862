use super::output::{OutputError, TorqueOutput, bounded};
use embedded_hal::digital::{Error as _, OutputPin};
use embedded_hal::pwm::{Error as _, SetDutyCycle};

/// Sign and magnitude: a pulse width for how much, a pin for which way; the input of most brushed and many servo stages.
///
/// Duty = round(|level| · largest duty). The largest duty is the largest current of the stage, and so belongs to
/// `TorqueScale::full_scale_a`. The direction pin is high for a positive level.
///
/// ```
/// # use embedded_hal_mock::eh1::{digital, pwm};
/// # let pulse = pwm::Mock::new(&[pwm::Transaction::max_duty_cycle(1000), pwm::Transaction::set_duty_cycle(250)]);
/// # let pin = digital::Mock::new(&[digital::Transaction::set(digital::State::High)]);
/// use foretorque_link::hal::{PwmWithDirection, TorqueOutput};
/// let mut output = PwmWithDirection::new(pulse, pin);
/// output.command(0.25)?;
/// # let (mut pulse, mut pin) = output.release();
/// # pulse.done();
/// # pin.done();
/// # Ok::<(), foretorque_link::hal::OutputError>(())
/// ```
#[derive(Debug)]
pub struct PwmWithDirection<Pulse, Pin> {
    pulse: Pulse,
    direction: Pin,
    /// Last level of the direction pin; `None` before the first command, and after a refused one.
    positive: Option<bool>,
}

impl<Pulse: SetDutyCycle, Pin: OutputPin> PwmWithDirection<Pulse, Pin> {
    /// Takes timer channel and pin, and touches neither.
    pub const fn new(pulse: Pulse, direction: Pin) -> Self {
        Self {
            pulse,
            direction,
            positive: None,
        }
    }

    /// Gives channel and pin back, as they are.
    pub fn release(self) -> (Pulse, Pin) {
        (self.pulse, self.direction)
    }

    fn turn(&mut self, positive: bool) -> Result<(), OutputError> {
        if self.positive == Some(positive) {
            return Ok(());
        }
        if self.positive.take().is_some() {
            // A stage that turns under pulses gets one of the old width in the new direction.
            self.duty(0)?;
        }
        let told = if positive {
            self.direction.set_high()
        } else {
            self.direction.set_low()
        };
        told.map_err(|error| OutputError::Direction(error.kind()))?;
        self.positive = Some(positive);
        Ok(())
    }

    fn duty(&mut self, duty: u16) -> Result<(), OutputError> {
        let set = self.pulse.set_duty_cycle(duty);
        set.map_err(|error| OutputError::Pulse(error.kind()))
    }
}

impl<Pulse: SetDutyCycle, Pin: OutputPin> TorqueOutput for PwmWithDirection<Pulse, Pin> {
    fn command(&mut self, level: f32) -> Result<(), OutputError> {
        let level = bounded(level);
        let largest = self.pulse.max_duty_cycle();
        // Rounded to nearest: at most the largest duty, because |level| is at most 1.
        let duty = (level.abs() * f32::from(largest) + 0.5) as u16;
        if duty == 0 {
            // No width has no direction: the pin stays, so that noise around zero does not toggle it.
            return self.duty(0);
        }
        self.turn(level > 0.0)?;
        self.duty(duty.min(largest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as Set};
    use embedded_hal_mock::eh1::pwm::{Mock as Pulse, Transaction as Duty};
    use std::io::ErrorKind;

    fn commanded(levels: &[f32], duties: &[Duty], pins: &[Set]) -> Vec<Result<(), OutputError>> {
        let mut output = PwmWithDirection::new(Pulse::new(duties), Pin::new(pins));
        let said = levels.iter().map(|&level| output.command(level)).collect();
        let (mut pulse, mut pin) = output.release();
        pulse.done();
        pin.done();
        said
    }

    #[test]
    fn the_duty_is_the_level_rounded_and_never_beyond_the_largest() {
        for (level, duty) in [
            (1.0, 999),
            (0.5, 500),
            (1e-3, 1),
            (7.0, 999),
            (f32::INFINITY, 999),
        ] {
            let duties = [Duty::max_duty_cycle(999), Duty::set_duty_cycle(duty)];
            let said = commanded(&[level], &duties, &[Set::set(State::High)]);
            assert_eq!(said, [Ok(())], "{level}");
        }
    }

    #[test]
    fn what_is_not_a_number_puts_nothing_out() {
        let duties = [Duty::max_duty_cycle(999), Duty::set_duty_cycle(0)];
        assert_eq!(commanded(&[f32::NAN], &duties, &[]), [Ok(())]);
    }

    #[test]
    fn the_width_is_zero_while_the_direction_turns() {
        let duties = [
            Duty::max_duty_cycle(100),
            Duty::set_duty_cycle(50),
            Duty::max_duty_cycle(100),
            Duty::set_duty_cycle(0),
            Duty::set_duty_cycle(25),
        ];
        let pins = [Set::set(State::High), Set::set(State::Low)];
        assert_eq!(commanded(&[0.5, -0.25], &duties, &pins), [Ok(()), Ok(())]);
    }

    #[test]
    fn a_direction_that_cannot_be_told_leaves_the_width_at_zero() {
        let broken = MockError::Io(ErrorKind::BrokenPipe);
        let duties = [
            Duty::max_duty_cycle(100),
            Duty::set_duty_cycle(50),
            Duty::max_duty_cycle(100),
            Duty::set_duty_cycle(0),
        ];
        let pins = [
            Set::set(State::High),
            Set::set(State::Low).with_error(broken),
        ];
        let said = commanded(&[0.5, -0.5], &duties, &pins);
        assert!(matches!(said[1], Err(OutputError::Direction(_))));
    }

    #[test]
    fn a_timer_that_refuses_is_reported() {
        let broken = MockError::Io(ErrorKind::BrokenPipe);
        let duties = [
            Duty::max_duty_cycle(100),
            Duty::set_duty_cycle(50).with_error(broken),
        ];
        let said = commanded(&[0.5], &duties, &[Set::set(State::High)]);
        assert!(matches!(said[0], Err(OutputError::Pulse(_))));
    }
}
