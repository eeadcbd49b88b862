//! Decoder of frames.

use super::codec::CRC;
use super::{MAX_PAYLOAD, PROTOCOL_VERSION};
use cobs::{DecodeResult, DecoderState};
use core::fmt;
use serde::Deserialize;

const CRC_BYTES: usize = 4;
const HEADER_BYTES: usize = 3;

/// Reason why a frame was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DecodeError {
    /// Longer than any frame of the protocol, or cut short.
    Framing,
    /// The checksum does not fit the bytes.
    Checksum,
    /// Sound, but of another protocol version.
    ForeignVersion(u8),
    /// Sound and of this version, but not a message of this direction and number of joints.
    Unknown,
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Framing => f.write_str("frame cut short or too long"),
            Self::Checksum => f.write_str("frame with a wrong checksum"),
            Self::ForeignVersion(version) => {
                write!(
                    f,
                    "frame of protocol version {version}, this is version {PROTOCOL_VERSION}"
                )
            }
            Self::Unknown => f.write_str("frame with an unknown message"),
        }
    }
}

impl core::error::Error for DecodeError {}

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
    state: DecoderState,
    payload: [u8; MAX_PAYLOAD],
    length: usize,
    /// Bytes since the last delimiter.
    waiting: u32,
    overlong: bool,
    lost: u32,
}

impl Decoder {
    /// A decoder before the first byte of a frame.
    pub const fn new() -> Self {
        Self {
            state: DecoderState::Idle,
            payload: [0; MAX_PAYLOAD],
            length: 0,
            waiting: 0,
            overlong: false,
            lost: 0,
        }
    }

    /// Bytes that belonged to no good frame, delimiters of refused frames included. Wraps.
    pub const fn bytes_lost(&self) -> u32 {
        self.lost
    }

    /// Takes one byte; `Some` at a delimiter that ends a frame, good or bad. Cannot fail otherwise.
    pub fn push(&mut self, byte: u8) -> Option<Result<FrameView<'_>, DecodeError>> {
        self.waiting = self.waiting.saturating_add(1);
        match self.state.feed(byte) {
            Ok(DecodeResult::NoData) => {
                if byte == 0 {
                    // A delimiter after a delimiter is harmless.
                    self.waiting = 0;
                }
                None
            }
            Ok(DecodeResult::DataContinue(decoded)) => {
                match self.payload.get_mut(self.length) {
                    Some(slot) => {
                        *slot = decoded;
                        self.length += 1;
                    }
                    None => self.overlong = true,
                }
                None
            }
            Ok(DecodeResult::DataComplete) => Some(self.close(true)),
            Err(_) => Some(self.close(false)),
        }
    }

    fn close(&mut self, well_formed: bool) -> Result<FrameView<'_>, DecodeError> {
        let whole = well_formed && !self.overlong;
        let length = core::mem::take(&mut self.length);
        let bytes = core::mem::take(&mut self.waiting);
        self.overlong = false;
        let frame = if whole {
            FrameView::check(self.payload.get(..length).unwrap_or_default())
        } else {
            Err(DecodeError::Framing)
        };
        if frame.is_err() {
            self.lost = self.lost.wrapping_add(bytes);
        }
        frame
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}
