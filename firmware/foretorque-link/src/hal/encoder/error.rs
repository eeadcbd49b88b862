use core::fmt;
use embedded_hal::spi::ErrorKind;

/// Error of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderError {
    /// Invalid configuration: a ratio that is not positive, a step of half a turn or more.
    Configuration,
    /// Error of the bus.
    Bus(ErrorKind),
    /// Wrong parity of the answer: a bit flipped on the line, or no chip answers.
    Parity,
    /// The chip flags an error of the frame before; the next reading reads and clears its error register.
    Flagged,
    /// Error register of the chip: framing (bit 0), command (bit 1), parity (bit 2). The next reading is a position.
    Refused(u8),
    /// The frame after a start or a bus error has no valid answer.
    Pipeline,
    /// The chip has not finished its start-up, or is absent and its line low.
    NotReady,
    /// The magnet is too weak, or too far away.
    MagnetWeak,
    /// The magnet is too strong, or too near.
    MagnetStrong,
    /// CORDIC overflow of the chip.
    Overflow,
    /// The reading moved farther than the joint can: it is dropped, and the count of turns is lost.
    Jump,
    /// The turn is not known: [`reference`](super::AbsoluteEncoder::reference) first.
    NoReference,
}

impl EncoderError {
    /// Description without the payload.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Configuration => "encoder configuration is invalid",
            Self::Bus(_) => "encoder bus",
            Self::Parity => "encoder answer with a wrong parity",
            Self::Flagged => "encoder flags an error",
            Self::Refused(_) => "encoder refused a frame",
            Self::Pipeline => "encoder has no valid answer yet",
            Self::NotReady => "encoder is not ready",
            Self::MagnetWeak => "encoder magnet too weak",
            Self::MagnetStrong => "encoder magnet too strong",
            Self::Overflow => "encoder angle overflow",
            Self::Jump => "encoder reading jumped",
            Self::NoReference => "encoder turn not known",
        }
    }
}

impl fmt::Display for EncoderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())?;
        match self {
            Self::Bus(kind) => write!(f, ": {kind}"),
            Self::Refused(bits) => write!(f, " ({bits:#05b})"),
            _ => Ok(()),
        }
    }
}

impl core::error::Error for EncoderError {}
