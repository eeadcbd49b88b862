//! Messages of the link, in both directions, and the fields of telemetry.

use super::{
    BoardHello, Chunk, Configuration, EvaluatedFrame, ExcitedFrame, FullTorqueFrame, MAC_BYTES,
    MotionFrame, SampleFrame, TorqueFrame,
};
use crate::bank::BankError;
use crate::excitation::{ExcitationCommand, ExcitationError, ExcitationState};
use crate::safety::SafetyReason;
use crate::store::StoreError;
use crate::telemetry::Statistics;
use serde::{Deserialize, Serialize};

/// Parameters to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum BankSource {
    /// Those in force, with everything learnt.
    Live,
    /// The fallback: those last loaded or committed.
    Committed,
    /// Those in the store.
    Stored,
}

/// Message from the host to the board. Variants are only ever appended: their index is the tag on the wire.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HostMessage<const N: usize> {
    /// Requests the hello and restarts the sequence. Reply: [`BoardMessage::Hello`].
    Hello,
    /// Input of one tick. Reply, at once or at the next timer tick: torque in the reply mode, zero unless armed.
    Sample(SampleFrame<N>),
    /// Requests the shares of the active set for one motion, without state. Reply: [`BoardMessage::Evaluated`].
    Evaluate(MotionFrame<N>),
    /// Sets period, pacing and reply mode; restarts the tick at 0. Refused while armed or learning. Reply: ack.
    Configure(Configuration),
    /// Switches learning. Reply: ack.
    Learning {
        /// Learn from the next tick on.
        on: bool,
    },
    /// A piece of an upload; offset 0 begins it, the pieces follow in order. Reply: ack.
    BankWrite {
        /// Place of the first byte in the bank.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
        /// The bytes.
        bytes: Chunk,
    },
    /// Brings the uploaded bank into force from the next tick on. Reply: ack.
    BankCommit {
        /// Length of the bank in bytes.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// CRC-32 over the whole bank, its own checksum included.
        #[serde(with = "postcard::fixint::le")]
        crc: u32,
        /// Signature over the challenge, where the board has a write key.
        mac: Option<[u8; MAC_BYTES]>,
    },
    /// Requests a piece of a bank; offset 0 takes the snapshot that the further pieces come from. Reply: chunk.
    BankRead {
        /// Parameters to read.
        source: BankSource,
        /// Place of the first byte.
        #[serde(with = "postcard::fixint::le")]
        offset: u16,
    },
    /// Requests the counters. Reply: [`BoardMessage::Statistics`].
    Statistics,
    /// Restores the state of a board with an empty store: bank of the firmware, learning off, tick 0, counters 0, default
    /// configuration. A latched fault stays.
    /// Refused while armed. Reply: ack.
    Reset,
    /// Lets torque through. Refused with a fault, or without fresh, plausible samples. Reply: ack.
    Arm,
    /// Ramps the torque to zero, then disarms. Reply: ack.
    Disarm,
    /// Emergency stop: torque zero and enable pin off at once; latches a fault. Acts also on a repeated or late frame.
    /// Reply: ack.
    Stop,
    /// Clears a latched fault; the board is then disarmed. Reply: ack.
    ClearFault,
    /// Request to the learner: 1 snapshot, 2 rollback, 3 commit, 4 zero payload. Reply: ack; the outcome is a decision
    /// of the learner.
    Request {
        /// Number of the request.
        code: u8,
    },
    /// Stores the committed parameters. Refused while armed or learning. Reply, when it is done: ack.
    Save,
    /// Brings the stored parameters into force. Refused while armed or learning. Reply, when it is done: ack.
    Restore,
    /// Streams these fields of every `every`-th tick; no fields end the stream. Refused beyond the link budget. Reply: ack.
    Telemetry {
        /// Sum of [`Field`](super::Field) bits.
        #[serde(with = "postcard::fixint::le")]
        fields: u16,
        /// Ticks between records.
        #[serde(with = "postcard::fixint::le")]
        every: u16,
    },
    /// Requests the bytes that the next signature has to cover. Reply: [`BoardMessage::Challenge`], valid for one signature.
    Challenge,
    /// Restarts the processor, torque off. A latched fault stays. Reply: the hello after boot.
    Reboot,
    /// Loads the upload as an excitation ([`ExcitationProgram`](crate::excitation::ExcitationProgram)); its check begins
    /// with the next tick. Refused while armed or learning. Reply: ack.
    ExcitationLoad {
        /// Length in bytes.
        #[serde(with = "postcard::fixint::le")]
        length: u16,
        /// CRC-32 over it.
        #[serde(with = "postcard::fixint::le")]
        crc: u32,
        /// Signature over the challenge, where the board has a write key.
        mac: Option<[u8; MAC_BYTES]>,
    },
    /// Starts, stops or releases the excitation, or requests its state. Reply: [`BoardMessage::Excitation`].
    Excitation(ExcitationCommand),
    /// Permits the next [protected](Self::protected) order on a board with a write key, if it is this one. Reply: ack.
    Unlock {
        /// Tag and first byte of the order.
        order: [u8; 2],
        /// Signature over the challenge and the order.
        mac: [u8; MAC_BYTES],
    },
}

