use embedded_hal::digital::{Error as _, OutputPin};
use embedded_hal::pwm::{Error as _, SetDutyCycle};
use embedded_hal::spi::{Error as _, SpiDevice};
use embedded_hal::{digital, pwm, spi};
use foretorque::math::nearest;

/// Output of the torque command to a current controller, signed and scaled to ±1.
///
/// Implemented by [`PwmWithDirection`](super::PwmWithDirection) and [`SpiDac`](super::SpiDac).
pub trait TorqueOutput {
    /// Puts out `level`, as a part of the largest command; −1 to 1, positive accelerates +q.
    ///
    /// The caller passes a finite, bounded value. An adapter bounds it again, because a duty or code that wraps is full
    /// torque in the wrong direction.
    ///
    /// Errors: those of the pin, timer or bus; the output is then unknown.
    fn command(&mut self, level: f32) -> Result<(), OutputError>;
}

errors! {
    /// Failure of an output.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum OutputError {
        Bus(kind: spi::ErrorKind) = "converter: {kind}";
        /// (Its timer.)
        Pulse(kind: pwm::ErrorKind) = "pulse width: {kind}";
        Direction(kind: digital::ErrorKind) = "direction pin: {kind}";
    }
}

/// `level` inside ±1; 0 for NaN.
fn bounded(level: f32) -> f32 {
    if level.is_nan() {
        0.0
    } else {
        level.clamp(-1.0, 1.0)
    }
}

/// Supported converters, most significant bit first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DacModel {
    /// 12 bits, 16-bit frames (Microchip DS21897, register 5-1): channel A, unbuffered reference, gain 1, active. SPI mode 0:
    /// it reads at the rising edge.
    Mcp4921,
    /// 16 bits, 24-bit frames (Texas Instruments SLAS430, table 1): written to and put out on channel A. SPI mode 1: it reads
    /// at the falling edge.
    Dac8552A,
    /// As [`Dac8552A`](Self::Dac8552A), on channel B.
    Dac8552B,
}

impl DacModel {
    /// Codes from mid-scale, which is zero torque, to the end of the range of both signs.
    const fn half(self) -> u16 {
        match self {
            Self::Mcp4921 => 2047,
            Self::Dac8552A | Self::Dac8552B => 32_767,
        }
    }

    /// Frame of `code`, and number of its bytes.
    const fn frame(self, code: u16) -> ([u8; 3], usize) {
        let [high, low] = code.to_be_bytes();
        match self {
            Self::Mcp4921 => ([0x30 | (high & 0x0f), low, 0], 2),
            Self::Dac8552A => ([0x10, high, low], 3),
            Self::Dac8552B => ([0x24, high, low], 3),
        }
    }
}

/// Analogue command of a servo drive, through a converter whose mid-scale is zero torque.
///
/// Code = mid-scale + round(level · half-scale): with a reference of V_ref, the output is V_ref / 2 · (1 + level). The
/// analogue stage of the board scales it to the drive's input, such as ±10 V. One least significant bit is 1/2047 of the
/// largest current with 12 bits, 1/32767 with 16.
///
/// ```
/// # use embedded_hal_mock::eh1::spi::{Mock, Transaction};
/// # let spi = Mock::new(&[Transaction::transaction_start(), Transaction::write_vec(vec![0x38, 0x00]), Transaction::transaction_end()]);
/// use foretorque_link::hal::{DacModel, SpiDac, TorqueOutput};
/// let mut output = SpiDac::new(spi, DacModel::Mcp4921);
/// output.command(0.0)?;
/// # output.release().done();
/// # Ok::<(), foretorque_link::hal::OutputError>(())
/// ```
#[derive(Debug)]
pub struct SpiDac<Spi> {
    spi: Spi,
    model: DacModel,
}

impl<Spi: SpiDevice> SpiDac<Spi> {
    /// Takes the device and sends nothing.
    pub const fn new(spi: Spi, model: DacModel) -> Self {
        Self { spi, model }
    }

    /// Gives the device back, as it is.
    pub fn release(self) -> Spi {
        self.spi
    }
}

impl<Spi: SpiDevice> TorqueOutput for SpiDac<Spi> {
    fn command(&mut self, level: f32) -> Result<(), OutputError> {
        let half = i32::from(self.model.half());
        let swing = nearest(bounded(level) * half as f32);
        let code = (half + 1 + swing.min(half).max(-half)) as u16;
        let (bytes, count) = self.model.frame(code);
        let sent = self.spi.write(bytes.get(..count).unwrap_or_default());
        sent.map_err(|error| OutputError::Bus(error.kind()))
    }
}

