//! Encoder of frames.

use super::{MAX_FRAME, PROTOCOL_VERSION};
use core::fmt;
use crc::{CRC_32_ISO_HDLC, Crc};
use postcard::ser_flavors::{Flavor, crc::CrcModifier};
use serde::Serialize;

/// CRC-32 of frames and parameter banks (ISO-HDLC, the one of zip and Ethernet; 1 KiB of table).
pub(crate) const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// CRC-32 of frames and banks over some bytes in turn.
pub fn checksum<const PARTS: usize>(parts: [&[u8]; PARTS]) -> u32 {
    let mut digest = CRC.digest();
    parts.iter().for_each(|part| digest.update(part));
    digest.finalize()
}

#[derive(Serialize)]
struct Frame<'a, M> {
    version: u8,
    #[serde(with = "postcard::fixint::le")]
    sequence: u16,
    message: &'a M,
}

/// The frame exceeds the buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EncodeError;

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the frame exceeds the buffer")
    }
}

impl core::error::Error for EncodeError {}

/// Bytes of one frame, delimiter included, at the front of `buffer`.
///
/// Errors: [`EncodeError`] where the frame is longer than `buffer`.
pub fn encode<'r, M: Serialize>(
    sequence: u16,
    message: &M,
    buffer: &'r mut [u8],
) -> Result<&'r [u8], EncodeError> {
    encode_as(PROTOCOL_VERSION, sequence, message, buffer)
}

/// [`encode`] with another protocol version.
pub(crate) fn encode_as<'r, M: Serialize>(
    version: u8,
    sequence: u16,
    message: &M,
    buffer: &'r mut [u8],
) -> Result<&'r [u8], EncodeError> {
    let frame = Frame {
        version,
        sequence,
        message,
    };
    let cobs = Cobs::new(buffer);
    postcard::serialize_with_flavor(&frame, CrcModifier::new(cobs, CRC.digest()))
        .map(|frame: &mut [u8]| &*frame)
        .map_err(|_| EncodeError)
}

/// COBS encoder into a buffer. The flavor of postcard does the same with indices that can panic.
struct Cobs<'r> {
    buffer: &'r mut [u8],
    /// Bytes used.
    length: usize,
    /// Place of the length byte of this block.
    code: usize,
    /// Length byte of the block: one more than its bytes.
    run: u8,
}

impl<'r> Cobs<'r> {
    fn new(buffer: &'r mut [u8]) -> Self {
        Self {
            buffer,
            length: 1,
            code: 0,
            run: 1,
        }
    }

    fn put(&mut self, place: usize, byte: u8) -> postcard::Result<()> {
        let slot = self.buffer.get_mut(place);
        *slot.ok_or(postcard::Error::SerializeBufferFull)? = byte;
        Ok(())
    }

    fn close_block(&mut self) -> postcard::Result<()> {
        self.put(self.code, self.run)?;
        self.code = self.length;
        self.length += 1;
        self.run = 1;
        Ok(())
    }
}

impl<'r> Flavor for Cobs<'r> {
    type Output = &'r mut [u8];

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        if byte == 0 {
            return self.close_block();
        }
        self.put(self.length, byte)?;
        self.length += 1;
        self.run += 1;
        if self.run == u8::MAX {
            return self.close_block();
        }
        Ok(())
    }

    fn finalize(mut self) -> postcard::Result<Self::Output> {
        self.close_block()?;
        // The delimiter takes the place that the next block would have begun with.
        self.put(self.code, 0)?;
        let frame = self.buffer.get_mut(..self.length);
        frame.ok_or(postcard::Error::SerializeBufferFull)
    }
}

/// Frames on their way out, in the order they were pushed.
#[derive(Clone, Debug)]
pub struct FrameBuffer {
    bytes: [u8; Self::CAPACITY],
    length: usize,
}

impl FrameBuffer {
    /// Capacity in bytes: four of the largest frames.
    pub const CAPACITY: usize = 4 * MAX_FRAME;

    /// An empty buffer.
    pub const fn new() -> Self {
        Self {
            bytes: [0; Self::CAPACITY],
            length: 0,
        }
    }

    /// The bytes to send.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }

    /// Nothing is waiting.
    pub const fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// It takes two more of the largest frames.
    pub const fn has_space(&self) -> bool {
        self.length + 2 * MAX_FRAME <= Self::CAPACITY
    }

    /// Empties it.
    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// Appends one frame. Errors: [`EncodeError`] when it does not fit; the frames before it stay.
    pub fn push<M: Serialize>(&mut self, sequence: u16, message: &M) -> Result<(), EncodeError> {
        let rest = self.bytes.get_mut(self.length..).unwrap_or_default();
        self.length += encode(sequence, message, rest)?.len();
        Ok(())
    }
}

impl Default for FrameBuffer {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs of all lengths around the longest block, decoded by another crate.
    #[test]
    fn the_cobs_crate_decodes_frames_of_every_length() {
        for length in (0..300).chain(500..520) {
            for zero in [0, 253, 254, 255] {
                let mut message = [1; 520];
                message[zero] = 0;
                let message = &message[..length];
                let mut buffer = [0; 600];
                let frame = encode(0x0102, &message, &mut buffer).unwrap();
                let (delimiter, encoded) = frame.split_last().unwrap();
                assert!(*delimiter == 0 && !encoded.contains(&0), "{length} {zero}");
                let mut content = encoded.to_vec();
                let count = cobs::decode_in_place(&mut content).unwrap();
                let content = &content[..count - 4];
                assert!(content.ends_with(message), "{length} {zero}");
            }
        }
    }
}
