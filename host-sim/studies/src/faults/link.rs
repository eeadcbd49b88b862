//! Faults of the line and of its messages, with a host that works through them: it keeps sending samples, and arms the
//! board again whenever that has disarmed itself.

use super::Campaign;
use super::damage::{BadLine, Damage};
use super::rig::{Frame, Rig, Round};
use crate::StudyError;
use foretorque::arm::ur5::JOINTS;
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::safety::SafetyState;
use foretorque_link::wire::{
    HostMessage, MAX_FRAME, MotionFrame, PROTOCOL_VERSION, SampleFrame, encode,
};
use foretorque_workbench::board::{BoardError, Transport};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Clean ticks at the end of a campaign, in which the board must come back.
pub(super) const CLEAN_TICKS: u32 = 300;
/// Ticks between two attempts to arm.
pub(super) const ARM_EVERY: u32 = 5;
/// Numbers that break careless arithmetic.
const STRANGE: [f32; 10] = [
    f32::NAN,
    -f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE / 2.0,
    1e-45,
    -0.0,
    1e30,
];

/// The host: a smooth motion of all joints, and the will to have torque.
pub(super) struct Host {
    pub(super) rig: Rig,
    tick: u32,
}

impl Host {
    pub(super) fn new(transport: Box<dyn Transport>, learning: bool) -> Result<Self, BoardError> {
        let mut host = Self {
            rig: Rig::new(transport)?,
            tick: 0,
        };
        host.rig.ask(&HostMessage::Learning { on: learning })?;
        Ok(host)
    }

    fn frames(&mut self) -> Vec<Frame> {
        let mut messages = vec![self.message(&self.sample())];
        messages.extend(order(self.tick, self.rig.state));
        self.tick += 1;
        let messages = messages.iter();
        messages.map(|message| self.rig.frame(message)).collect()
    }

    /// A sample of this tick. Its answer waits for the learning step, which the reference finishes before its next frame.
    fn message(&self, sample: &JointSample<JOINTS>) -> HostMessage<JOINTS> {
        let frame = SampleFrame::new(sample).in_period(self.tick as u8);
        HostMessage::Sample(frame.answered_after_learning())
    }

    pub(super) fn sample(&self) -> JointSample<JOINTS> {
        motion(self.tick)
    }

    /// One undamaged tick.
    pub(super) fn work(&mut self) -> Result<Round, BoardError> {
        let line = bytes_of(self.frames());
        self.rig.send(&line)
    }

    /// Works undamaged until the board is armed, and some ticks more. False when it never is.
    pub(super) fn come_back(&mut self, campaign: &mut Campaign) -> Result<bool, BoardError> {
        for _ in 0..CLEAN_TICKS {
            campaign.count(&self.work()?, 0);
        }
        Ok(self.rig.state == SafetyState::Armed)
    }

    pub(super) fn rest(&mut self) -> Result<(), BoardError> {
        self.rig.ask(&HostMessage::Disarm)?;
        while matches!(self.rig.state, SafetyState::Armed | SafetyState::RampDown) {
            let sample = self.message(&self.sample());
            self.rig.ask(&sample)?;
        }
        Ok(())
    }

    pub(super) fn close(self, mut campaign: Campaign, back: bool) -> Campaign {
        campaign.wrong_torques += self.rig.wrong_torques;
        campaign.torques = self.rig.torques;
        campaign.ended(back)
    }
}

/// The order of a host in one tick to have torque, from a board in this state.
pub(super) fn order(tick: u32, state: SafetyState) -> Option<HostMessage<JOINTS>> {
    match state {
        _ if !tick.is_multiple_of(ARM_EVERY) => None,
        SafetyState::Fault => Some(HostMessage::ClearFault),
        SafetyState::Disarmed => Some(HostMessage::Arm),
        _ => None,
    }
}

/// Desired and measured motion of the host in one tick.
pub(super) fn motion(tick: u32) -> JointSample<JOINTS> {
    let t = tick as f32 * 1e-3;
    let wave = |phase: f32| JointVector::from_fn(|j, _| 0.5 * (t + j as f32 + phase).sin());
    let desired = JointMotion {
        q: wave(0.0),
        qd: wave(std::f32::consts::FRAC_PI_2),
        qdd: wave(std::f32::consts::PI),
    };
    JointSample {
        desired,
        measured: Some(JointMeasurement {
            q: desired.q,
            tau: desired.q * 3.0,
        }),
    }
}

/// `ticks` periods of a host on a line; `line` makes of the frames of a period the bytes that arrive, and counts the faults in
/// them.
///
/// * `shows` every fault must show in the counters of the board
fn on_line(
    name: &str,
    transport: Box<dyn Transport>,
    ticks: u32,
    shows: bool,
    mut line: impl FnMut(&mut Host, Vec<Frame>) -> (Vec<u8>, u64),
) -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new(name, &transport.name());
    let mut host = Host::new(transport, true)?;
    for _ in 0..ticks {
        let frames = host.frames();
        let (bytes, injected) = line(&mut host, frames);
        let round = host.rig.send(&bytes)?;
        campaign.count(&round, injected);
        if shows {
            let unseen = if round.noticed { 0 } else { injected };
            *campaign.unnoticed.get_or_insert(0) += unseen;
        }
    }
    let back = host.come_back(&mut campaign)?;
    Ok(host.close(campaign, back))
}