impl<const N: usize> HostMessage<N> {
    /// Tag and first byte of an order that needs a permission on a board with a write key: it changes model, learnt state
    /// or store. Uploads have signatures of their own.
    pub const fn protected(&self) -> Option<[u8; 2]> {
        match self {
            Self::Learning { on: true } => Some([4, 1]),
            Self::Reset => Some([9, 0]),
            Self::Request { code } => Some([14, *code]),
            Self::Save => Some([15, 0]),
            Self::Restore => Some([16, 0]),
            _ => None,
        }
    }
}

/// Message from the board to the host. A reply carries the sequence number of the frame that it answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum BoardMessage<const N: usize> {
    /// Identity of the board; also sent unasked after boot, with sequence number 0.
    Hello(BoardHello),
    /// Torque of one tick, shares of one joint.
    Torque(TorqueFrame<N>),
    /// Torque of one tick, all shares.
    FullTorque(FullTorqueFrame<N>),
    /// Shares for one motion.
    Evaluated(EvaluatedFrame<N>),
    /// Done.
    Ack,
    /// Refused; nothing has changed.
    Nack(NackReason),
    /// A piece of a bank; empty behind its end.
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
    /// Fields of one tick that fit one frame; unasked, with sequence number 0.
    Telemetry(TelemetryFrame),
    /// Bytes that the next signature has to cover; no challenge had them before.
    Challenge {
        /// The bytes.
        nonce: [u8; MAC_BYTES],
    },
    /// State of the excitation.
    Excitation(ExcitationState),
    /// Torque of one tick of an excitation, with its desired motion.
    Excited(ExcitedFrame<N>),
}

/// Longest time that brakes may take to close, ms.
const MOST_MS: u16 = Configuration::MAX_BRAKE_CLOSE_MS;

errors! {
    /// Reason of a refusal.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    pub enum NackReason {
        LearningOn = "only while learning is off";
        NotCapable = "the board lacks this capability";
        /// (Outside [`Configuration::PERIODS_US`], or shorter than the clock of this board sustains.)
        Period = "period out of range";
        Gap {
            /// Offset of the next byte expected.
            #[serde(with = "postcard::fixint::le")]
            expected: u16
        } = "chunk out of order, byte {expected} is next";
        /// (The upload exceeds the board's buffer.)
        TooLong = "parameter bank too long";
        /// (Length or checksum differ from those announced.)
        Checksum = "parameter bank damaged or incomplete";
        /// (The bank does not fit this board.)
        Bank(error: BankError) = "{error}";
        /// (Only with the torque at zero.)
        Armed = "only while disarmed";
        /// (Safety refuses.)
        Unsafe(reason: SafetyReason) = "{reason}";
        Busy = "busy with an earlier request";
        /// (The board has a key, and signature or permission are missing or wrong.)
        Key = "the write key's signature is missing or wrong";
        /// (The board runs on from RAM.)
        Store(error: StoreError) = "{error}";
        Bandwidth {
            /// Smallest admissible interval, ticks; 0 is never.
            #[serde(with = "postcard::fixint::le")]
            every: u16; 0 = "telemetry exceeds the link budget"
        } = "telemetry exceeds the link budget: every {every} ticks is possible";
        /// (It cannot be played, or not now.)
        Excitation(error: ExcitationError) = "{error}";
        /// (Too soon after the last save, or after a restart of the firmware: the flash would wear out.)
        Wait {
            /// Time until a save is accepted, s.
            seconds: u8
        } = "the flash rests for {seconds} s more";
        Brake = "closing time of the brakes above {MOST_MS} ms";
    }
}

