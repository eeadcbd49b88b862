//! Faults of the line and of what is said on it, with a host that works through them: it keeps sending samples, and arms the
//! board again whenever that has disarmed itself.

use super::Campaign;
use super::damage::{BadLine, Damage};
use super::rig::{Frame, Rig, Round};
use super::store::set;
use crate::board::{BoardError, Transport};
use foretorque::arm::ur5::JOINTS;
use foretorque::edge::bank::ParameterBank;
use foretorque::edge::safety::SafetyState;
use foretorque::edge::wire::{
    BankSource, BoardMessage, CHUNK, HostMessage, MAX_FRAME, MotionFrame, PROTOCOL_VERSION,
    SampleFrame, encode,
};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Clean ticks at the end of a campaign, in which the board must come back.
const CLEAN_TICKS: u32 = 300;
/// Ticks between two attempts to arm.
const ARM_EVERY: u32 = 5;
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
struct Host {
    rig: Rig,
    tick: u32,
}

impl Host {
    fn new(transport: Box<dyn Transport>, learning: bool) -> Result<Self, BoardError> {
        let mut host = Self {
            rig: Rig::new(transport)?,
            tick: 0,
        };
        host.rig.ask(&HostMessage::Learning { on: learning })?;
        Ok(host)
    }

    /// What there is to say in the next tick.
    fn frames(&mut self) -> Vec<Frame> {
        let mut messages = vec![HostMessage::Sample(SampleFrame::new(&self.sample()))];
        if self.tick.is_multiple_of(ARM_EVERY) {
            match self.rig.state {
                SafetyState::Fault => messages.push(HostMessage::ClearFault),
                SafetyState::Disarmed => messages.push(HostMessage::Arm),
                _ => {}
            }
        }
        self.tick += 1;
        messages
            .iter()
            .map(|message| self.rig.frame(message))
            .collect()
    }

    fn sample(&self) -> JointSample<JOINTS> {
        let t = self.tick as f32 * 1e-3;
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

    /// One undamaged tick.
    fn work(&mut self) -> Result<Round, BoardError> {
        let line: Vec<u8> = self
            .frames()
            .into_iter()
            .flat_map(|frame| frame.bytes)
            .collect();
        self.rig.send(&line)
    }

    /// Works undamaged until the board is armed, and some ticks more. False when it never is.
    fn come_back(&mut self) -> Result<bool, BoardError> {
        for _ in 0..CLEAN_TICKS {
            self.work()?;
        }
        Ok(self.rig.state == SafetyState::Armed)
    }

    /// Ends the torque.
    fn rest(&mut self) -> Result<(), BoardError> {
        self.rig.ask(&HostMessage::Disarm)?;
        while matches!(self.rig.state, SafetyState::Armed | SafetyState::RampDown) {
            let sample = HostMessage::Sample(SampleFrame::new(&self.sample()));
            self.rig.ask(&sample)?;
        }
        Ok(())
    }

    fn close(self, mut campaign: Campaign, back: bool) -> Campaign {
        campaign.wrong_torques += self.rig.wrong_torques;
        campaign.torques = self.rig.torques;
        if !back {
            campaign.recovered = 0;
        }
        campaign
    }
}

/// `ticks` samples over a line that does `damage`.
pub fn damaged_line(
    transport: Box<dyn Transport>,
    damage: Damage,
    ticks: u32,
    seed: u64,
) -> Result<Campaign, BoardError> {
    let mut campaign = Campaign::new(damage.name(), &transport.name());
    let mut line = BadLine::new(damage, ChaCha8Rng::seed_from_u64(seed));
    let mut host = Host::new(transport, true)?;
    for _ in 0..ticks {
        let before = line.injected;
        let frames = host.frames();
        let bytes: Vec<u8> = frames
            .iter()
            .flat_map(|frame| line.carry(&frame.bytes))
            .collect();
        campaign.note(&host.rig.send(&bytes)?, line.injected - before);
    }
    let back = host.come_back()?;
    Ok(host.close(campaign, back))
}

/// Samples and motions with numbers that are none, are infinite, or are too small to be normal.
pub fn strange_numbers(
    transport: Box<dyn Transport>,
    ticks: u32,
    seed: u64,
) -> Result<Campaign, BoardError> {
    let mut campaign = Campaign::new("NaN, infinite and denormal numbers", &transport.name());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut host = Host::new(transport, true)?;
    for _ in 0..ticks {
        let mut line: Vec<u8> = Vec::new();
        let mut injected = 0;
        for frame in host.frames() {
            line.extend(frame.bytes);
        }
        if random.random_ratio(1, 4) {
            let message = if random.random() {
                let mut sample = host.sample();
                spoil(&mut sample, &mut random);
                HostMessage::Sample(SampleFrame::new(&sample))
            } else {
                let mut motion = MotionFrame::from(&host.sample().desired);
                let rows = [&mut motion.q, &mut motion.qd, &mut motion.qdd];
                for row in rows {
                    row[random.random_range(0..JOINTS)] = strange(&mut random);
                }
                HostMessage::Evaluate(motion)
            };
            line.extend(host.rig.frame(&message).bytes);
            injected = 1;
        }
        let round = host.rig.send(&line)?;
        campaign.count(&round, injected);
    }
    let back = host.come_back()?;
    Ok(host.close(campaign, back))
}

fn strange(random: &mut ChaCha8Rng) -> f32 {
    *STRANGE.choose(random).unwrap_or(&f32::NAN)
}

fn spoil(sample: &mut JointSample<JOINTS>, random: &mut ChaCha8Rng) {
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

/// Sound frames of other protocol versions, of another number of joints, and with messages that nobody knows.
pub fn foreign_frames(
    transport: Box<dyn Transport>,
    ticks: u32,
    seed: u64,
) -> Result<Campaign, BoardError> {
    let mut campaign = Campaign::new("frames of another version or robot", &transport.name());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut host = Host::new(transport, true)?;
    for _ in 0..ticks {
        let mut line: Vec<u8> = Vec::new();
        let injected = u64::from(random.random_ratio(1, 4));
        if injected > 0 {
            line.extend(foreign(&mut random));
        }
        for frame in host.frames() {
            line.extend(frame.bytes);
        }
        let round = host.rig.send(&line)?;
        campaign.note(&round, injected);
    }
    let back = host.come_back()?;
    Ok(host.close(campaign, back))
}

/// A sound frame that is not for this board.
fn foreign(random: &mut ChaCha8Rng) -> Vec<u8> {
    let sequence: u16 = random.random();
    let motion = JointMotion::<7>::zero();
    let sample = JointSample {
        desired: motion,
        measured: None,
    };
    let mut room = [0; MAX_FRAME];
    let other = HostMessage::<7>::Sample(SampleFrame::new(&sample));
    let frame = encode(sequence, &other, &mut room).unwrap_or_default();
    if random.random() {
        return frame.to_vec();
    }
    // Another version, or a message that nobody knows: sealed anew by hand.
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

/// How an upload fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadUpload {
    /// It stops before its end, with or without a commit.
    Interrupted,
    /// The board is reset in the middle of it.
    Reset,
    /// The bank is for another robot.
    WrongRobot,
    /// The bank is of another format version.
    WrongVersion,
    /// Bytes of the bank are damaged, the checksum of the upload is right.
    Damaged,
    /// A number of the bank is none, or infinite.
    StrangeNumber,
}

impl BadUpload {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Interrupted,
        Self::Reset,
        Self::WrongRobot,
        Self::WrongVersion,
        Self::Damaged,
        Self::StrangeNumber,
    ];

    /// What it is called in a report.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Interrupted => "interrupted uploads",
            Self::Reset => "reset in the middle of an upload",
            Self::WrongRobot => "banks of another robot",
            Self::WrongVersion => "banks of another version",
            Self::Damaged => "damaged banks",
            Self::StrangeNumber => "banks with NaN and infinite numbers",
        }
    }
}

