//! The link protocol: versioned frames, independent of the transport that carries their bytes.
//!
//! A frame is `COBS( postcard(header, message) ++ CRC-32 ) 0x00`. Only its last byte is zero, so a receiver that joins late,
//! or receives damaged bytes, is synchronised again at the next zero. `docs/protocol.md` is the specification.

mod codec;
mod frames;
mod identity;
mod message;
mod scaled;

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

/// Wire sizes of the cyclic frames, and the capacity of the link that carries them.
pub mod size {
    use crate::div_u64_by_u32;

    /// Version, sequence number and message tag, bytes.
    pub const HEADER: usize = 4;
    /// CRC-32, COBS byte and delimiter, bytes.
    const TRAILER: usize = 6;
    /// Part of a link that is left free, in per cent: for repeats and commands.
    const RESERVE_PERCENT: u64 = 30;

    /// Wire size of a frame whose message has `content` bytes behind the tag.
    pub const fn frame(content: usize) -> usize {
        HEADER + content + TRAILER
    }

    /// Wire size of a sample of `joints` joints: flags, temperature, and 3 + 3 + 2 + 3 + 3 bytes a joint.
    pub const fn sample(joints: usize) -> usize {
        frame(2 + 14 * joints)
    }

    /// Wire size of a torque with the shares of one joint: tick, flags, safety, total, three shares.
    pub const fn torque(joints: usize) -> usize {
        frame(4 + 2 + 2 + 4 * joints + 3 * 4)
    }

    /// Wire size of a torque with all shares.
    pub const fn full_torque(joints: usize) -> usize {
        frame(4 + 2 + 2 + 16 * joints)
    }

    /// Wire size of telemetry with `content` bytes of fields: tick, fields, length of the bytes as a varint of one or two.
    pub const fn telemetry(content: usize) -> usize {
        frame(4 + 2 + 1 + (content > 127) as usize + content)
    }

    /// Largest wire size of a torque with the desired motion and state of an excitation.
    pub const fn excited(joints: usize) -> usize {
        torque(joints) + 3 + 8 * joints
    }

    /// Capacity of one direction of a link, as its transport gives it.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct LinkCapacity {
        /// Bytes a second; 0 has no limit.
        pub bytes_s: u32,
    }

    impl LinkCapacity {
        /// No limit, as between two processes.
        pub const UNLIMITED: Self = Self::stream(0);
        /// Bytes of telemetry in one period where there is no limit: a record of all fields of eight joints.
        const UNLIMITED_LEFT: usize = 400;

        /// A stream of `bytes_s` bytes a second, which carries every frame of the protocol.
        pub const fn stream(bytes_s: u32) -> Self {
            Self { bytes_s }
        }

        /// Bytes that one period leaves besides a frame of `reply` bytes and the reserve.
        pub const fn left(&self, period_us: u32, reply: usize) -> usize {
            if self.bytes_s == 0 {
                return Self::UNLIMITED_LEFT;
            }
            let bytes = div_u64_by_u32(self.bytes_s as u64 * period_us as u64, 1_000_000);
            let planned = div_u64_by_u32(bytes as u64 * (100 - RESERVE_PERCENT), 100) as usize;
            planned.saturating_sub(reply)
        }
    }

    /// Part of one direction of a link that frames of `bytes` at `rate_hz` leave free, in per mille.
    ///
    /// * `bytes_s` capacity of the direction, bytes a second
    pub const fn headroom_permille(bytes: usize, rate_hz: u64, bytes_s: u32) -> i64 {
        1000 - (1000 * bytes as u64 * rate_hz / bytes_s as u64) as i64
    }

    const _: () = assert!(sample(6) <= 96 && torque(6) <= 64);
    const _: () = assert!(excited(7) <= full_torque(7));
}

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
