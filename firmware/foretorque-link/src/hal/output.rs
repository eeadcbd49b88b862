use core::fmt;
use embedded_hal::{digital, pwm, spi};

/// Where a torque command leaves the board: the input of a current controller, signed and scaled to ±1.
///
/// Implemented by [`PwmWithDirection`](super::PwmWithDirection) and [`SpiDac`](super::SpiDac).
pub trait TorqueOutput {
    /// Puts out `level`, as a part of the largest command; −1 to 1, positive accelerates +q.
    ///
    /// The caller has bounded it and made sure that it is a number; an adapter bounds it once more, because a duty or
    /// code that wraps is full torque in the wrong direction.
    ///
    /// Errors: those of the pin, timer or bus; what is put out is then unknown.
    fn command(&mut self, level: f32) -> Result<(), OutputError>;
}

/// Why a command did not get out.
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

/// `level` inside ±1; what is not a number is no command.
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
