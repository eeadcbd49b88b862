//! Requests to a board as raw bytes: samples, and a conversation whose every answer is kept.

use crate::trial::PATIENCE;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::dynamics::FrictionColumn;
use foretorque::feedforward::{ParameterSet, evaluate};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::bank::NETWORK_SEED;
use foretorque_link::safety::ARM_SAMPLES;
use foretorque_link::wire::{
    BankSource, Configuration, Decoder, FrameBuffer, HostMessage, ReplyMode, SampleFrame,
};
use foretorque_workbench::board::Transport;

/// Of as many periods these have no sample: gaps of one, two and three.
const EVERY: u32 = 97;
const LOST: [u32; 6] = [50, 60, 61, 70, 71, 72];

/// A motion of all joints fast enough to learn from, with a torque that no model explains well.
pub(crate) fn sample(k: u32) -> JointSample<JOINTS> {
    let t = k as f32 * 1e-3;
    let phase = |joint: usize| t * (2.0 + 0.3 * joint as f32) + joint as f32;
    let rate = |joint: usize| 2.0 + 0.3 * joint as f32;
    let desired = JointMotion {
        q: JointVector::from_fn(|j, _| phase(j).sin()),
        qd: JointVector::from_fn(|j, _| rate(j) * phase(j).cos()),
        qdd: JointVector::from_fn(|j, _| -rate(j) * rate(j) * phase(j).sin()),
    };
    let tau = JointVector::from_fn(|j, _| 4.0 * phase(j).cos() + 2.0 * (3.0 * phase(j)).sin());
    JointSample {
        desired,
        measured: Some(JointMeasurement { q: desired.q, tau }),
    }
}

/// The motion with the torques of an arm a tenth heavier than its description and with friction.
pub(crate) fn credible(k: u32) -> JointSample<JOINTS> {
    let mut truth = ParameterSet::nominal::<Ur5>(NETWORK_SEED);
    truth.rigid *= 1.1;
    for friction in &mut truth.friction {
        friction[FrictionColumn::Viscous] = 2.0;
        friction[FrictionColumn::Coulomb] = 1.0;
    }
    let mut sample = sample(k);
    let tau = evaluate::<Ur5, JOINTS, PARAMETERS>(&truth, &sample.desired).total;
    sample.measured = Some(JointMeasurement {
        q: sample.desired.q,
        tau,
    });
    sample
}

/// One conversation, question by question, as raw bytes.
pub(crate) struct Talk<T> {
    pub(crate) link: T,
    pub(crate) frames: FrameBuffer,
    pub(crate) sequence: u16,
}

impl<T: Transport> Talk<T> {
    /// After the board's own hello, which depends on the board and is not compared.
    pub(crate) fn begin(link: T) -> Self {
        let mut talk = Self {
            link,
            frames: FrameBuffer::new(),
            sequence: 0,
        };
        talk.send(&HostMessage::Reset);
        // The line may hold a greeting; the acknowledgement of the reset is the first answer with our number.
        while talk.receive().0 != talk.sequence {}
        talk
    }

    pub(crate) fn send(&mut self, message: &HostMessage<JOINTS>) {
        self.sequence += 1;
        self.frames.clear();
        self.frames.push(self.sequence, message).unwrap();
        self.link.send(self.frames.as_bytes()).unwrap();
    }

    /// One frame, byte for byte, and the number it carries.
    pub(crate) fn receive(&mut self) -> (u16, Vec<u8>) {
        let mut frame = Vec::new();
        let mut decoder = Decoder::new();
        let mut byte = [0];
        loop {
            let count = self.link.receive(&mut byte, PATIENCE).unwrap();
            assert_eq!(count, 1, "the board answers in time");
            frame.push(byte[0]);
            if let Some(received) = decoder.push(byte[0]) {
                return (received.expect("no bit is lost").sequence, frame);
            }
        }
    }

    pub(crate) fn ask(&mut self, message: &HostMessage<JOINTS>) -> Vec<u8> {
        self.send(message);
        self.receive().1
    }

    /// `ticks` periods while learning, a few of them without a sample, then the whole state that matters: every answer in one
    /// string of bytes.
    pub(crate) fn learn(&mut self, ticks: u32) -> Vec<u8> {
        let configuration = Configuration {
            reply: ReplyMode::Full,
            ..Configuration::default()
        };
        let mut message = self.ask(&HostMessage::Configure(configuration));
        // The learner is done before the next sample comes, however busy this machine is.
        let patient = |k| SampleFrame::new(&sample(k)).answered_after_learning();
        for _ in 0..ARM_SAMPLES {
            message.extend(self.ask(&HostMessage::Sample(patient(0))));
        }
        message.extend(self.ask(&HostMessage::Arm));
        message.extend(self.ask(&HostMessage::Learning { on: true }));
        for k in 0..ticks {
            if !LOST.contains(&(k % EVERY)) {
                message.extend(self.ask(&HostMessage::Sample(patient(k).in_period(k as u8))));
            }
        }
        message.extend(self.ask(&HostMessage::BankRead {
            source: BankSource::Live,
            offset: 0,
        }));
        message
    }
}
