//! Bytes to messages and back: frames, sequence numbers, uploads and downloads, telemetry. Moves no torque.

mod telemetry;

use crate::bank::ParameterBank;
use crate::copy;
use crate::telemetry::Statistics;
use crate::wire::{
    BoardMessage, CHUNK, DecodeError, Decoder, FrameBuffer, HostMessage, MAC_BYTES, NackReason,
};
use crate::write_key::WriteKey;
pub(super) use telemetry::{Instant, Stream};

/// Frames whose number lies at most this far back are repeats; a number farther back means that the host restarted.
const REPEAT_WINDOW: u16 = 16;

/// Content of a frame that is to be acted on.
pub(super) enum Received<const N: usize> {
    /// A message of the host, with its sequence number.
    Message(u16, HostMessage<N>),
    /// A sound frame of another protocol version.
    ForeignVersion,
}

/// State of one link: decoder, sequence numbers, counters, telemetry.
#[derive(Default)]
pub(super) struct Protocol {
    pub(super) decoder: Decoder,
    /// Counters of the link, and those of the owner of the session. The others are elsewhere, and zero here.
    pub(super) counters: Statistics,
    /// Last sequence number.
    last: Option<u16>,
    pub(super) stream: Stream,
    /// The challenge that the next signature has to cover.
    challenge: Option<[u8; MAC_BYTES]>,
    challenges: u32,
    /// The one protected order that the key has permitted.
    permission: Option<[u8; 2]>,
}

impl Protocol {
    /// Resets counters and telemetry; the sequence continues.
    pub(super) fn reset(&mut self) {
        self.decoder.clear_lost();
        self.stream.end();
        let owners = self.counters;
        self.counters = Statistics {
            receive_cost: owners.receive_cost,
            reply_latency: owners.reply_latency,
            watchdog_feeds: owners.watchdog_feeds,
            store: owners.store,
            ..Statistics::default()
        };
    }

    /// Takes one byte of the link; repeats and damaged frames are counted and end here.
    pub(super) fn receive<const N: usize>(&mut self, byte: u8) -> Option<Received<N>> {
        let frame = self.decoder.push(byte)?;
        let received = frame.and_then(|frame| Ok((frame.sequence, frame.message()?)));
        match received {
            Ok((sequence, message)) => {
                let restart = matches!(message, HostMessage::Hello);
                // A stop or a disarming that arrives late or twice still acts.
                let urgent = matches!(message, HostMessage::Stop | HostMessage::Disarm);
                (self.accept(sequence, restart) || urgent)
                    .then_some(Received::Message(sequence, message))
            }
            Err(error) => {
                self.refuse(error);
                matches!(error, DecodeError::ForeignVersion(_)).then_some(Received::ForeignVersion)
            }
        }
    }

    /// Encodes a reply; one without space in `out` is counted as lost.
    pub(super) fn reply<const N: usize>(
        &mut self,
        sequence: u16,
        message: &BoardMessage<N>,
        out: &mut FrameBuffer,
    ) {
        if out.push(sequence, message).is_err() {
            let lost = &mut self.counters.replies_lost;
            *lost = lost.saturating_add(1);
        }
    }

    /// The challenge that the signature of the next upload has to cover.
    #[inline(never)]
    pub(super) fn challenge(&mut self, key: &WriteKey, seed: &[u8; MAC_BYTES]) -> [u8; MAC_BYTES] {
        let nonce = key.challenge(seed, self.challenges);
        self.challenges = self.challenges.wrapping_add(1);
        self.challenge = Some(nonce);
        nonce
    }

    /// Permits one order, if its signature is right; an earlier permission ends. The challenge is used up.
    ///
    /// Errors: [`NackReason::Key`].
    #[inline(never)]
    pub(super) fn unlock(
        &mut self,
        key: &WriteKey,
        arm_hash: u32,
        order: [u8; 2],
        mac: &[u8; MAC_BYTES],
    ) -> Result<(), NackReason> {
        let nonce = self.challenge.take();
        let right = nonce.is_some_and(|nonce| key.permits(mac, &nonce, arm_hash, order));
        self.permission = right.then_some(order);
        right.then_some(()).ok_or(NackReason::Key)
    }

    /// Uses the permission of `order` up.
    ///
    /// Errors: [`NackReason::Key`] where there is none, or one of another order.
    pub(super) fn permitted(&mut self, order: [u8; 2]) -> Result<(), NackReason> {
        let permitted = self.permission.take() == Some(order);
        permitted.then_some(()).ok_or(NackReason::Key)
    }

    /// The signature that the housekeeping has to verify; `None` without a write key. The challenge is used up.
    ///
    /// Errors: [`NackReason::Key`] without challenge or signature.
    pub(super) fn signature(
        &mut self,
        key: Option<&WriteKey>,
        mac: Option<[u8; MAC_BYTES]>,
    ) -> Result<Option<Signature>, NackReason> {
        let Some(&key) = key else {
            return Ok(None);
        };
        match (self.challenge.take(), mac) {
            (Some(nonce), Some(mac)) => Ok(Some(Signature { key, nonce, mac })),
            _ => Err(NackReason::Key),
        }
    }

