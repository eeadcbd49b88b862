use crate::bank::ParameterBank;
use crate::copy;
use crate::wire::{BoardMessage, CHUNK, NackReason};

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
    pub(in crate::session) const fn new() -> Self {
        Self {
            bytes: [0; ParameterBank::MAX_BYTES],
            length: 0,
            direction: Direction::Idle,
        }
    }

    pub(in crate::session) fn abort(&mut self) {
        self.direction = Direction::Idle;
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
        } else if self.direction != Direction::Up {
            return Err(NackReason::Gap { expected: 0 });
        }
        let start = usize::from(offset);
        let end = start + chunk.len();
        if start > self.length {
            let expected = self.length as u16;
            return Err(NackReason::Gap { expected });
        }
        let place = self.bytes.get_mut(start..end);
        copy(place.ok_or(NackReason::TooLong)?, chunk);
        self.length = end;
        Ok(())
    }

    /// Announced length of a complete upload; it is over.
    ///
    /// Errors: [`NackReason::Checksum`] where the upload has another length, or there is none.
    pub(in crate::session) fn end(&mut self, length: u16) -> Result<(), NackReason> {
        let complete = self.direction == Direction::Up && self.length == usize::from(length);
        self.direction = Direction::Idle;
        complete.then_some(()).ok_or(NackReason::Checksum)
    }

    /// Bytes of the last upload or snapshot.
    pub(in crate::session) fn content(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }

    /// Keeps `bytes` for reading, as many as the buffer takes; an unfinished upload is dropped.
    pub(in crate::session) fn hold(&mut self, bytes: &[u8]) {
        self.length = self.bytes.len().min(bytes.len());
        copy(&mut self.bytes, bytes);
        self.direction = Direction::Down;
    }

    /// The chunk at `offset` of the bytes kept for reading; empty behind their end.
    pub(in crate::session) fn chunk<const N: usize>(
        &self,
        offset: u16,
    ) -> Result<BoardMessage<N>, NackReason> {
        if self.direction != Direction::Down {
            return Err(NackReason::Gap { expected: 0 });
        }
        let rest = self
            .content()
            .get(usize::from(offset)..)
            .unwrap_or_default();
        Ok(BoardMessage::BankChunk {
            offset,
            length: self.length as u16,
            bytes: rest.iter().copied().take(CHUNK).collect(),
        })
    }
}
