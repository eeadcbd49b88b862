use core::fmt;
use embedded_hal::spi::ErrorKind;

/// What went wrong with a reading.
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
    /// What the chip says was wrong: framing (bit 0), command (bit 1), parity (bit 2). The next reading is a position.
    Refused(u8),
    /// The first frame after a start, and the one after a bus error, bring the answer to nobody's question.
    Pipeline,
    /// The chip has not finished its start-up.
    NotReady,
    /// The magnet is too weak, or too far away.
    MagnetWeak,
    /// The magnet is too strong, or too near.
    MagnetStrong,
    /// The angle could not be computed: CORDIC overflow.
    Overflow,
    /// The reading moved farther than the joint can: it is not believed, and the count of turns is lost.
    Jump,
    /// The turn is not known: [`reference`](AbsoluteEncoder::reference) first.
    NoReference,
}

impl fmt::Display for EncoderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Configuration => f.write_str("encoder configuration cannot work"),
            Self::Bus(kind) => write!(f, "encoder bus: {kind}"),
            Self::Parity => f.write_str("encoder answer with a wrong parity"),
            Self::Flagged => f.write_str("encoder flags an error"),
            Self::Refused(bits) => write!(f, "encoder refused a frame ({bits:#05b})"),
            Self::Pipeline => f.write_str("encoder has not been asked yet"),
            Self::NotReady => f.write_str("encoder is not ready"),
            Self::MagnetWeak => f.write_str("encoder magnet too weak"),
            Self::MagnetStrong => f.write_str("encoder magnet too strong"),
            Self::Overflow => f.write_str("encoder angle overflow"),
            Self::Jump => f.write_str("encoder reading jumped"),
            Self::NoReference => f.write_str("encoder turn not known"),
        }
    }
}

impl core::error::Error for EncoderError {}
