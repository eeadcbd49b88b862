//! The link protocol: versioned frames, independent of the transport that carries their bytes.
//!
//! A frame is `COBS( postcard(header, message) ++ CRC-32 ) 0x00`. Only its last byte is zero, so a receiver that joins late,
//! or receives damaged bytes, is synchronised again at the next zero. `docs/protocol.md` is the specification.

pub(crate) mod array;
mod codec;
mod frames;
mod identity;
mod message;
mod record;
mod scaled;
pub mod size;

pub(crate) use codec::CRC;
#[cfg(test)]
pub(crate) use codec::encode_as;
pub use codec::{DecodeError, Decoder, EncodeError, FrameBuffer, FrameView, checksum, encode};
pub use frames::{
    EvaluatedFrame, ExcitedFrame, FullTorqueFrame, MotionFrame, SampleFlags, SampleFrame,
    TorqueFrame,
};
pub use identity::{
    BoardHello, Capabilities, ChipStatus, ClockSource, Configuration, CounterKind, ImageStatus,
    Pacing, ReplyMode, ResetReason,
};
pub use message::{BankSource, BoardMessage, HostMessage, NackReason};
pub use record::{Field, TELEMETRY_BYTES, TelemetryFrame};
pub use scaled::{Acceleration, Effort, Position, Scaled, Velocity};

/// Version of the protocol; changes whenever a frame of the old version would be decoded differently or not at all.
pub const PROTOCOL_VERSION: u8 = 4;

/// Largest frame before COBS: header, message and CRC, in bytes.
pub const MAX_PAYLOAD: usize = 240;

/// Largest frame on the wire, in bytes: below 255 payload bytes COBS adds one byte, the delimiter is another.
pub const MAX_FRAME: usize = MAX_PAYLOAD + 2;

/// Bytes of a bank that one frame carries.
pub const CHUNK: usize = 64;
/// A piece of a parameter bank.
pub type Chunk = heapless::Vec<u8, CHUNK>;
/// A short name in ASCII.
pub type Name = heapless::String<24>;
/// Bytes of a challenge, and of a signature.
pub const MAC_BYTES: usize = 16;

#[cfg(test)]
mod tests;
