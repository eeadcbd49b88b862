//! Bytes of a bank. They are decoded in place: a bank of 2.4 kB is too large for copies on the stack of the tick.

use super::{BankError, Column, JointBounds, MAX_COLUMNS, MAX_JOINTS, MAX_WEIGHTS};
use super::{NetworkShape, ParameterBank};
use crate::wire::{CRC, Name};
use heapless::Vec;
use postcard::ser_flavors::{Slice, crc::CrcModifier};
use serde::Deserialize;

const MAGIC: [u8; 4] = *b"FTPB";
const VERSION: u8 = 1;
const PREFIX: usize = MAGIC.len() + 1;
const CRC_BYTES: usize = 4;

impl ParameterBank {
    /// Version of the bytes.
    pub const FORMAT_VERSION: u8 = VERSION;

    /// Largest serialised bank, in bytes.
    pub const MAX_BYTES: usize = PREFIX
        + (4 + 1 + 24)
        + (1 + 10 * MAX_COLUMNS)
        + (1 + 4 * MAX_JOINTS)
        + 5
        + (2 + 4 * MAX_WEIGHTS)
        + (1 + 12 * MAX_JOINTS)
        + CRC_BYTES;

    /// The serialised bank, at the front of `buffer`.
    ///
    /// Errors: [`BankError::TooLong`]; cannot fail with [`MAX_BYTES`](Self::MAX_BYTES) of buffer.
    pub fn encode<'r>(&self, buffer: &'r mut [u8]) -> Result<&'r [u8], BankError> {
        let flavor = CrcModifier::new(Slice::new(buffer), CRC.digest());
        postcard::serialize_with_flavor(&(MAGIC, VERSION, self), flavor)
            .map(|bytes: &mut [u8]| &*bytes)
            .map_err(|_| BankError::TooLong)
    }

    /// Decodes the bank that is all of `bytes`. Its values are checked by [`set`](Self::set).
    ///
    /// Errors: in this order, [`NotABank`](BankError::NotABank), [`Version`](BankError::Version),
    /// [`Checksum`](BankError::Checksum), [`Malformed`](BankError::Malformed).
    pub fn decode(bytes: &[u8]) -> Result<Self, BankError> {
        let mut bank = Self::empty();
        bank.decode_into(bytes)?;
        Ok(bank)
    }

    /// Decodes in place as [`decode`](Self::decode); after an error the content is undefined.
    pub fn decode_into(&mut self, bytes: &[u8]) -> Result<(), BankError> {
        let rest = bytes.strip_prefix(&MAGIC).ok_or(BankError::NotABank)?;
        let &version = rest.first().ok_or(BankError::NotABank)?;
        if version != VERSION {
            return Err(BankError::Version(version));
        }
        let (content, checksum) = bytes
            .split_last_chunk::<CRC_BYTES>()
            .ok_or(BankError::NotABank)?;
        if CRC.checksum(content) != u32::from_le_bytes(*checksum) {
            return Err(BankError::Checksum);
        }
        let body = content.get(PREFIX..).ok_or(BankError::NotABank)?;
        // The fields in the order in which `Serialize` writes them.
        let (arm_hash, rest) = next::<[u8; 4]>(body)?;
        let (arm, rest) = next::<Name>(rest)?;
        let rest = list(&mut self.columns, rest)?;
        let rest = list(&mut self.drive_gains_nm_a, rest)?;
        let (network, rest) = next::<NetworkShape>(rest)?;
        let rest = list(&mut self.weights, rest)?;
        let rest = list(&mut self.limits, rest)?;
        (self.arm_hash, self.arm, self.network) = (u32::from_le_bytes(arm_hash), arm, network);
        rest.is_empty().then_some(()).ok_or(BankError::Malformed)
    }

    /// An empty bank, for no arm.
    pub const fn empty() -> Self {
        Self {
            arm_hash: 0,
            arm: Name::new(),
            columns: Vec::<Column, MAX_COLUMNS>::new(),
            drive_gains_nm_a: Vec::new(),
            network: NetworkShape::NONE,
            weights: Vec::<f32, MAX_WEIGHTS>::new(),
            limits: Vec::<JointBounds, MAX_JOINTS>::new(),
        }
    }
}

fn next<'b, T: Deserialize<'b>>(bytes: &'b [u8]) -> Result<(T, &'b [u8]), BankError> {
    postcard::take_from_bytes(bytes).map_err(|_| BankError::Malformed)
}

/// Reads a list item by item; returns the bytes that follow it.
fn list<'b, T: Deserialize<'b>, const M: usize>(
    vector: &mut Vec<T, M>,
    bytes: &'b [u8],
) -> Result<&'b [u8], BankError> {
    vector.clear();
    let (length, mut rest) = next::<u32>(bytes)?;
    for _ in 0..length {
        let (item, behind) = next(rest)?;
        vector.push(item).map_err(|_| BankError::Malformed)?;
        rest = behind;
    }
    Ok(rest)
}
