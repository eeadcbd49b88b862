//! Bytes to messages and back: frames, sequence numbers, uploads and downloads, telemetry. Moves no torque.

mod link;
mod telemetry;
mod transfer;

pub(super) use link::LinkState;
pub(super) use telemetry::{Instant, Stream};
pub(super) use transfer::Transfer;

use super::mailbox::Signature;
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
    pub(super) stream: Stream,
    /// The challenge that the next signature has to cover.
    challenge: Option<[u8; MAC_BYTES]>,
    challenges: u32,
    /// The one protected order that the key has permitted.
    permission: Option<[u8; 2]>,
}

impl Protocol {
    pub(super) const fn new() -> Self {
        Self {
            decoder: Decoder::new(),
            link: LinkState::new(None),
            stream: Stream::new(),
            challenge: None,
            challenges: 0,
            permission: None,
        }
    }

    /// Resets counters and telemetry; the sequence continues.
    pub(super) fn reset(&mut self) {
        self.decoder = Decoder::new();
        self.link.reset();
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

    /// Permits one order, if its signature is right. The challenge is used up.
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
        let nonce = self.challenge.take().ok_or(NackReason::Key)?;
        let right = key.permits(mac, &nonce, arm_hash, order);
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
}
