use crate::bank::ParameterBank;
use crate::excitation::{ExcitationError, ExcitationProgram};
use crate::wire::{BoardMessage, CHUNK, CRC, NackReason};

/// A parameter bank on its way up or down, or an excitation on its way up, in one buffer.
pub(in crate::session) struct Transfer {
    bytes: [u8; ParameterBank::MAX_BYTES],
    length: usize,
    direction: Direction,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Direction {
    Idle,
    Up,
    Down,
}

impl Transfer {
    pub(super) const fn new() -> Self {
        Self {
            bytes: [0; ParameterBank::MAX_BYTES],
            length: 0,
            direction: Direction::Idle,
        }
    }

    pub(in crate::session) fn abort(&mut self) {
        self.direction = Direction::Idle;
        self.length = 0;
    }

    /// Takes the next chunk of an upload. Offset 0 begins anew. A repeated chunk does no harm, so a host whose
    /// acknowledgement was lost may send it again.
    pub(in crate::session) fn write(
        &mut self,
        offset: u16,
        chunk: &[u8],
    ) -> Result<(), NackReason> {
        if offset == 0 {
            self.direction = Direction::Up;
            self.length = 0;
        } else if self.direction != Direction::Up {
            return Err(NackReason::Gap { expected: 0 });
        }
        let start = usize::from(offset);
        let end = start + chunk.len();
        if start > self.length {
            let expected = self.length as u16;
            return Err(NackReason::Gap { expected });
        }
        let place = self.bytes.get_mut(start..end).ok_or(NackReason::TooLong)?;
        for (slot, byte) in place.iter_mut().zip(chunk) {
            *slot = *byte;
        }
        self.length = end;
        Ok(())
    }

    /// The bytes of the upload so far.
    pub(super) fn received(&self) -> &[u8] {
        match self.direction {
            Direction::Up => self.bytes.get(..self.length).unwrap_or_default(),
            Direction::Idle | Direction::Down => &[],
        }
    }

    /// Decodes the uploaded bank into `bank`, if it is complete. The upload is over in any case.
    pub(in crate::session) fn commit(
        &mut self,
        length: u16,
        crc: u32,
        bank: &mut ParameterBank,
    ) -> Result<(), NackReason> {
        let uploaded = self.uploaded(length, crc);
        let read = uploaded.and_then(|bytes| bank.decode_into(bytes).map_err(NackReason::Bank));
        self.abort();
        read
    }

    /// The uploaded excitation, if it is complete. The upload is over in any case.
    pub(in crate::session) fn program<const N: usize>(
        &mut self,
        length: u16,
        crc: u32,
    ) -> Result<ExcitationProgram<N>, NackReason> {
        let unreadable = NackReason::Excitation(ExcitationError::Number(0));
        let uploaded = self.uploaded(length, crc);
        let read = uploaded.and_then(|bytes| ExcitationProgram::decode(bytes).ok_or(unreadable));
        self.abort();
        read
    }

    fn uploaded(&self, length: u16, crc: u32) -> Result<&[u8], NackReason> {
        let complete = self.direction == Direction::Up && self.length == usize::from(length);
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        if complete && CRC.checksum(bytes) == crc {
            Ok(bytes)
        } else {
            Err(NackReason::Checksum)
        }
    }

    /// Keeps `bytes` for reading, as many as the buffer takes; an unfinished upload is dropped.
    pub(in crate::session) fn hold(&mut self, bytes: &[u8]) {
        self.length = self.bytes.len().min(bytes.len());
        for (slot, byte) in self.bytes.iter_mut().zip(bytes) {
            *slot = *byte;
        }
        self.direction = Direction::Down;
    }

    /// Keeps `bank` for reading; an unfinished upload is dropped.
    pub(in crate::session) fn hold_bank(&mut self, bank: &ParameterBank) -> Result<(), NackReason> {
        self.abort();
        let bytes = bank.encode(&mut self.bytes).map_err(NackReason::Bank)?;
        self.length = bytes.len();
        self.direction = Direction::Down;
        Ok(())
    }

    /// The chunk at `offset` of the bytes kept for reading; empty behind their end.
    pub(in crate::session) fn chunk<const N: usize>(
        &self,
        offset: u16,
    ) -> Result<BoardMessage<N>, NackReason> {
        if self.direction != Direction::Down {
            return Err(NackReason::Gap { expected: 0 });
        }
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        let rest = bytes.get(usize::from(offset)..).unwrap_or_default();
        Ok(BoardMessage::BankChunk {
            offset,
            length: self.length as u16,
            bytes: rest.iter().copied().take(CHUNK).collect(),
        })
    }
}
