use core::fmt;
use embedded_hal::spi::ErrorKind;

/// Errors of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderError {
    /// The configuration cannot work: a ratio that is not positive, a step of half a turn or more.
    Configuration,
    /// The bus.
    Bus(ErrorKind),
    /// Parity of the answer: a bit was flipped on the line, or nobody is there.
    Parity,
    /// The chip flags an error of the frame before; its error register is read, and so cleared, next.
    Flagged,
    /// Error that the chip reports: framing (bit 0), command (bit 1), parity (bit 2). The next reading is a position.
    Refused(u8),
    /// The first frame after a start, and the one after a bus error, bring the answer to nobody's question.
    Pipeline,
    /// The chip has not finished its start-up, or is not there and its line is low.
    NotReady,
    /// The magnet is too weak, or too far away.
    MagnetWeak,
    /// The magnet is too strong, or too near.
    MagnetStrong,
    /// The angle could not be computed: CORDIC overflow.
    Overflow,
    /// The reading moved farther than the joint can: it is not believed, and the count of turns is lost.
    Jump,
    /// The turn is not known: [`reference`](super::AbsoluteEncoder::reference) first.
    NoReference,
}

impl EncoderError {
    /// Name of the error, without its payload.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Configuration => "encoder configuration cannot work",
            Self::Bus(_) => "encoder bus",
            Self::Parity => "encoder answer with a wrong parity",
            Self::Flagged => "encoder flags an error",
            Self::Refused(_) => "encoder refused a frame",
            Self::Pipeline => "encoder has not been asked yet",
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
