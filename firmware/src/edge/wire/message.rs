//! What is said on the link, in both directions.

use super::{
    BoardHello, Configuration, EvaluatedFrame, ExcitedFrame, FullTorqueFrame, MotionFrame,
    SampleFrame, TorqueFrame,
};
use crate::edge::bank::BankError;
use crate::edge::telemetry::Statistics;
use crate::excitation::{Cue, ExcitationError, Stage};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Bank bytes that one frame carries.
pub const CHUNK: usize = 64;
/// A piece of a parameter bank.
pub type Chunk = heapless::Vec<u8, CHUNK>;
/// A short name in ASCII.
pub type Name = heapless::String<24>;

/// From the host to the board. Variants are only ever appended: their index is the tag on the wire.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HostMessage<const N: usize> {
    /// Who is there? Restarts the count of sequence numbers. Answer: [`BoardMessage::Hello`].
    Hello,
    /// Input of one tick. Answer, at once or at the next timer tick: torque in the reply mode chosen.
    Sample(SampleFrame<N>),
    /// Shares of the active set for one motion, without state. Answer: [`BoardMessage::Evaluated`].
    Evaluate(MotionFrame<N>),
    /// Period, pacing and reply mode; restarts the tick at 0. Refused while learning is on. Answer: ack.
    Configure(Configuration),
    /// Learning on or off (frozen). Answer: ack.
    Learning {
        /// Learn from the next tick on.
        on: bool,
    },
    /// A piece of a bank; offset 0 begins an upload, the pieces follow in order. Answer: ack.
    BankWrite {
        /// Place of the first byte in the bank.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
        /// The bytes.
        bytes: Chunk,
    },
    /// The upload is complete and shall be taken over. Answer: ack, and the set is in force in the next tick.
    BankCommit {
        /// Length of the bank in bytes.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// CRC-32 over the whole bank, its own checksum included.
        #[serde(with = "postcard::fixint::le")]
        crc: u32,
    },
    /// A piece of the bank in force; offset 0 takes the snapshot that the further pieces come from. Answer: chunk.
    BankRead {
        /// Place of the first byte wanted.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
    },
    /// Counters. Answer: [`BoardMessage::Statistics`].
    Statistics,
    /// Back to the state after boot: the bank of the firmware, learning off, tick 0, counters 0. Answer: ack.
    Reset,
    /// The upload is an excitation ([`ExcitationProgram`](crate::excitation::ExcitationProgram)), complete, and shall be
    /// taken over. Answer: ack, and its check begins with the next tick.
    ExcitationLoad {
        /// Its length in bytes.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// CRC-32 over it.
        #[serde(with = "postcard::fixint::le")]
        crc: u32,
    },
    /// Start, stop, release the excitation, or ask for its stage. Answer: [`BoardMessage::Excitation`].
    Excitation(Cue),
}

/// From the board to the host. A frame carries the sequence number of the host's frame that it answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum BoardMessage<const N: usize> {
    /// Who the board is; also sent unasked after boot, with sequence number 0.
    Hello(BoardHello),
    /// Torque of one tick, shares of one joint.
    Torque(TorqueFrame<N>),
    /// Torque of one tick, all shares.
    FullTorque(FullTorqueFrame<N>),
    /// Shares for one motion.
    Evaluated(EvaluatedFrame<N>),
    /// Done.
    Ack,
    /// Not done, and nothing has changed.
    Nack(NackReason),
    /// A piece of the bank in force; empty behind its end.
    BankChunk {
        /// Place of the first byte in the bank.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
        /// Length of the whole bank.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// The bytes.
        bytes: Chunk,
    },
    /// Counters since boot or reset.
    Statistics(Statistics),
    /// Where the excitation stands.
    Excitation(Stage),
    /// Torque of one tick whose desired motion was the excitation's, with that motion.
    Excited(ExcitedFrame<N>),
}

/// Why something was not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NackReason {
    /// Only while learning is off.
    LearningOn,
    /// The board has no such capability.
    NotCapable,
    /// The period is outside [`Configuration::PERIODS_US`].
    Period,
    /// The chunk does not follow the one before; the next byte wanted is this one.
    Gap {
        /// Offset of the next byte.
        #[serde(with = "postcard::fixint::le")]
        expected: u16,
    },
    /// The bank is longer than the board's room.
    TooLong,
    /// The bytes received are not those that were announced.
    Checksum,
    /// The bank is not one for this board.
    Bank(BankError),
    /// The excitation cannot be played, or not now.
    Excitation(ExcitationError),
}

impl fmt::Display for NackReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LearningOn => f.write_str("only while learning is off"),
            Self::NotCapable => f.write_str("the board cannot do that"),
            Self::Period => f.write_str("period out of range"),
            Self::Gap { expected } => write!(f, "chunk out of order, byte {expected} is next"),
            Self::TooLong => f.write_str("parameter bank too long"),
            Self::Checksum => f.write_str("parameter bank damaged or incomplete"),
            Self::Bank(error) => write!(f, "{error}"),
            Self::Excitation(error) => write!(f, "{error}"),
        }
    }
}
