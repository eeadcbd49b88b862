use core::fmt;
use embedded_hal::{digital, pwm, spi};

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

/// Failure of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputError {
    /// The SPI bus of the converter.
    Bus(spi::ErrorKind),
    /// The timer of the pulse width.
    Pulse(pwm::ErrorKind),
    /// The direction pin.
    Direction(digital::ErrorKind),
}

impl fmt::Display for OutputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(kind) => write!(f, "converter: {kind}"),
            Self::Pulse(kind) => write!(f, "pulse width: {kind}"),
            Self::Direction(kind) => write!(f, "direction pin: {kind}"),
        }
    }
}

impl core::error::Error for OutputError {}

/// `level` inside ±1; 0 for NaN.
pub(super) fn bounded(level: f32) -> f32 {
    if level >= 1.0 {
        1.0
    } else if level <= -1.0 {
        -1.0
    } else if level.is_nan() {
        0.0
    } else {
        level
    }
}