/// Bytes of fields that one frame carries at most.
pub const TELEMETRY_BYTES: usize = 160;

/// Field of a telemetry record. Its bit is `1 << field as u16`; a frame has the fields in this order, little endian,
/// without padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Field {
    /// Flags (u16), safety state (u8), safety reason (u8).
    State = 0,
    /// Torque within the hard limits, N × f32, N·m.
    Total = 1,
    /// Rigid-body share, N × f32, N·m.
    Rigid = 2,
    /// Friction share, N × f32, N·m.
    Friction = 3,
    /// Network share, N × f32, N·m.
    Network = 4,
    /// Desired position, N × f32, rad.
    DesiredPosition = 5,
    /// Desired velocity, N × f32, rad/s.
    DesiredVelocity = 6,
    /// Measured position, N × f32, rad; NaN where there is none, or an implausible one.
    MeasuredPosition = 7,
    /// Measured torque, N × f32, N·m; NaN likewise.
    MeasuredTorque = 8,
    /// RMS residual of every joint over the last seconds, N × f32, parts of the torque limit.
    Residual = 9,
    /// Trust (f32, 0 to 1), information (f32, 0 to 1), payload (f32, kg), phase of the supervisor (u8).
    Quality = 10,
    /// Number of decisions (u32), then of the newest: reason (u8), joint (u8, 255 = the arm), figure (f32).
    Decision = 11,
    /// Cost of the last tick and mean cost of a learning step (2 × u32), counts of the board's counter.
    Cost = 12,
    /// Lost: frames missed, frames refused, replies, overruns (4 × u16, of counters that wrap).
    Loss = 13,
    /// Motor temperatures, N × i8, °C; -128 is unknown.
    Temperature = 14,
}

impl Field {
    /// All fields, in the order of their bits.
    pub const ALL: [Self; 15] = [
        Self::State,
        Self::Total,
        Self::Rigid,
        Self::Friction,
        Self::Network,
        Self::DesiredPosition,
        Self::DesiredVelocity,
        Self::MeasuredPosition,
        Self::MeasuredTorque,
        Self::Residual,
        Self::Quality,
        Self::Decision,
        Self::Cost,
        Self::Loss,
        Self::Temperature,
    ];

    /// Its bit in a mask.
    pub const fn bit(self) -> u16 {
        1 << self as u16
    }

    /// Size for `joints` joints, bytes.
    pub const fn bytes(self, joints: usize) -> usize {
        match self {
            Self::State => 4,
            Self::Quality => 13,
            Self::Decision => 10,
            Self::Cost | Self::Loss => 8,
            Self::Temperature => joints,
            _ => 4 * joints,
        }
    }
}

/// Some fields of one tick; the others of the same record come in frames with the same tick.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TelemetryFrame {
    /// Counter of the tick.
    #[serde(with = "postcard::fixint::le")]
    pub tick: u32,
    /// Sum of field bits.
    #[serde(with = "postcard::fixint::le")]
    pub fields: u16,
    /// Their bytes.
    pub bytes: heapless::Vec<u8, TELEMETRY_BYTES>,
}

impl TelemetryFrame {
    /// The fields with their bytes, in order; ends early where bytes are missing.
    ///
    /// * `joints` joints of the board
    pub fn fields(&self, joints: usize) -> impl Iterator<Item = (Field, &[u8])> {
        let mut rest = self.bytes.as_slice();
        let present = Field::ALL
            .into_iter()
            .filter(|field| self.fields & field.bit() != 0);
        present.map_while(move |field| {
            let (bytes, behind) = rest.split_at_checked(field.bytes(joints))?;
            rest = behind;
            Some((field, bytes))
        })
    }
}