fn bytes_of(frames: Vec<Frame>) -> Vec<u8> {
    frames.into_iter().flat_map(|frame| frame.bytes).collect()
}

pub(super) fn damaged_line(
    transport: Box<dyn Transport>,
    (damage, name): (Damage, &str),
    ticks: u32,
    seed: u64,
) -> Result<Campaign, StudyError> {
    let mut line = BadLine::new(damage, ChaCha8Rng::seed_from_u64(seed));
    on_line(name, transport, ticks, true, |_, frames| {
        let before = line.injected;
        let carried = frames.iter().flat_map(|frame| line.carry(&frame.bytes));
        (carried.collect(), line.injected - before)
    })
}

/// Samples and motions with numbers that are none, are infinite, or are too small to be normal.
pub(super) fn strange_numbers(
    transport: Box<dyn Transport>,
    ticks: u32,
    seed: u64,
) -> Result<Campaign, StudyError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let name = "NaN, infinite and denormal numbers";
    on_line(name, transport, ticks, false, |host, frames| {
        let mut bytes = bytes_of(frames);
        if !random.random_ratio(1, 4) {
            return (bytes, 0);
        }
        let message = if random.random() {
            let mut sample = host.sample();
            corrupt(&mut sample, &mut random);
            host.message(&sample)
        } else {
            let mut motion = MotionFrame::from(&host.sample().desired);
            for row in [&mut motion.q, &mut motion.qd, &mut motion.qdd] {
                row[random.random_range(0..JOINTS)] = strange(&mut random);
            }
            HostMessage::Evaluate(motion)
        };
        bytes.extend(host.rig.frame(&message).bytes);
        (bytes, 1)
    })
}

fn strange(random: &mut ChaCha8Rng) -> f32 {
    *STRANGE.choose(random).unwrap_or(&f32::NAN)
}

fn corrupt(sample: &mut JointSample<JOINTS>, random: &mut ChaCha8Rng) {
    let joint = random.random_range(0..JOINTS);
    let desired = &mut sample.desired;
    let Some(measured) = &mut sample.measured else {
        return;
    };
    let rows = [
        &mut desired.q,
        &mut desired.qd,
        &mut desired.qdd,
        &mut measured.q,
        &mut measured.tau,
    ];
    rows[random.random_range(0..5)][joint] = strange(random);
}

/// Sound frames of other protocol versions, of another number of joints, and with unknown messages.
pub(super) fn foreign_frames(
    transport: Box<dyn Transport>,
    ticks: u32,
    seed: u64,
) -> Result<Campaign, StudyError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let name = "frames of another version or robot";
    on_line(name, transport, ticks, true, |_, frames| {
        let injected = random.random_ratio(1, 4);
        let first = match injected {
            true => foreign(&mut random),
            false => Vec::new(),
        };
        ([first, bytes_of(frames)].concat(), u64::from(injected))
    })
}

/// A sound frame that is not for this board.
fn foreign(random: &mut ChaCha8Rng) -> Vec<u8> {
    let sequence: u16 = random.random();
    let motion = JointMotion::<7>::zero();
    let sample = JointSample {
        desired: motion,
        measured: None,
    };
    let mut buffer = [0; MAX_FRAME];
    let other = HostMessage::<7>::Sample(SampleFrame::new(&sample));
    let frame = encode(sequence, &other, &mut buffer).unwrap_or_default();
    if random.random() {
        return frame.to_vec();
    }
    // Another version, or an unknown message: sealed anew by hand.
    let mut content = frame.to_vec();
    let length = cobs::decode_in_place(&mut content[..frame.len() - 1]).unwrap_or(0);
    content.truncate(length.saturating_sub(4));
    if random.random() {
        content[0] = PROTOCOL_VERSION.wrapping_add(random.random_range(1..=255));
    } else {
        content[3] = random.random_range(100..=255);
    }
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&content);
    content.extend(crc.to_le_bytes());
    let mut sealed = vec![0; cobs::max_encoding_length(content.len()) + 1];
    let length = cobs::encode(&content, &mut sealed);
    sealed.truncate(length + 1);
    sealed
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque::arm::ur5::{PARAMETERS, Ur5};
    use foretorque_workbench::board::Native;

    fn host() -> Host {
        let native = Native::<Ur5, JOINTS, PARAMETERS>::new().unwrap();
        let mut host = Host::new(Box::new(native), false).unwrap();
        assert!(host.come_back(&mut Campaign::default()).unwrap());
        assert_eq!(host.rig.wrong_torques, 0);
        host
    }

    #[test]
    fn a_torque_that_the_reference_does_not_give_is_wrong() {
        let mut host = host();
        // A sample that the reference never receives moves the slew of the board alone.
        let mut sample = host.sample();
        sample.desired.qdd = JointVector::repeat(5.0);
        let frame = host.rig.unreferenced_frame(&host.message(&sample));
        host.rig.send(&frame.bytes).unwrap();
        host.work().unwrap();
        assert!(host.rig.wrong_torques > 0);
    }
}
