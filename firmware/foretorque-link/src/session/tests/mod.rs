//! One board and what is said to it; the tests are in the rooms below.

mod arming;
mod banks;
mod gaps;
mod keys;
mod line;
mod stored;
mod streams;
mod ticks;

use super::*;
use crate::bank::NETWORK_SEED;
use crate::safety::{ARM_SAMPLES, Safety, SafetyLimits, SafetyState};
use crate::wire::{
    BankSource, CHUNK, CRC, Capabilities, Chunk, Decoder, HostMessage, NackReason, Pacing,
    ResetReason, SampleFrame, TorqueFrame, encode,
};
use foretorque::arm::ur5::Ur5;
use foretorque::feedforward::FeedForwardConfig;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{Learner, LearnerConfig, ParameterSet};
use foretorque::limits::Flags;
use std::boxed::Box;
use std::vec::Vec;

const N: usize = 6;
const P: usize = 40;

/// A session with its mailbox and learner, as one board has them.
struct Board {
    session: Box<Session<Ur5, N, P>>,
    mailboxes: Box<Mailboxes<N, P>>,
    learner: Box<Learner<Ur5, N, P>>,
    sequence: u16,
}

impl Board {
    fn new() -> Self {
        let mut description = BoardDescription::plain(NoClock);
        description.capabilities = Capabilities::LEARNING | Capabilities::TIMER;
        Self::described(description)
    }

    fn described(description: BoardDescription) -> Self {
        let session = Session::new(description).unwrap();
        let set = session.feed_forward().state().active;
        Self {
            session: Box::new(session),
            mailboxes: Box::default(),
            learner: Box::new(Learner::new(LearnerConfig::for_arm::<Ur5>(1e-3), set).unwrap()),
            sequence: 0,
        }
    }

    fn hear(&mut self, bytes: &[u8]) -> Vec<(u16, BoardMessage<N>)> {
        let mut out = FrameBuffer::new();
        self.session
            .receive(bytes, &mut self.mailboxes, &mut out, &mut NoLocalSensor);
        heard(out.as_bytes())
    }

    fn ask(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        self.sequence += 1;
        let answers = self.hear(&frame(self.sequence, &message));
        let [(sequence, answer)] = answers.as_slice() else {
            panic!("{} answers", answers.len());
        };
        assert_eq!(*sequence, self.sequence);
        answer.clone()
    }

    fn sample(&mut self, k: u32) -> TorqueFrame<N> {
        match self.ask(sample_message(k)) {
            BoardMessage::Torque(torque) => torque,
            other => panic!("{other:?}"),
        }
    }

    /// Samples until the board can be armed, then arms it.
    fn arm(&mut self) {
        for _ in 0..ARM_SAMPLES {
            assert_eq!(self.sample(0).total, [0.0; N]);
        }
        assert_eq!(self.ask(HostMessage::Arm), BoardMessage::Ack);
    }

    fn timer(&mut self) -> Vec<(u16, BoardMessage<N>)> {
        let mut out = FrameBuffer::new();
        self.session
            .timer_tick(&mut self.mailboxes, &mut out, &mut NoLocalSensor);
        heard(out.as_bytes())
    }

    /// One period of a board on its own clock: at most one sample, then the timer, whichever of the two paces the board.
    fn period(&mut self, sample: Option<JointSample<N>>) -> Option<TorqueFrame<N>> {
        let mut answers = Vec::new();
        if let Some(sample) = sample {
            self.sequence += 1;
            let message = HostMessage::Sample(SampleFrame::new(&sample));
            answers.extend(self.hear(&frame(self.sequence, &message)));
        }
        answers.extend(self.timer());
        match answers.as_slice() {
            [] => None,
            [(_, BoardMessage::Torque(torque))] => Some(*torque),
            other => panic!("{other:?}"),
        }
    }

    fn learn(&mut self) {
        self.mailboxes.learner.work(&mut self.learner, &NoClock);
    }

    fn read(&mut self) -> Vec<u8> {
        let mut bank = Vec::new();
        loop {
            let offset = bank.len() as u16;
            match self.ask(HostMessage::BankRead {
                source: BankSource::Live,
                offset,
            }) {
                BoardMessage::BankChunk { bytes, length, .. } => {
                    bank.extend(bytes);
                    if bank.len() == usize::from(length) {
                        return bank;
                    }
                }
                other => panic!("{other:?}"),
            }
        }
    }

    fn write(&mut self, bank: &[u8]) {
        for (place, piece) in bank.chunks(CHUNK).enumerate() {
            let bytes: Chunk = piece.iter().copied().collect();
            let offset = (place * CHUNK) as u16;
            let answer = self.ask(HostMessage::BankWrite { offset, bytes });
            assert_eq!(answer, BoardMessage::Ack);
        }
    }

    fn commit(&mut self, bank: &[u8]) -> BoardMessage<N> {
        self.ask(HostMessage::BankCommit {
            length: bank.len() as u16,
            crc: CRC.checksum(bank),
            mac: None,
        })
    }
}

fn frame(sequence: u16, message: &HostMessage<N>) -> Vec<u8> {
    encode(sequence, message, &mut [0; 300]).unwrap().to_vec()
}

fn heard(bytes: &[u8]) -> Vec<(u16, BoardMessage<N>)> {
    let mut decoder = Decoder::new();
    let mut messages = Vec::new();
    for &byte in bytes {
        if let Some(frame) = decoder.push(byte) {
            let frame = frame.unwrap();
            messages.push((frame.sequence, frame.message().unwrap()));
        }
    }
    messages
}

fn sample(k: u32) -> JointSample<N> {
    let t = k as f32 * 5e-3;
    JointSample {
        desired: JointMotion {
            q: JointVector::from_fn(|j, _| (t + j as f32).sin()),
            qd: JointVector::from_fn(|j, _| (t + j as f32).cos()),
            qdd: JointVector::from_fn(|j, _| -(t + j as f32).sin()),
        },
        measured: Some(JointMeasurement {
            q: JointVector::from_fn(|j, _| (t + j as f32).sin()),
            tau: JointVector::<N>::repeat(2.0),
        }),
    }
}

fn sample_message(k: u32) -> HostMessage<N> {
    HostMessage::Sample(SampleFrame::new(&sample(k)))
}

fn uploaded() -> Vec<u8> {
    let mut bank = ParameterBank::nominal::<Ur5, N, P>();
    bank.columns[0].value += 1.0;
    bank.drive_gains_nm_a.fill(10.0);
    let mut room = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut room).unwrap().to_vec()
}
