//! Questions and answers: frames out, frames in, each answer to its question.

use super::{BoardError, Client, acknowledged};
use foretorque_link::wire::{BoardHello, BoardMessage, DecodeError, FrameBuffer, HostMessage};
use std::time::{Duration, Instant};

/// Largest number of times that an idempotent request is sent.
const ATTEMPTS: usize = 3;
/// How long one hello is waited for while a board may still be booting.
const HELLO_TIMEOUT: Duration = Duration::from_millis(300);

impl<const N: usize> Client<N> {
    pub(super) fn greet(&mut self, boot: Duration) -> Result<BoardHello, BoardError> {
        let deadline = Instant::now() + boot;
        // An unfinished frame of a predecessor ends here.
        self.transmit(&[0])?;
        loop {
            let sequence = self.post(&HostMessage::Hello)?;
            match self.wait_for(sequence, HELLO_TIMEOUT) {
                Ok(BoardMessage::Hello(hello)) => return Ok(hello),
                Ok(_) => return Err(BoardError::UnexpectedAnswer),
                // The board has just booted, and may not have received the question.
                Err(BoardError::Timeout(_) | BoardError::Restarted(_))
                    if Instant::now() < deadline => {}
                Err(error) => return Err(error),
            }
        }
    }

    pub(super) fn command(&mut self, message: &HostMessage<N>) -> Result<(), BoardError> {
        self.unlock(message)?;
        acknowledged(self.ask(message)?)
    }

    /// Asks a question that may be asked twice without harm.
    pub(super) fn ask(&mut self, message: &HostMessage<N>) -> Result<BoardMessage<N>, BoardError> {
        let mut attempt = 1;
        loop {
            let sequence = self.post(message)?;
            match self.wait_for(sequence, self.timeout) {
                Err(BoardError::Timeout(_)) if attempt < ATTEMPTS => attempt += 1,
                answer => return answer,
            }
        }
    }

    pub(super) fn post(&mut self, message: &HostMessage<N>) -> Result<u16, BoardError> {
        // Number 0 is the board's own, for unasked messages.
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        self.request.clear();
        self.request
            .push(self.sequence, message)
            .expect("every message of the protocol fits an empty frame buffer");
        let frame = self.request.as_bytes().to_vec();
        self.transmit(&frame)?;
        Ok(self.sequence)
    }

    pub(super) fn transmit(&mut self, bytes: &[u8]) -> Result<(), BoardError> {
        let sent = self.transport.send(bytes);
        sent.map_err(|error| BoardError::Closed(self.transport.name(), error))
    }

    /// The answer to question `sequence`.
    pub(super) fn wait_for(
        &mut self,
        sequence: u16,
        timeout: Duration,
    ) -> Result<BoardMessage<N>, BoardError> {
        let deadline = Instant::now() + timeout;
        loop {
            while let Some(&byte) = self.bytes.get(self.next) {
                self.next += 1;
                let received = match self.decoder.push(byte) {
                    None => continue,
                    Some(frame) => frame.and_then(|frame| {
                        Ok((frame.sequence, frame.message::<BoardMessage<N>>()?))
                    }),
                };
                match received {
                    Ok((from, answer)) if from == sequence => return Ok(answer),
                    Ok((0, BoardMessage::Hello(hello))) => {
                        self.safety = hello.safety;
                        return Err(BoardError::Restarted(hello.reset_reason));
                    }
                    Ok((0, BoardMessage::Telemetry(frame))) => self.telemetry.push(frame),
                    Err(DecodeError::ForeignVersion(version)) => {
                        return Err(BoardError::WrongProtocol(version));
                    }
                    // A damaged frame, or an answer to no open question.
                    _ => {}
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            // A board that talks without pause must not keep the question open for ever.
            if left.is_zero() || !self.fill(left)? {
                return Err(BoardError::Timeout(self.transport.name()));
            }
        }
    }

    /// Waits for bytes; `false` when none came in time.
    pub(super) fn fill(&mut self, timeout: Duration) -> Result<bool, BoardError> {
        self.bytes.resize(FrameBuffer::CAPACITY, 0);
        self.next = 0;
        let received = self.transport.receive(&mut self.bytes, timeout);
        self.bytes.truncate(*received.as_ref().unwrap_or(&0));
        match received {
            Ok(count) => Ok(count > 0),
            Err(error) => Err(BoardError::Closed(self.transport.name(), error)),
        }
    }
}