    /// Counts a good frame; false for one that was received before, or a later one. `restart` restarts the sequence.
    fn accept(&mut self, sequence: u16, restart: bool) -> bool {
        let counters = &mut self.counters;
        counters.frames = counters.frames.saturating_add(1);
        let step = match self.last {
            Some(last) if !restart => sequence.wrapping_sub(last),
            _ => 1,
        };
        if step == 0 || step > u16::MAX - REPEAT_WINDOW {
            counters.repeated = counters.repeated.saturating_add(1);
            return false;
        }
        // A host that wraps leaves out 0, which is the board's own number.
        let left_out = u16::from(!restart && self.last.is_some_and(|last| sequence < last));
        let missed = (step - 1).saturating_sub(left_out);
        counters.missed = counters.missed.saturating_add(u32::from(missed));
        self.last = Some(sequence);
        true
    }

    fn refuse(&mut self, error: DecodeError) {
        let counters = &mut self.counters;
        let counter = match error {
            DecodeError::Framing => &mut counters.framing_errors,
            DecodeError::Checksum => &mut counters.crc_errors,
            DecodeError::ForeignVersion(_) => &mut counters.foreign_version,
            DecodeError::Unknown => &mut counters.unknown,
        };
        *counter = counter.saturating_add(1);
    }

    /// Frames missed and refused, replies lost and overruns: the low halves of their counters.
    pub(in crate::session) fn losses(&self) -> [u16; 4] {
        let counted = &self.counters;
        let refused = counted.crc_errors.wrapping_add(counted.framing_errors);
        let (missed, lost) = (counted.missed, counted.replies_lost);
        [missed, refused, lost, counted.overruns].map(|count| count as u16)
    }
}

/// Signature of an upload, and all that its check needs.
#[derive(Clone, Copy)]
pub(super) struct Signature {
    pub(super) key: WriteKey,
    pub(super) nonce: [u8; MAC_BYTES],
    pub(super) mac: [u8; MAC_BYTES],
}

/// A parameter bank on its way up or down, or an excitation on its way up, in one buffer.
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

    /// Takes the next chunk of an upload. Offset 0 begins anew. A host whose acknowledgement was lost
    /// may send the last chunk again; an earlier one drops those behind it.
    pub(super) fn write(&mut self, offset: u16, chunk: &[u8]) -> Result<(), NackReason> {
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
    pub(super) fn end(&mut self, length: u16) -> Result<(), NackReason> {
        let complete = self.direction == Direction::Up && self.length == usize::from(length);
        self.direction = Direction::Idle;
        complete.then_some(()).ok_or(NackReason::Checksum)
    }

    /// Bytes of the last upload or snapshot.
    pub(super) fn content(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }

    /// Keeps `bytes` for reading, as many as the buffer takes; an unfinished upload is dropped.
    pub(super) fn hold(&mut self, bytes: &[u8]) {
        self.length = self.bytes.len().min(bytes.len());
        copy(&mut self.bytes, bytes);
        self.direction = Direction::Down;
    }

    /// The chunk at `offset` of the bytes kept for reading; empty behind their end.
    pub(super) fn chunk<const N: usize>(&self, offset: u16) -> Result<BoardMessage<N>, NackReason> {
        if self.direction != Direction::Down {
            return Err(NackReason::Gap { expected: 0 });
        }
        let rest = self.content().get(usize::from(offset)..);
        let rest = rest.unwrap_or_default().iter();
        Ok(BoardMessage::BankChunk {
            offset,
            length: self.length as u16,
            bytes: rest.copied().take(CHUNK).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_and_repeats_are_counted() {
        for (numbers, missed_and_repeated) in [
            (&[1, 2, 3][..], (0, 0)),
            (&[900, 901], (0, 0)),
            (&[1, 4], (2, 0)),
            (&[1, 1, 2], (0, 1)),
            (&[1, 3, 2, 4], (1, 1)),
            (&[65534, 65535, 1, 2], (0, 0)),
            (&[65535, 3], (2, 0)),
            (&[65535, 1, 65535, 2], (0, 1)),
            (&[30_000, 100], (35_634, 0)),
        ] {
            let mut link = Protocol::default();
            for &number in numbers {
                link.accept(number, false);
            }
            let Statistics {
                missed, repeated, ..
            } = link.counters;
            assert_eq!((missed, repeated), missed_and_repeated, "{numbers:?}");
        }
    }

    #[test]
    fn a_transfer_without_a_start_asks_for_it() {
        let start = NackReason::Gap { expected: 0 };
        let mut transfer = Transfer::new();
        assert_eq!(transfer.write(64, &[0]), Err(start));
        assert_eq!(transfer.chunk::<6>(0).err(), Some(start));
        assert_eq!(transfer.write(0, &[0; 64]), Ok(()));
        let missing = NackReason::Gap { expected: 64 };
        assert_eq!(transfer.write(128, &[0]), Err(missing));
        assert_eq!(transfer.chunk::<6>(0).err(), Some(start));
    }

    #[test]
    fn hello_restarts_the_count() {
        let mut link = Protocol::default();
        assert!(link.accept(500, false));
        assert!(link.accept(498, true) && link.accept(499, false));
        assert_eq!((link.counters.missed, link.counters.repeated), (0, 0));
    }
}
