//! The link protocol: versioned frames, independent of the transport that carries their bytes.
//!
//! A frame is `COBS( postcard(header, message) ++ CRC-32 ) 0x00`. No byte of a frame is zero but its last, so a receiver
//! that joined late, or was fed garbage, is back in step at the next zero. `docs/protocol.md` is the page of this room.

mod array;
mod codec;
mod decoder;
mod frames;
mod identity;
mod message;
mod record;
mod scaled;
pub mod size;

pub(crate) use codec::CRC;
#[cfg(test)]
pub(crate) use codec::encode_as;
pub use codec::{EncodeError, FrameBuffer, encode};
pub use decoder::{DecodeError, Decoder, FrameView};
pub use frames::{
    EvaluatedFrame, ExcitedFrame, FullTorqueFrame, MotionFrame, SampleFlags, SampleFrame,
    TorqueFrame,
};
pub use identity::{
    BoardHello, Capabilities, Configuration, CounterKind, Pacing, ReplyMode, ResetReason,
};
pub use message::{
    BankSource, BoardMessage, CHUNK, Chunk, HostMessage, MAC_BYTES, NackReason, Name,
};
pub use record::{Field, TELEMETRY_BYTES, TelemetryFrame};
pub use scaled::{Acceleration, Effort, I16, I24, Position, Velocity};

/// Version of the protocol. It changes whenever a frame of the old version would be read differently or not at all.
pub const PROTOCOL_VERSION: u8 = 3;

/// Largest frame before COBS: header, message and CRC, in bytes.
pub const MAX_PAYLOAD: usize = 240;

/// Largest frame on the wire, in bytes: below 255 payload bytes COBS adds one byte, the delimiter is another.
pub const MAX_FRAME: usize = MAX_PAYLOAD + 2;

#[cfg(test)]
mod tests;
