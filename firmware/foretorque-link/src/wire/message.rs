//! Messages of the link, in both directions.

use super::{
    BoardHello, Configuration, EvaluatedFrame, ExcitedFrame, FullTorqueFrame, MotionFrame,
    SampleFrame, TelemetryFrame, TorqueFrame,
};
use crate::bank::BankError;
use crate::excitation::{ExcitationCommand, ExcitationError, ExcitationState};
use crate::safety::SafetyReason;
use crate::store::StoreError;
use crate::telemetry::Statistics;
use core::fmt;
use serde::{Deserialize, Serialize};

/// Bank bytes that one frame carries.
pub const CHUNK: usize = 64;
/// A piece of a parameter bank.
pub type Chunk = heapless::Vec<u8, CHUNK>;
/// A short name in ASCII.
pub type Name = heapless::String<24>;
/// Bytes of a challenge, and of the answer to it.
pub const MAC_BYTES: usize = 16;

/// Which parameters are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BankSource {
    /// Those in force, with all that was learnt.
    Live,
    /// Those that stand in for them: the last ones loaded or committed.
    Committed,
    /// Those in the store.
    Stored,
}

/// From the host to the board. Variants are only ever appended: their index is the tag on the wire.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HostMessage<const N: usize> {
    /// Who is there? Restarts the count of sequence numbers. Answer: [`BoardMessage::Hello`].
    Hello,
    /// Input of one tick. Answer, at once or at the next timer tick: torque in the reply mode chosen, zero unless armed.
    Sample(SampleFrame<N>),
    /// Shares of the active set for one motion, without state. Answer: [`BoardMessage::Evaluated`].
    Evaluate(MotionFrame<N>),
    /// Period, pacing and reply mode; restarts the tick at 0. Refused while armed or learning. Answer: ack.
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
        /// Answer to the challenge, where the board has a write key.
        mac: Option<[u8; MAC_BYTES]>,
    },
    /// A piece of a bank; offset 0 takes the snapshot that the further pieces come from. Answer: chunk.
    BankRead {
        /// Whose parameters.
        source: BankSource,
        /// Place of the first byte wanted.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
    },
    /// Counters. Answer: [`BoardMessage::Statistics`].
    Statistics,
    /// Back to the state after boot: the bank of the firmware, learning off, tick 0, counters 0. A latched fault stays.
    /// Refused while armed. Answer: ack.
    Reset,
    /// Let torque through. Refused unless the board is sound and hears fresh, plausible samples. Answer: ack.
    Arm,
    /// The torque goes to zero, then the board is disarmed. Answer: ack.
    Disarm,
    /// Emergency stop: torque zero and enable pin off at once; a fault is latched. Acted on even when it comes twice or
    /// late. Answer: ack.
    Stop,
    /// Forget a latched fault; the board is then disarmed. Answer: ack.
    ClearFault,
    /// Ask the learner: 1 snapshot, 2 rollback, 3 commit, 4 zero payload. Answer: ack, and the outcome is among its
    /// decisions.
    Request {
        /// Number of the request.
        code: u8,
    },
    /// Keep the parameters in force over power-off. Refused while armed or learning. Answer, when it is done: ack.
    Save,
    /// Take over the stored parameters. Refused while armed or learning. Answer, when it is done: ack.
    Restore,
    /// Stream these fields of every `every`-th tick; 0 fields end the stream. Refused where the line has no room for them.
    /// Answer: ack.
    Telemetry {
        /// Sum of [`Field`](super::Field) bits.
        #[serde(with = "postcard::fixint::le")]
        fields: u16,
        /// Ticks from record to record.
        #[serde(with = "postcard::fixint::le")]
        every: u16,
    },
    /// Request for the bytes that a signature covers. Answer: [`BoardMessage::Challenge`], good for one commit.
    Challenge,
    /// Start the processor anew, torque off. The fault that is latched stays. Answer: the hello after boot.
    Reboot,
    /// The upload is an excitation ([`ExcitationProgram`](crate::excitation::ExcitationProgram)), complete, and shall be
    /// taken over. Refused while armed or learning. Answer: ack, and its check begins with the next tick.
    ExcitationLoad {
        /// Its length in bytes.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// CRC-32 over it.
        #[serde(with = "postcard::fixint::le")]
        crc: u32,
        /// Answer to the challenge, where the board has a write key.
        mac: Option<[u8; MAC_BYTES]>,
    },
    /// Start, stop, release the excitation, or ask for its stage. Answer: [`BoardMessage::Excitation`].
    Excitation(ExcitationCommand),
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
    /// Fields of one tick, as far as one frame holds; unasked, with sequence number 0.
    Telemetry(TelemetryFrame),
    /// Bytes that no challenge had before.
    Challenge {
        /// The bytes.
        nonce: [u8; MAC_BYTES],
    },
    /// Where the excitation stands.
    Excitation(ExcitationState),
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
    /// Only while disarmed, with the torque at zero.
    Armed,
    /// Safety says no, for this reason.
    Unsafe(SafetyReason),
    /// An earlier request is not done yet.
    Busy,
    /// The board has a write key, and the answer to its challenge is missing or wrong.
    Key,
    /// The store failed; the board runs on from RAM.
    Store(StoreError),
    /// The line has no room for these fields so often; so seldom it has, or never where this is 0.
    Bandwidth {
        /// Ticks from record to record.
        #[serde(with = "postcard::fixint::le")]
        every: u16,
    },
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
            Self::Armed => f.write_str("only while disarmed"),
            Self::Unsafe(reason) => write!(f, "{reason}"),
            Self::Busy => f.write_str("busy with what was asked before"),
            Self::Key => f.write_str("the write key's signature is missing or wrong"),
            Self::Store(error) => write!(f, "{error}"),
            Self::Bandwidth { every: 0 } => f.write_str("the line has no room for telemetry"),
            Self::Bandwidth { every } => {
                write!(f, "the line has room for that every {every} ticks")
            }
        }
    }
}