/// `times` uploads that fail, between sound ones. The reference gets the sound ones only: a set is lost when the bank in
/// force is another one afterwards.
pub fn bad_uploads(
    transport: Box<dyn Transport>,
    bad: BadUpload,
    times: u32,
    seed: u64,
) -> Result<Campaign, BoardError> {
    let mut campaign = Campaign::new(bad.name(), &transport.name());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut host = Host::new(transport, false)?;
    for number in 1..=times {
        let good = set(number);
        let frames = upload(&mut host, &good, good.len(), true);
        for frame in frames {
            host.rig.send(&frame.bytes)?;
        }
        let accepted = spoilt_upload(&mut host, bad, number, &mut random)?;
        // A bank that is read back is compared piece by piece with the reference's.
        let wrong = host.rig.wrong_torques;
        for offset in (0..good.len()).step_by(CHUNK) {
            host.rig.ask(&HostMessage::BankRead {
                source: BankSource::Live,
                offset: offset as u16,
            })?;
        }
        let lost = accepted || host.rig.wrong_torques > wrong;
        campaign.lost_sets += u64::from(lost);
        campaign.injected += 1;
        let mut worked = false;
        for _ in 0..4 * ARM_EVERY {
            host.work()?;
            worked |= host.rig.state == SafetyState::Armed;
        }
        campaign.recovered += u64::from(worked);
        host.rest()?;
    }
    Ok(host.close(campaign, true))
}

/// The frames of an upload of the first `length` bytes of `bank`, with the commit of all of it.
fn upload(host: &mut Host, bank: &[u8], length: usize, referred: bool) -> Vec<Frame> {
    let mut frame = |message: HostMessage<JOINTS>| match referred {
        true => host.rig.frame(&message),
        false => host.rig.vain_frame(&message),
    };
    let pieces = bank.get(..length).unwrap_or(bank).chunks(CHUNK).enumerate();
    let mut frames: Vec<Frame> = pieces
        .map(|(place, piece)| {
            frame(HostMessage::BankWrite {
                offset: (place * CHUNK) as u16,
                bytes: piece.iter().copied().collect(),
            })
        })
        .collect();
    frames.push(frame(HostMessage::BankCommit {
        length: bank.len() as u16,
        crc: crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bank),
        mac: None,
    }));
    frames
}