/// Sign and magnitude: pulse width and direction pin, the input of most brushed and many servo stages.
///
/// Duty = round(|level| · largest duty). The largest duty is the largest current of the stage, `TorqueScale::full_scale_a`.
/// The direction pin is high for a positive level.
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
    /// Last direction; `None` before the first command, and after one that the pin refused.
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
            // A stage that reverses under pulses would put out one of the old width in the new direction.
            self.duty(0)?;
        }
        let set = if positive {
            self.direction.set_high()
        } else {
            self.direction.set_low()
        };
        set.map_err(|error| OutputError::Direction(error.kind()))?;
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
        // At most the largest duty, because |level| is at most 1.
        let duty = nearest(level.abs() * f32::from(largest)) as u16;
        if duty == 0 {
            // The pin stays, so that noise around zero does not toggle it.
            return self.duty(0);
        }
        self.turn(level > 0.0)?;
        self.duty(duty.min(largest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::Chip;
    use embedded_hal::spi::ErrorKind;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as Set};
    use embedded_hal_mock::eh1::pwm::{Mock as Pulse, Transaction as Duty};
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};

    #[test]
    fn every_model_gets_its_own_frame() {
        use DacModel::{Dac8552A, Dac8552B, Mcp4921};
        for (model, level, frame) in [
            (Mcp4921, 0.0, vec![0x38, 0x00]),
            (Mcp4921, 1.0, vec![0x3f, 0xff]),
            (Mcp4921, -1.0, vec![0x30, 0x01]),
            (Mcp4921, 9.0, vec![0x3f, 0xff]),
            (Mcp4921, f32::NEG_INFINITY, vec![0x30, 0x01]),
            (Mcp4921, f32::NAN, vec![0x38, 0x00]),
            (Mcp4921, 1.0 / 2047.0, vec![0x38, 0x01]),
            (Mcp4921, -0.6 / 2047.0, vec![0x37, 0xff]),
            (Dac8552A, 0.0, vec![0x10, 0x80, 0x00]),
            (Dac8552A, -0.5, vec![0x10, 0x40, 0x00]),
            (Dac8552B, 1.0, vec![0x24, 0xff, 0xff]),
        ] {
            let (start, end) = (
                Transaction::transaction_start(),
                Transaction::transaction_end(),
            );
            let bus = Mock::new(&[start, Transaction::write_vec(frame), end]);
            let mut output = SpiDac::new(bus, model);
            output.command(level).unwrap();
            output.release().done();
        }
    }

    const BROKEN: MockError = MockError::Io(std::io::ErrorKind::BrokenPipe);

    /// The encoder takes no command of a converter; the mock of the crate cannot fail.
    #[test]
    fn a_failing_bus_is_reported() {
        let failed = SpiDac::new(Chip::new(0), DacModel::Dac8552A).command(0.1);
        assert_eq!(failed, Err(OutputError::Bus(ErrorKind::Other)));
    }

    fn commanded(levels: &[f32], duties: &[Duty], pins: &[Set]) -> Vec<Result<(), OutputError>> {
        let mut output = PwmWithDirection::new(Pulse::new(duties), Pin::new(pins));
        let results = levels.iter().map(|&level| output.command(level)).collect();
        let (mut pulse, mut pin) = output.release();
        pulse.done();
        pin.done();
        results
    }

    #[test]
    fn the_duty_is_the_rounded_and_bounded_level() {
        for (level, duty) in [
            (1.0, 999),
            (0.5, 500),
            (1e-3, 1),
            (7.0, 999),
            (f32::INFINITY, 999),
        ] {
            let duties = [Duty::max_duty_cycle(999), Duty::set_duty_cycle(duty)];
            let results = commanded(&[level], &duties, &[Set::set(State::High)]);
            assert_eq!(results, [Ok(())], "{level}");
        }
        let duties = [Duty::max_duty_cycle(999), Duty::set_duty_cycle(0)];
        assert_eq!(commanded(&[f32::NAN], &duties, &[]), [Ok(())]);
    }

    #[test]
    fn the_width_is_zero_while_the_direction_changes() {
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
    fn a_failing_pin_leaves_the_width_at_zero_and_a_failing_timer_is_reported() {
        let duties = [Duty::max_duty_cycle(100), Duty::set_duty_cycle(50)];
        let stopped = [Duty::max_duty_cycle(100), Duty::set_duty_cycle(0)];
        let [high, low] = [State::High, State::Low].map(Set::set);
        let pins = [high.clone(), low.with_error(BROKEN)];
        let results = commanded(&[0.5, -0.5], &[duties.clone(), stopped].concat(), &pins);
        assert!(matches!(results[1], Err(OutputError::Direction(_))));
        let [largest, width] = duties;
        let results = commanded(&[0.5], &[largest, width.with_error(BROKEN)], &[high]);
        assert!(matches!(results[0], Err(OutputError::Pulse(_))));
    }
}
