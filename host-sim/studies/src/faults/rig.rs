//! A board under test, a reference beside it, and the line between host and board.

use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::learning::ConfigError;
use foretorque::limits::Flags;
use foretorque_link::safety::SafetyState;
use foretorque_link::telemetry::Statistics;
use foretorque_link::wire::{BoardMessage, Decoder, FrameBuffer, HostMessage, MAX_FRAME, encode};
use foretorque_workbench::board::{BoardError, Native, Transport};
use std::time::{Duration, Instant};

const TIMEOUT: Duration = Duration::from_secs(20);
/// Intact frames behind every line, from whose replies the resynchronisation is measured.
const MARKERS: u32 = 3;
const BUFFER: usize = 4096;

/// One frame on its way, and what the reference shall make of it.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub(super) sequence: u16,
    pub(super) bytes: Vec<u8>,
    /// The reference gets it once the board has answered it. Not so where it must have no effect.
    referred: bool,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Round {
    /// Answers of the board, without hellos and markers.
    pub(super) answers: Vec<BoardMessage<JOINTS>>,
    /// Intact frames after the damage until one was received; more than [`MARKERS`] where none was.
    pub(super) resynchronised: u32,
    /// Torques for fresh samples that are the reference's.
    pub(super) right_torques: u32,
    /// A counter of the board has counted an error.
    pub(super) noticed: bool,
}

/// The board under test behind any link, and a board in this process that gets the accepted frames only.
pub(super) struct Rig {
    transport: Box<dyn Transport>,
    reference: Native<Ur5, JOINTS, PARAMETERS>,
    sequence: u16,
    decoder: Decoder,
    received: Decoder,
    /// Frame sent last under each number.
    sent: Vec<Option<Frame>>,
    errors: u64,
    pub(super) wrong_torques: u64,
    pub(super) torques: u64,
    pub(super) state: SafetyState,
}

impl Rig {
    /// A board that has just booted behind `transport`.
    pub(super) fn new(transport: Box<dyn Transport>) -> Result<Self, BoardError> {
        let mut rig = Self {
            transport,
            reference: reference().map_err(|_| BoardError::UnexpectedAnswer)?,
            sequence: 0,
            decoder: Decoder::new(),
            received: Decoder::new(),
            sent: vec![None; 1 << 16],
            errors: 0,
            wrong_torques: 0,
            torques: 0,
            state: SafetyState::default(),
        };
        rig.ask(&HostMessage::Hello)?;
        Ok(rig)
    }

    /// The frame of a message under the next number.
    pub(super) fn frame(&mut self, message: &HostMessage<JOINTS>) -> Frame {
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        let mut buffer = [0; MAX_FRAME];
        let bytes = encode(self.sequence, message, &mut buffer).unwrap_or_default();
        let frame = Frame {
            sequence: self.sequence,
            bytes: bytes.to_vec(),
            referred: true,
        };
        self.sent[usize::from(frame.sequence)] = Some(frame.clone());
        frame
    }

    /// The frame of a message that the reference shall never get.
    pub(super) fn unreferenced_frame(&mut self, message: &HostMessage<JOINTS>) -> Frame {
        let mut frame = self.frame(message);
        frame.referred = false;
        self.sent[usize::from(frame.sequence)] = Some(frame.clone());
        frame
    }

    /// Sends `message` undamaged; its answer.
    pub(super) fn ask(
        &mut self,
        message: &HostMessage<JOINTS>,
    ) -> Result<BoardMessage<JOINTS>, BoardError> {
        let frame = self.frame(message);
        let mut round = self.send_frame(&frame)?;
        round.answers.pop().ok_or(BoardError::UnexpectedAnswer)
    }

    /// Sends `line`, and [`MARKERS`] requests for the counters behind it; judges all that the board answers meanwhile.
    pub(super) fn send(&mut self, line: &[u8]) -> Result<Round, BoardError> {
        self.exchange(line, None)
    }

    /// Sends `frame` as [`send`](Self::send) does, and waits for its answer: orders about parameters take their time.
    pub(super) fn send_frame(&mut self, frame: &Frame) -> Result<Round, BoardError> {
        self.exchange(&frame.bytes, Some(frame.sequence))
    }

    fn exchange(&mut self, line: &[u8], mut awaited: Option<u16>) -> Result<Round, BoardError> {
        let markers = [(); MARKERS as usize].map(|()| self.frame(&HostMessage::Statistics));
        // The reference gets frames in the order of their answers: markers must not overtake a frame that is awaited.
        let mut behind: Vec<u8> = markers.iter().flat_map(|it| it.bytes.clone()).collect();
        let mut bytes = line.to_vec();
        if awaited.is_none() {
            bytes.append(&mut behind);
        }
        self.post(&bytes)?;
        let mut round = Round {
            resynchronised: MARKERS + 1,
            ..Round::default()
        };
        let deadline = Instant::now() + TIMEOUT;
        let mut marked = false;
        loop {
            for (sequence, message) in self.listen()? {
                awaited = awaited.filter(|&number| number != sequence);
                // Unasked messages of the board.
                if sequence == 0 {
                    continue;
                }
                round.right_torques += u32::from(self.judge(sequence, &message)?);
                let BoardMessage::Statistics(statistics) = &message else {
                    round.answers.push(message);
                    continue;
                };
                let mut places = 1..;
                let mut sent = markers.iter().zip(&mut places);
                let place = sent.find(|(marker, _)| marker.sequence == sequence);
                let place = place.map_or(MARKERS + 1, |(_, place)| place);
                round.resynchronised = round.resynchronised.min(place);
                let errors = errors(statistics);
                round.noticed |= errors != self.errors;
                self.errors = errors;
                marked |= place == MARKERS;
            }
            if marked {
                return Ok(round);
            }
            if awaited.is_none() && !behind.is_empty() {
                self.post(&std::mem::take(&mut behind))?;
            }
            if Instant::now() > deadline {
                return Err(BoardError::Timeout(self.transport.name()));
            }
        }
    }

