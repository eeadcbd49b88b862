//! The link protocol: versioned frames, independent of the transport that carries their bytes.
//!
//! A frame is `COBS( postcard(header, message) ++ CRC-32 ) 0x00`. Only its last byte is zero, so a receiver that joins late,
//! or receives damaged bytes, is synchronised again at the next zero. `docs/protocol.md` is the specification.

mod codec;
mod frames;
mod identity;
mod message;
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
pub use message::{
    BankSource, BoardMessage, Field, HostMessage, NackReason, TELEMETRY_BYTES, TelemetryFrame,
};
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

/// Arrays of any length on the wire, entry by entry, without a length; serde supports `[T; N]` only up to 32 entries.
/// Nothing here can panic, whatever the compiler inlines.
pub(crate) mod array {
    use core::fmt;
    use core::marker::PhantomData;
    use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
    use serde::ser::{Serialize, SerializeTuple as _, Serializer};

    pub(crate) fn serialize<S: Serializer, T: Serialize, const N: usize>(
        values: &[T; N],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(N)?;
        for value in values {
            tuple.serialize_element(value)?;
        }
        tuple.end()
    }

    pub(crate) fn deserialize<'de, D, T, const N: usize>(
        deserializer: D,
    ) -> Result<[T; N], D::Error>
    where
        D: Deserializer<'de>,
        T: Deserialize<'de> + Copy + Default,
    {
        deserializer.deserialize_tuple(N, Entries(PhantomData))
    }

    struct Entries<T, const N: usize>(PhantomData<T>);

    impl<'de, T: Deserialize<'de> + Copy + Default, const N: usize> Visitor<'de> for Entries<T, N> {
        type Value = [T; N];

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "{N} entries")
        }

        fn visit_seq<S: SeqAccess<'de>>(self, mut sequence: S) -> Result<Self::Value, S::Error> {
            let mut values = [T::default(); N];
            for (place, value) in values.iter_mut().enumerate() {
                *value = sequence
                    .next_element()?
                    .ok_or_else(|| S::Error::invalid_length(place, &self))?;
            }
            Ok(values)
        }
    }
}

#[cfg(test)]
mod tests;
