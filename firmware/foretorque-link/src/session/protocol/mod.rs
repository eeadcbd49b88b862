//! Bytes to messages and back: frames, sequence numbers, uploads and downloads, telemetry. Moves no torque.

mod link;
mod telemetry;
mod transfer;

pub(super) use link::LinkState;
pub(super) use telemetry::{Instant, Stream};
pub(super) use transfer::Transfer;

use crate::wire::{
    BoardMessage, DecodeError, Decoder, FrameBuffer, HostMessage, MAC_BYTES, NackReason,
};
use crate::write_key::WriteKey;
use link::Order;

/// Content of a frame that is to be acted on.
pub(super) enum Received<const N: usize> {
    /// A message of the host, with its sequence number.
    Message(u16, HostMessage<N>),
    /// A sound frame of another protocol version.
    ForeignVersion,
}

/// State of one link: decoder, sequence numbers, transfer, telemetry.
pub(super) struct Protocol {
    decoder: Decoder,
    pub(super) link: LinkState,
    pub(super) transfer: Transfer,
    pub(super) stream: Stream,
    /// The challenge that the next signature has to cover.
    challenge: Option<[u8; MAC_BYTES]>,
    challenges: u32,
}

impl Protocol {
    pub(super) const fn new() -> Self {
        Self {
            decoder: Decoder::new(),
            link: LinkState::new(None),
            transfer: Transfer::new(),
            stream: Stream::new(),
            challenge: None,
            challenges: 0,
        }
    }

    /// Resets counters and transfers; the sequence continues after `sequence`.
    pub(super) fn reset(&mut self, sequence: u16) {
        self.decoder = Decoder::new();
        self.link = LinkState::new(Some(sequence));
        self.transfer.abort();
        self.stream.end();
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
                let forward = self.link.accept(sequence, restart) == Order::Forward;
                (forward || urgent).then_some(Received::Message(sequence, message))
            }
            Err(error) => {
                self.link.refuse(error);
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
            self.link.replies_lost = self.link.replies_lost.saturating_add(1);
        }
    }

    /// Bytes on the link that belonged to no good frame.
    pub(super) fn bytes_lost(&self) -> u32 {
        self.decoder.bytes_lost()
    }

    /// The challenge that the signature of the next upload has to cover.
    #[inline(never)]
    pub(super) fn challenge(&mut self, key: &WriteKey, seed: &[u8; MAC_BYTES]) -> [u8; MAC_BYTES] {
        let nonce = key.challenge(seed, self.challenges);
        self.challenges = self.challenges.wrapping_add(1);
        self.challenge = Some(nonce);
        nonce
    }

    /// Checks the signature of the upload where there is a write key. The challenge is used up; a refused upload is over.
    ///
    /// Errors: [`NackReason::Key`].
    #[inline(never)]
    pub(super) fn authorise(
        &mut self,
        key: Option<&WriteKey>,
        mac: Option<[u8; MAC_BYTES]>,
        arm_hash: u32,
    ) -> Result<(), NackReason> {
        let Some(key) = key else {
            return Ok(());
        };
        let verified = match (self.challenge.take(), mac) {
            (Some(nonce), Some(mac)) => {
                key.verifies(&mac, &nonce, arm_hash, self.transfer.received())
            }
            _ => false,
        };
        if verified {
            return Ok(());
        }
        self.transfer.abort();
        Err(NackReason::Key)
    }
}
