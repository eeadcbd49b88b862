//! CAN frames, classic and FD.

use core::fmt;

/// One CAN frame, classic (at most 8 bytes) or FD (at most 64).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Identifier: 11 bits, or 29 where [`Self::extended`] is set.
    pub id: u32,
    /// Identifier of 29 bits.
    pub extended: bool,
    /// CAN-FD frame with the faster data phase.
    pub fd: bool,
    /// Remote frame, which asks for the frame of this identifier and has no data.
    pub remote: bool,
    length: u8,
    data: [u8; Self::CAPACITY],
}

impl Frame {
    /// Largest number of bytes of a CAN-FD frame.
    pub const CAPACITY: usize = 64;
    /// Largest standard identifier.
    pub const STANDARD_MAX: u32 = 0x7ff;
    /// Largest extended identifier.
    pub const EXTENDED_MAX: u32 = 0x1fff_ffff;

    /// Classic frame with an identifier of 11 bits, cut to them; bytes beyond [`Self::CAPACITY`] are left out.
    pub fn standard(id: u32, bytes: &[u8]) -> Self {
        Self::new(id & Self::STANDARD_MAX, false, bytes)
    }

    /// Classic frame with an identifier of 29 bits, cut to them; bytes beyond [`Self::CAPACITY`] are left out.
    pub fn extended(id: u32, bytes: &[u8]) -> Self {
        Self::new(id & Self::EXTENDED_MAX, true, bytes)
    }

    /// Remote frame with an identifier of 11 bits, cut to them.
    pub fn remote(id: u32) -> Self {
        let mut frame = Self::standard(id, &[]);
        frame.remote = true;
        frame
    }

    /// This frame as CAN-FD, padded with `padding` to the next length that CAN-FD has.
    #[must_use]
    pub fn into_fd(mut self, padding: u8) -> Self {
        self.fd = true;
        let length = match self.length {
            0..=8 => self.length,
            9..=12 => 12,
            13..=16 => 16,
            17..=20 => 20,
            21..=24 => 24,
            25..=32 => 32,
            33..=48 => 48,
            _ => 64,
        };
        let tail = self.data.get_mut(self.length.into()..length.into());
        tail.unwrap_or_default().fill(padding);
        self.length = length;
        self
    }

    fn new(id: u32, extended: bool, bytes: &[u8]) -> Self {
        let mut data = [0; Self::CAPACITY];
        data.iter_mut()
            .zip(bytes)
            .for_each(|(to, from)| *to = *from);
        Self {
            id,
            extended,
            fd: false,
            remote: false,
            length: bytes.len().min(Self::CAPACITY) as u8,
            data,
        }
    }

    /// The data bytes.
    pub fn bytes(&self) -> &[u8] {
        self.data.get(..self.length.into()).unwrap_or_default()
    }

    /// The data bytes, to change in place.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        self.data.get_mut(..self.length.into()).unwrap_or_default()
    }

    /// The eight bytes of a classic frame of full length; `None` for any other frame.
    pub fn eight(&self) -> Option<[u8; 8]> {
        if self.remote {
            return None;
        }
        self.bytes().try_into().ok()
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = if self.extended { 8 } else { 3 };
        write!(f, "{:0width$X}", self.id)?;
        f.write_str(match (self.fd, self.remote) {
            (true, _) => "##",
            (false, true) => "#R",
            (false, false) => "#",
        })?;
        self.bytes()
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}
