use crate::bank::{BankError, ParameterBank};
use crate::excitation::{ExcitationError, ExcitationProgram};
use crate::wire::{CHUNK, CRC, Chunk, NackReason};

/// One parameter bank on its way up or down, or an excitation on its way up, in one room.
pub(super) struct Transfer {
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

    pub(super) fn abort(&mut self) {
        self.direction = Direction::Idle;
        self.length = 0;
    }

    /// Takes the next piece. Offset 0 begins anew; a piece that is there already is taken again without harm, so that a
    /// host whose acknowledgement was lost may repeat it.
    pub(super) fn write(&mut self, offset: u16, chunk: &[u8]) -> Result<(), NackReason> {
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
        let room = self.bytes.get_mut(start..end).ok_or(NackReason::TooLong)?;
        for (slot, byte) in room.iter_mut().zip(chunk) {
            *slot = *byte;
        }
        self.length = end;
        Ok(())
    }

    /// The bytes that have come so far.
    pub(super) fn come(&self) -> &[u8] {
        match self.direction {
            Direction::Up => self.bytes.get(..self.length).unwrap_or_default(),
            Direction::Idle | Direction::Down => &[],
        }
    }

    /// Keeps `bytes` for reading, as far as there is room; an unfinished upload is dropped.
    pub(super) fn hold(&mut self, bytes: &[u8]) {
        self.length = self.bytes.len().min(bytes.len());
        for (slot, byte) in self.bytes.iter_mut().zip(bytes) {
            *slot = *byte;
        }
        self.direction = Direction::Down;
    }

    /// Reads the uploaded bank into `room`, if it is all there. The upload is over, whatever comes of it.
    pub(super) fn commit(
        &mut self,
        length: u16,
        crc: u32,
        room: &mut ParameterBank,
    ) -> Result<(), NackReason> {
        let uploaded = self.uploaded(length, crc);
        let read = uploaded.and_then(|bytes| room.decode_into(bytes).map_err(NackReason::Bank));
        self.abort();
        read
    }

    /// The uploaded excitation, if it is all there. The upload is over, whatever comes of it.
    pub(super) fn program<const N: usize>(
        &mut self,
        length: u16,
        crc: u32,
    ) -> Result<ExcitationProgram<N>, NackReason> {
        let uploaded = self.uploaded(length, crc);
        let read = uploaded.and_then(|bytes| {
            ExcitationProgram::decode(bytes)
                .ok_or(NackReason::Excitation(ExcitationError::Number(0)))
        });
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

    /// Keeps `bank` for reading; an unfinished upload is dropped.
    pub(super) fn snapshot(&mut self, bank: &ParameterBank) -> Result<(), BankError> {
        self.abort();
        self.length = bank.encode(&mut self.bytes)?.len();
        self.direction = Direction::Down;
        Ok(())
    }

    /// Length of the snapshot, and the piece of it at `offset`; empty behind its end.
    pub(super) fn read(&self, offset: u16) -> Result<(u16, Chunk), NackReason> {
        if self.direction != Direction::Down {
            return Err(NackReason::Gap { expected: 0 });
        }
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        let rest = bytes.get(usize::from(offset)..).unwrap_or_default();
        Ok((
            self.length as u16,
            rest.iter().copied().take(CHUNK).collect(),
        ))
    }
}