    fn post(&mut self, bytes: &[u8]) -> Result<(), BoardError> {
        let sent = self.transport.send(bytes);
        sent.map_err(|error| BoardError::Closed(self.transport.name(), error))
    }

    fn listen(&mut self) -> Result<Vec<(u16, BoardMessage<JOINTS>)>, BoardError> {
        let mut buffer = [0; BUFFER];
        let count = self.transport.receive(&mut buffer, TIMEOUT);
        let count = count.map_err(|error| BoardError::Closed(self.transport.name(), error))?;
        let mut messages = Vec::new();
        for &byte in buffer.get(..count).unwrap_or_default() {
            if let Some(frame) = self.decoder.push(byte) {
                let frame = frame.map_err(|_| BoardError::UnexpectedAnswer)?;
                let message = frame.message().map_err(|_| BoardError::UnexpectedAnswer)?;
                messages.push((frame.sequence, message));
            }
        }
        Ok(messages)
    }

    /// Compares an answer with the reference's, which gets the frame now. True for a right torque of a fresh sample.
    fn judge(&mut self, sequence: u16, answer: &BoardMessage<JOINTS>) -> Result<bool, BoardError> {
        let torque = match answer {
            BoardMessage::Torque(torque) => Some((torque.safety, torque.flags, torque.total)),
            BoardMessage::FullTorque(full) => {
                Some((full.safety, full.torque.flags, full.torque.total))
            }
            _ => None,
        };
        if let Some((safety, _, total)) = torque {
            (self.torques, self.state) = (self.torques + 1, safety.state);
            self.wrong_torques += u64::from(!total.iter().all(|torque| torque.is_finite()));
        }
        let frame = self.sent[usize::from(sequence)].clone();
        if frame.as_ref().is_some_and(|frame| !frame.referred) {
            return Ok(false);
        }
        // Nothing of that number was sent, or the reference has had it and does not act on it twice.
        let expected = frame.and_then(|frame| self.refer(&frame).transpose());
        let Some(expected) = expected.transpose()? else {
            self.wrong_torques += 1;
            return Ok(false);
        };
        let counts = matches!(answer, BoardMessage::Statistics(_) | BoardMessage::Hello(_));
        let right = counts || bytes(sequence, &expected) == bytes(sequence, answer);
        self.wrong_torques += u64::from(!right);
        let fresh = |flags| !Flags(flags).contains(Flags::STALE_SAMPLE);
        Ok(right && torque.is_some_and(|(_, flags, _)| fresh(flags)))
    }

    /// Answer of the reference to `frame`; `None` when it does not act on it.
    fn refer(&mut self, frame: &Frame) -> Result<Option<BoardMessage<JOINTS>>, BoardError> {
        let gone = |error| BoardError::Closed("reference".into(), error);
        self.reference.send(&frame.bytes).map_err(gone)?;
        let mut buffer = [0; FrameBuffer::CAPACITY];
        let count = self.reference.receive(&mut buffer, TIMEOUT);
        let count = count.map_err(gone)?;
        let mut answer = None;
        for &byte in buffer.get(..count).unwrap_or_default() {
            if let Some(Ok(received)) = self.received.push(byte)
                && received.sequence == frame.sequence
            {
                answer = received.message().ok();
            }
        }
        Ok(answer)
    }
}

fn reference() -> Result<Native<Ur5, JOINTS, PARAMETERS>, ConfigError> {
    let mut reference = Native::new()?;
    // Its hello is for nobody.
    let _ = reference.receive(&mut [0; FrameBuffer::CAPACITY], Duration::ZERO);
    Ok(reference)
}

fn errors(statistics: &Statistics) -> u64 {
    let errors = [
        statistics.crc_errors,
        statistics.framing_errors,
        statistics.foreign_version,
        statistics.unknown,
        statistics.missed,
        statistics.repeated,
        statistics.implausible,
    ];
    errors.map(u64::from).iter().sum()
}

/// The bytes of a message, with every NaN the same: processors make different ones.
fn bytes(sequence: u16, message: &BoardMessage<JOINTS>) -> Vec<u8> {
    let mut message = message.clone();
    if let BoardMessage::Evaluated(frame) = &mut message {
        let shares = [
            &mut frame.total,
            &mut frame.rigid,
            &mut frame.friction,
            &mut frame.network,
        ];
        for value in shares.into_iter().flatten().filter(|value| value.is_nan()) {
            *value = f32::NAN;
        }
    }
    let mut buffer = [0; MAX_FRAME];
    encode(sequence, &message, &mut buffer)
        .unwrap_or_default()
        .to_vec()
}
