use core::fmt;
use serde::{Deserialize, Serialize};

/// Reason why a parameter bank is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BankError {
    /// Not a parameter bank.
    NotABank,
    /// A bank of another format version.
    Version(u8),
    /// The checksum does not fit the bytes.
    Checksum,
    /// The content cannot be decoded although its checksum is right: unknown columns, or too many.
    Malformed,
    /// More entries than the format holds, or bytes than the buffer.
    TooLong,
    /// Made for the arm with this identity.
    WrongArm {
        /// Identity in the bank.
        #[serde(with = "postcard::fixint::le")]
        found: u32,
    },
    /// A column of the arm is missing; its place in the base set.
    MissingColumn(u8),
    /// The column at this place is not one of the arm's, or is repeated.
    UnknownColumn(u8),
    /// Value or deviation of the column at this place is not a finite number, or the deviation is negative.
    Column(u8),
    /// The network has another shape, activation or number of weights.
    NetworkShape,
    /// The weight at this place is not a finite number.
    Weight(#[serde(with = "postcard::fixint::le")] u16),
    /// The drive gain of this joint is missing, negative or not finite.
    DriveGain(u8),
    /// A limit of this joint is missing or not usable.
    Limit(u8),
    /// In a test pose the torque of this joint is not near that of the description, or beyond the limit.
    Implausible(u8),
}

impl fmt::Display for BankError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotABank => f.write_str("not a parameter bank"),
            Self::Version(version) => write!(f, "parameter bank of format version {version}"),
            Self::Checksum => f.write_str("parameter bank with a wrong checksum"),
            Self::Malformed => f.write_str("parameter bank with unreadable content"),
            Self::TooLong => f.write_str("parameter bank too long"),
            Self::WrongArm { found } => write!(f, "parameter bank for another arm ({found:08x})"),
            Self::MissingColumn(place) => write!(f, "base column {place} is missing"),
            Self::UnknownColumn(place) => write!(f, "column {place} is foreign or there twice"),
            Self::Column(place) => write!(f, "column {place} is not a usable number"),
            Self::NetworkShape => f.write_str("network of another shape"),
            Self::Weight(place) => write!(f, "network weight {place} is not finite"),
            Self::DriveGain(joint) => {
                write!(
                    f,
                    "drive gain of joint {} is not usable",
                    u16::from(*joint) + 1
                )
            }
            Self::Implausible(joint) => {
                let joint = u16::from(*joint) + 1;
                write!(f, "torque of joint {joint} is not plausible for the arm")
            }
            Self::Limit(joint) => {
                write!(
                    f,
                    "limits of joint {} are not usable",
                    u16::from(*joint) + 1
                )
            }
        }
    }
}

impl core::error::Error for BankError {}
