//! Encoder and decoder of frames.

use super::{MAX_FRAME, MAX_PAYLOAD, PROTOCOL_VERSION};
use crate::copy;
use core::fmt;
use crc::{CRC_32_ISO_HDLC, Crc};
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize};

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
/// Errors: [`EncodeError`] where the frame is longer than `buffer`, or than any of the protocol.
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
    let plain = Plain { buffer, length: 1 };
    let mut plain = postcard::serialize_with_flavor(&frame, plain).map_err(|_| EncodeError)?;
    let crc = CRC.checksum(plain.buffer.get(1..plain.length).unwrap_or_default());
    let whole = plain.try_extend(&crc.to_le_bytes());
    whole.map_err(|_| EncodeError)?;
    stuff(plain.buffer, plain.length).ok_or(EncodeError)
}

/// Bytes of a frame before COBS, from the second place of `buffer` on. The flavor of postcard does the same with indices that
/// can panic.
struct Plain<'r> {
    buffer: &'r mut [u8],
    /// Places used.
    length: usize,
}

impl Flavor for Plain<'_> {
    type Output = Self;

    #[inline(always)]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.try_extend(&[byte])
    }

    #[inline]
    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        let rest = self.buffer.get_mut(self.length..);
        let places = rest.and_then(|rest| rest.get_mut(..bytes.len()));
        let places = places.ok_or(postcard::Error::SerializeBufferFull)?;
        copy(places, bytes);
        self.length += bytes.len();
        Ok(())
    }

    fn finalize(self) -> postcard::Result<Self> {
        Ok(self)
    }
}

/// COBS in place: each zero becomes the distance to the next one, the first of them in front, and a zero ends the frame.
///
/// * `length` places used, the first one included
/// * returns the frame; `None` where it does not fit, or is longer than any of the protocol
fn stuff(buffer: &mut [u8], length: usize) -> Option<&[u8]> {
    let frame = buffer.get_mut(..=length)?;
    if length > MAX_PAYLOAD + 1 {
        return None;
    }
    *frame.last_mut()? = 0;
    let mut code = 0;
    for place in 1..frame.len() {
        if *frame.get(place)? == 0 {
            *frame.get_mut(code)? = (place - code) as u8;
            code = place;
        }
    }
    Some(frame)
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

const CRC_BYTES: usize = 4;
const HEADER_BYTES: usize = 3;

errors! {
    /// Reason why a frame was refused.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[cfg_attr(feature = "defmt", derive(defmt::Format))]
    pub enum DecodeError {
        Framing = "frame cut short or too long";
        Checksum = "frame with a wrong checksum";
        ForeignVersion(version: u8) = "frame of protocol version {version}, this is version {PROTOCOL_VERSION}";
        /// (Its version is right; another direction, or another number of joints.)
        Unknown = "frame with an unknown message";
    }
}

/// A frame whose checksum and version are right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameView<'a> {
    /// Sequence number.
    pub sequence: u16,
    body: &'a [u8],
}

impl<'a> FrameView<'a> {
    fn check(payload: &'a [u8]) -> Result<Self, DecodeError> {
        let (content, checksum) = payload
            .split_last_chunk::<CRC_BYTES>()
            .ok_or(DecodeError::Framing)?;
        if CRC.checksum(content) != u32::from_le_bytes(*checksum) {
            return Err(DecodeError::Checksum);
        }
        let (&[version, low, high], body) = content
            .split_first_chunk::<HEADER_BYTES>()
            .ok_or(DecodeError::Framing)?;
        if version != PROTOCOL_VERSION {
            return Err(DecodeError::ForeignVersion(version));
        }
        Ok(Self {
            sequence: u16::from_le_bytes([low, high]),
            body,
        })
    }

    /// The message of the frame.
    ///
    /// Errors: [`DecodeError::Unknown`] where the bytes are not exactly one `M`.
    pub fn message<M: Deserialize<'a>>(&self) -> Result<M, DecodeError> {
        match postcard::take_from_bytes(self.body) {
            Ok((message, [])) => Ok(message),
            _ => Err(DecodeError::Unknown),
        }
    }
}

/// Decoder that finds the frames in a stream of bytes.
///
/// Cost: a few instructions a byte; a delimiter adds the checksum over the frame it ends, at most [`MAX_PAYLOAD`] bytes.
#[derive(Debug)]
pub struct Decoder {
    /// The frame as received: COBS adds one byte.
    frame: [u8; MAX_PAYLOAD + 1],
    /// Bytes since the last delimiter; those beyond the array are only counted.
    received: u32,
    lost: u32,
}

impl Decoder {
    /// A decoder before the first byte of a frame.
    pub const fn new() -> Self {
        Self {
            frame: [0; MAX_PAYLOAD + 1],
            received: 0,
            lost: 0,
        }
    }

    /// Bytes that belonged to no good frame, delimiters of refused frames included. Wraps.
    pub const fn bytes_lost(&self) -> u32 {
        self.lost
    }

    /// Counts the bytes of [`bytes_lost`](Self::bytes_lost) from 0; a frame that has begun goes on.
    pub fn clear_lost(&mut self) {
        self.lost = 0;
    }

    /// Takes one byte; `Some` at a delimiter that ends a frame, good or bad. Cannot fail otherwise.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Result<FrameView<'_>, DecodeError>> {
        if byte != 0 {
            if let Some(place) = self.frame.get_mut(self.received as usize) {
                *place = byte;
            }
            self.received = self.received.saturating_add(1);
            return None;
        }
        // A delimiter after a delimiter is harmless.
        (self.received != 0).then(|| self.close())
    }

    #[inline(never)]
    fn close(&mut self) -> Result<FrameView<'_>, DecodeError> {
        let received = core::mem::take(&mut self.received);
        let content = self.frame.get_mut(..received as usize).and_then(unstuff);
        let frame = content
            .ok_or(DecodeError::Framing)
            .and_then(FrameView::check);
        if frame.is_err() {
            self.lost = self.lost.wrapping_add(received).wrapping_add(1);
        }
        frame
    }
}

/// COBS in place: each code becomes the zero that it stands for, and leads to the next one. No byte of `frame` is zero.
///
/// Returns the content behind the first code; `None` where the last code does not lead to the end.
fn unstuff(frame: &mut [u8]) -> Option<&[u8]> {
    let mut place = 0;
    while place != frame.len() {
        place += usize::from(core::mem::take(frame.get_mut(place)?));
    }
    frame.get(1..)
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames that a decoder would refuse are not encoded.
    #[test]
    fn the_cobs_crate_decodes_frames_of_every_length() {
        for length in 0..300 {
            for zero in [0, 100, 230, 299] {
                let mut message = [1; 300];
                message[zero] = 0;
                let message = &message[..length];
                let mut buffer = [0; 400];
                // Header, length of the message, message, checksum.
                let content = 3 + 1 + usize::from(length > 127) + length + 4;
                let Ok(frame) = encode(0x0102, &message, &mut buffer) else {
                    assert!(content > MAX_PAYLOAD, "{length} {zero}");
                    continue;
                };
                assert!(content <= MAX_PAYLOAD, "{length} {zero}");
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
