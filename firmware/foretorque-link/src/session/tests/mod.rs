//! A board under test, and the messages that it receives.

mod arming;
mod gaps;
mod keys;
mod line;
mod store;
mod ticks;
mod time;

use super::*;
use crate::bank::{NETWORK_SEED, ParameterBank};
use crate::safety::{ARM_SAMPLES, SafetyLimits, SafetyState};
use crate::telemetry::Statistics;
use crate::wire::{
    BankSource, BoardHello, CHUNK, CRC, Capabilities, ChipStatus, ClockSource, Decoder,
    HostMessage, ImageStatus, MAC_BYTES, NackReason, Pacing, ResetReason, SampleFrame, TorqueFrame,
    encode,
};
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque::learning::{Learner, LearnerConfig, ParameterSet};
use foretorque::limits::Flags;
use std::boxed::Box;
use std::vec::Vec;
use store::Flash;

pub(crate) const N: usize = 6;
const P: usize = 40;
pub(crate) const ACK: BoardMessage<N> = BoardMessage::Ack;

pub(crate) const fn nack(reason: NackReason) -> BoardMessage<N> {
    BoardMessage::Nack(reason)
}

const fn no_torque(reason: SafetyReason) -> BoardMessage<N> {
    nack(NackReason::Unsafe(reason))
}

type Mac = [u8; MAC_BYTES];
pub(crate) type Replies = Vec<(u16, BoardMessage<N>)>;

/// A session with its mailboxes and learner.
pub(crate) struct Board {
    pub(crate) session: Box<Session<Ur5, N, P>>,
    mailboxes: Box<Mailboxes<N, P>>,
    housekeeping: Box<Housekeeping<Ur5, N, P, Flash>>,
    learner: Box<Learner<Ur5, N, P>>,
    sequence: u16,
}

impl Board {
    pub(crate) fn new() -> Self {
        Self::with(|board| board.capabilities = Capabilities::LEARNING | Capabilities::TIMER)
    }

    /// A plain board, but for `change`.
    fn with(change: impl FnOnce(&mut BoardDescription)) -> Self {
        let mut description = BoardDescription::plain(NoClock);
        change(&mut description);
        let session = Session::new(description).unwrap();
        let set = session.feed_forward().state().active;
        Self {
            session: Box::new(session),
            mailboxes: Box::default(),
            housekeeping: Box::new(Housekeeping::new(None)),
            learner: Box::new(Learner::new(LearnerConfig::for_arm::<Ur5>(1e-3), set).unwrap()),
            sequence: 0,
        }
    }

    fn armed() -> Self {
        let mut board = Self::new();
        board.arm();
        (0..20).for_each(|_| _ = board.sample(0));
        assert_ne!(board.sample(0).total, [0.0; N]);
        board
    }

    fn receive(&mut self, bytes: &[u8]) -> Replies {
        self.output(|session, mailboxes, out| {
            session.receive(bytes, mailboxes, out, &mut NoLocalSensor);
        })
    }

    fn timer(&mut self) -> Replies {
        self.output(|session, mailboxes, out| {
            session.timer_tick(mailboxes, out, &mut NoLocalSensor);
        })
    }

    pub(crate) fn output(
        &mut self,
        act: impl FnOnce(&mut Session<Ur5, N, P>, &mut Mailboxes<N, P>, &mut FrameBuffer),
    ) -> Replies {
        let mut out = FrameBuffer::new();
        act(&mut self.session, &mut self.mailboxes, &mut out);
        if self.housekeeping.work(&mut self.mailboxes.parameters) {
            self.session.poll_parameters(&mut self.mailboxes, &mut out);
        }
        decoded(out.as_bytes())
    }

    /// The frame of a message under the next number.
    pub(crate) fn numbered(&mut self, message: &HostMessage<N>) -> Vec<u8> {
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        frame(self.sequence, message)
    }

    fn send(&mut self, message: &HostMessage<N>) -> Replies {
        let frame = self.numbered(message);
        self.receive(&frame)
    }

    /// The one reply to a message.
    fn request(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        let replies = self.send(&message);
        let [(sequence, reply)] = replies.as_slice() else {
            panic!("{} replies", replies.len());
        };
        assert_eq!(*sequence, self.sequence);
        reply.clone()
    }

    #[track_caller]
    fn acknowledged(&mut self, message: HostMessage<N>) {
        assert_eq!(self.request(message), ACK);
    }