/// Uploads what must not be taken over. True when the board took it.
fn spoilt_upload(
    host: &mut Host,
    bad: BadUpload,
    number: u32,
    random: &mut ChaCha8Rng,
) -> Result<bool, BoardError> {
    let bank = spoilt_bank(bad, number, random);
    let cut = matches!(bad, BadUpload::Interrupted | BadUpload::Reset);
    let length = if cut {
        random.random_range(0..bank.len())
    } else {
        bank.len()
    };
    let mut frames = upload(host, &bank, length, false);
    let committed = bad != BadUpload::Interrupted || random.random();
    if !committed {
        frames.pop();
    }
    if bad == BadUpload::Reset {
        let reset = host.rig.frame(&HostMessage::Reset);
        frames.insert(frames.len() - 1, reset);
    }
    let mut answer = None;
    for frame in &frames {
        answer = host.rig.send(&frame.bytes)?.answers.pop();
    }
    // The answer to the last frame: a commit must not be acknowledged, and without one nothing must be in force.
    Ok(committed && answer == Some(BoardMessage::Ack))
}

/// A bank that no board for this robot may take over; or a good one, where the upload is what fails.
fn spoilt_bank(bad: BadUpload, number: u32, random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = set(1000 + number);
    let Ok(mut bank) = ParameterBank::decode(&bytes) else {
        return bytes;
    };
    match bad {
        BadUpload::WrongRobot => bank.arm_hash ^= 1 << random.random_range(0..32),
        BadUpload::StrangeNumber => {
            let value = *[f32::NAN, f32::INFINITY, f32::NEG_INFINITY]
                .choose(random)
                .unwrap_or(&f32::NAN);
            let (column, weight) = (
                random.random_range(0..bank.columns.len()),
                random.random_range(0..bank.weights.len()),
            );
            match random.random_range(0..4) {
                0 => bank.columns[column].value = value,
                1 => bank.columns[column].deviation = value,
                2 => bank.weights[weight] = value,
                _ => bank.drive_gains_nm_a[random.random_range(0..JOINTS)] = value,
            }
        }
        BadUpload::WrongVersion => {
            bytes[4] = ParameterBank::FORMAT_VERSION.wrapping_add(random.random_range(1..=255));
            return bytes;
        }
        BadUpload::Damaged => {
            let place = random.random_range(0..bytes.len());
            bytes[place] ^= random.random_range(1..=255u8);
            return bytes;
        }
        BadUpload::Interrupted | BadUpload::Reset => return bytes,
    }
    let mut room = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut room).map_or(bytes, <[u8]>::to_vec)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Native;
    use foretorque::arm::ur5::{PARAMETERS, Ur5};

    fn host() -> Host {
        let native = Native::<Ur5, JOINTS, PARAMETERS>::new().unwrap();
        let mut host = Host::new(Box::new(native), false).unwrap();
        assert!(host.come_back().unwrap());
        assert_eq!(host.rig.wrong_torques, 0);
        host
    }

    #[test]
    fn a_torque_that_the_reference_does_not_give_is_wrong() {
        let mut host = host();
        // A sample of which the reference never hears moves the slew of the board alone.
        let mut sample = host.sample();
        sample.desired.qdd = JointVector::repeat(5.0);
        let message = HostMessage::Sample(SampleFrame::new(&sample));
        let frame = host.rig.vain_frame(&message);
        host.rig.send(&frame.bytes).unwrap();
        host.work().unwrap();
        assert!(host.rig.wrong_torques > 0);
    }

    #[test]
    fn an_answer_to_a_question_that_was_not_asked_is_wrong() {
        let mut host = host();
        let message = HostMessage::Sample(SampleFrame::new(&host.sample()));
        let mut room = [0; MAX_FRAME];
        let forged = encode(host.rig.frame(&message).sequence + 9, &message, &mut room).unwrap();
        let forged = forged.to_vec();
        host.rig.send(&forged).unwrap();
        assert!(host.rig.wrong_torques > 0);
    }

    #[test]
    fn a_bank_that_is_taken_although_it_must_not_be_is_a_lost_set() {
        let mut host = host();
        host.rest().unwrap();
        let bank = set(5);
        let frames = upload(&mut host, &bank, bank.len(), false);
        for frame in frames {
            host.rig.send(&frame.bytes).unwrap();
        }
        let offset = HostMessage::BankRead {
            source: BankSource::Live,
            offset: 0,
        };
        host.rig.ask(&offset).unwrap();
        assert!(
            host.rig.wrong_torques > 0,
            "the bank differs from the reference's"
        );
    }
}