    fn hello(&mut self) -> BoardHello {
        match self.request(HostMessage::Hello) {
            BoardMessage::Hello(hello) => hello,
            other => panic!("{other:?}"),
        }
    }

    fn sample(&mut self, k: u32) -> TorqueFrame<N> {
        torque(&self.request(sample_message(k)))
    }

    /// As many samples as arming takes.
    fn samples_to_arm(&mut self) {
        for _ in 0..ARM_SAMPLES {
            assert_eq!(self.sample(0).total, [0.0; N]);
        }
    }

    /// Samples until the board can be armed, then arms it.
    fn arm(&mut self) {
        self.samples_to_arm();
        self.acknowledged(HostMessage::Arm);
    }

    /// One period of a board with a timer: at most one sample, then the timer, whichever of the two paces the board.
    fn period(&mut self, sample: Option<JointSample<N>>) -> Option<TorqueFrame<N>> {
        let mut replies = sample.map_or(Vec::new(), |sample| {
            self.send(&HostMessage::Sample(SampleFrame::new(&sample)))
        });
        replies.extend(self.timer());
        assert!(replies.len() <= 1);
        replies.first().map(|(_, reply)| torque(reply))
    }

    pub(crate) fn pace(&mut self, pacing: Pacing) {
        self.acknowledged(configure(|wanted| wanted.pacing = pacing));
    }

    fn learn(&mut self) {
        self.mailboxes.learner.work(&mut self.learner, &NoClock);
    }

    fn statistics(&self) -> Statistics {
        self.session.statistics(&self.mailboxes.learner)
    }

    fn read_from(&mut self, source: BankSource) -> Vec<u8> {
        let read = |offset: usize| HostMessage::BankRead {
            source,
            offset: offset as u16,
        };
        let mut bank = Vec::new();
        let mut reply = self.request(read(0));
        loop {
            let BoardMessage::BankChunk { bytes, length, .. } = reply else {
                panic!("{reply:?}");
            };
            bank.extend(bytes);
            if bank.len() == usize::from(length) {
                return bank;
            }
            reply = self.request(read(bank.len()));
        }
    }

    fn read(&mut self) -> Vec<u8> {
        self.read_from(BankSource::Live)
    }

    fn write(&mut self, bank: &[u8]) {
        for place in 0..bank.len().div_ceil(CHUNK) {
            self.acknowledged(write(bank, place));
        }
    }

    fn commit(&mut self, bank: &[u8], mac: Option<Mac>) -> BoardMessage<N> {
        let (length, crc) = (bank.len() as u16, CRC.checksum(bank));
        self.request(HostMessage::BankCommit { length, crc, mac })
    }

    fn upload(&mut self, bank: &[u8], mac: Option<Mac>) -> BoardMessage<N> {
        self.write(bank);
        self.commit(bank, mac)
    }
}

/// The default configuration, but for `change`.
fn configure(change: impl FnOnce(&mut Configuration)) -> HostMessage<N> {
    let mut wanted = Configuration::default();
    change(&mut wanted);
    HostMessage::Configure(wanted)
}

/// Chunk `place` of an upload.
fn write(bank: &[u8], place: usize) -> HostMessage<N> {
    let chunk = bank.chunks(CHUNK).nth(place).unwrap();
    HostMessage::BankWrite {
        offset: (place * CHUNK) as u16,
        bytes: chunk.iter().copied().collect(),
    }
}

fn frame(sequence: u16, message: &HostMessage<N>) -> Vec<u8> {
    encode(sequence, message, &mut [0; 300]).unwrap().to_vec()
}

fn decoded(bytes: &[u8]) -> Replies {
    let mut decoder = Decoder::new();
    let frames = bytes.iter().filter_map(|&byte| {
        let frame = decoder.push(byte)?.unwrap();
        Some((frame.sequence, frame.message().unwrap()))
    });
    frames.collect()
}

pub(crate) fn torque(reply: &BoardMessage<N>) -> TorqueFrame<N> {
    match reply {
        BoardMessage::Torque(torque) => *torque,
        other => panic!("{other:?}"),
    }
}

fn sample(k: u32) -> JointSample<N> {
    let t = k as f32 * 3e-3;
    let q = JointVector::from_fn(|j, _| (t + j as f32).sin());
    JointSample {
        desired: JointMotion {
            q,
            qd: JointVector::from_fn(|j, _| (t + j as f32).cos()),
            qdd: -q,
        },
        measured: Some(JointMeasurement {
            q,
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
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut buffer).unwrap().to_vec()
}
