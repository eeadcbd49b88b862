//! One simulated drive: frames in, torque and frames out; and faults of the drives and their bus.

use foretorque_link::drives::{
    ControlMode, DriveProfile, DriveState, Frame, Frames, JointCommand, JointReply, Order,
    Protocol, Request, Scale,
};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;
use std::ops::Range;

/// Period of the drive's own loop, s.
pub(super) const DRIVE_PERIOD_S: f64 = 1e-4;
/// Bandwidth of the speed in the drive's own loop and of its reported torque, Hz.
const BANDWIDTH_HZ: f64 = 400.0;
/// Fault code of a drive that no frame reaches any more: Damiao's.
const COMMUNICATION_LOST: u32 = 0xd;

/// Properties of a drive that no frame shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveTruth {
    /// The drive as it is configured and mounted.
    pub profile: DriveProfile,
    /// Bus that it is wired to, from 0.
    pub bus: u8,
    /// Time without a command after which it switches itself off, s.
    pub watchdog_s: f64,
    /// Torque that it makes over the torque that it is asked for and reports.
    pub gain: f64,
    /// Standard deviation of the reported torque, N·m.
    pub noise_nm: f64,
    /// Stiffness, N·m/rad, and damping, N·m·s/rad, at the joint, where its frames carry none.
    pub own_gains: (f64, f64),
}

/// Drive with proportional and derivative action of its own.
#[derive(Clone, Debug)]
pub struct SimulatedDrive {
    /// Properties that no frame shows.
    pub truth: DriveTruth,
    /// State that it reports.
    pub state: DriveState,
    command: JointCommand,
    silent_s: f64,
    previous: Option<f64>,
    speed: f64,
    reported: f64,
}

impl SimulatedDrive {
    /// A drive that is switched off.
    pub fn new(truth: DriveTruth) -> Self {
        Self {
            truth,
            state: switched_off(&truth.profile),
            command: JointCommand::default(),
            silent_s: 0.0,
            previous: None,
            speed: 0.0,
            reported: 0.0,
        }
    }

    /// Feed-forward that it has taken from its last command, N·m at the joint; 0 while it is off.
    pub fn feed_forward(&self) -> f64 {
        match self.state {
            DriveState::Enabled => f64::from(self.command.torque),
            _ => 0.0,
        }
    }

    /// Stiffness and damping in force, N·m/rad and N·m·s/rad.
    pub fn gains(&self) -> (f64, f64) {
        match self.truth.profile.carries_gains() {
            true => (self.command.kp.into(), self.command.kd.into()),
            false => self.truth.own_gains,
        }
    }

    /// The frames have a position and no speed: the drive takes it from one target to the next (CiA 402-2, cyclic
    /// synchronous position).
    fn derives_speed(&self) -> bool {
        let protocol = self.truth.profile.protocol;
        matches!(protocol, Protocol::Cia402(cia402) if cia402.mode == ControlMode::Position)
    }

    /// One period of its own loop at position `q`, rad: the torque, N·m at the joint.
    pub(super) fn step(&mut self, q: f64) -> f64 {
        let blend = TAU * BANDWIDTH_HZ * DRIVE_PERIOD_S;
        let blend = blend / (1.0 + blend);
        let difference = (q - self.previous.replace(q).unwrap_or(q)) / DRIVE_PERIOD_S;
        self.speed += (difference - self.speed) * blend;
        self.silent_s += DRIVE_PERIOD_S;
        if self.state == DriveState::Enabled && self.silent_s > self.truth.watchdog_s {
            self.state = DriveState::Fault(COMMUNICATION_LOST);
        }
        let wanted = if self.state == DriveState::Enabled {
            let (command, (kp, kd)) = (&self.command, self.gains());
            kp * (f64::from(command.position) - q)
                + kd * (f64::from(command.velocity) - self.speed)
                + f64::from(command.torque)
        } else {
            0.0
        };
        let most = f64::from(self.truth.profile.largest_torque());
        let asked = wanted.clamp(-most, most);
        self.reported += (asked - self.reported) * blend;
        asked * self.truth.gain
    }

    /// Takes a frame from the bus; frames of its answer.
    pub(super) fn take(&mut self, frame: &Frame, q: f64, random: &mut ChaCha8Rng) -> Frames {
        let mut answer = Frames::new();
        let Some(request) = self.truth.profile.accept(frame) else {
            return answer;
        };
        match request {
            Request::Command(mut command) => {
                let elapsed_s = std::mem::take(&mut self.silent_s);
                if self.state == DriveState::Enabled && self.derives_speed() && elapsed_s > 0.0 {
                    let step = f64::from(command.position - self.command.position);
                    command.velocity = (step / elapsed_s) as f32;
                }
                if self.state == DriveState::SwitchedOn {
                    self.state = DriveState::Enabled;
                }
                // A drive that is off takes no command: the position of a later one must not wait here.
                self.command = match self.state {
                    DriveState::Enabled => command,
                    _ => JointCommand::default(),
                };
            }
            Request::Order(Order::Enable) => {
                self.silent_s = 0.0;
                if self.state == DriveState::Disabled {
                    self.command = JointCommand::default();
                    self.state = match self.truth.profile.protocol {
                        Protocol::Cia402(_) => DriveState::SwitchedOn,
                        _ => DriveState::Enabled,
                    };
                }
            }
            Request::Order(Order::Disable) => match self.state {
                DriveState::Fault(_) => {}
                _ => self.state = DriveState::Disabled,
            },
            Request::Order(Order::ClearFault) => self.state = switched_off(&self.truth.profile),
            Request::Order(Order::ReadScale(scale)) => {
                if let Some(value) = scale_of(&self.truth.profile, scale) {
                    self.truth.profile.reply_scale(scale, value, &mut answer);
                }
                return answer;
            }
            Request::Order(Order::Report | Order::SetZero) => {}
        }
        if !self.truth.profile.answers(frame) {
            return answer;
        }
        let noise: f64 = random.sample(StandardNormal);
        let reply = JointReply {
            position: Some(q as f32),
            velocity: Some(self.speed as f32),
            torque: Some((self.reported + noise * self.truth.noise_nm) as f32),
            temperature: Some(30.0),
            state: Some(self.state),
        };
        self.truth.profile.reply(&reply, &mut answer);
        answer
    }
}

/// State of a drive that has no order yet.
fn switched_off(profile: &DriveProfile) -> DriveState {
    match profile.protocol {
        Protocol::Cia402(_) => DriveState::NotReady,
        _ => DriveState::Disabled,
    }
}

/// Scale of a drive in the unit in which it reports it.
fn scale_of(profile: &DriveProfile, scale: Scale) -> Option<f32> {
    match profile.protocol {
        Protocol::MiniCheetah(ranges)
        | Protocol::Damiao(ranges)
        | Protocol::CyberGear(ranges)
        | Protocol::RobStride(ranges) => Some(match scale {
            Scale::Position => ranges.position,
            Scale::Velocity => ranges.velocity,
            Scale::Torque => ranges.torque,
        }),
        Protocol::Odrive(odrive) => Some(odrive.torque_scale),
        Protocol::Cia402(cia402) => Some(cia402.rated_torque),
        _ => None,
    }
}

/// One kind of fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineFault {
    /// Share of commands that do not reach the drive of a joint.
    LostCommands(usize, f64),
    /// Share of replies of a joint that do not reach the host.
    LostReplies(usize, f64),
    /// Replies of a joint come this many replies late.
    LateReplies(usize, usize),
    /// Commands of a joint arrive twice.
    DoubledCommands(usize),
    /// Replies of a joint arrive twice.
    DoubledReplies(usize),
    /// The drive of a joint repeats one reply.
    StuckReply(usize),
    /// The drive of a joint sends the first byte of the reply of another: its identifier.
    WrongIdentifier(usize, u8),
    /// A share of the replies of a joint has one wrong bit, not found by the checksum.
    FlippedBits(usize, f64),
    /// The drive of a joint is dead: it takes and sends nothing.
    Dead(usize),
    /// The drive of a joint starts over at the begin.
    Reset(usize),
    /// The drive of a joint has a fault with this code at the begin.
    DriveFault(usize, u32),
    /// No frame passes a bus.
    BusOff(usize),
    /// A foreign node on a bus sends this identifier all the time, ahead of everybody.
    Babble(usize, u32),
    /// A bus runs at this share of its rate.
    Overload(usize, f64),
    /// The user interrupts at the begin.
    Interrupt,
}

/// A fault with its time, s, and the frames that it holds.
#[derive(Clone, Debug, Default)]
pub struct TimedFault {
    fault: Option<(LineFault, Range<f64>)>,
    late: std::collections::VecDeque<Frame>,
    stuck: Option<Frame>,
}

impl TimedFault {
    /// A fault in force in `time_s`, s.
    pub fn new(fault: LineFault, time_s: Range<f64>) -> Self {
        Self {
            fault: Some((fault, time_s)),
            ..Self::default()
        }
    }

    /// The fault, if it is in force.
    pub(super) fn active(&self, now_s: f64) -> Option<LineFault> {
        let (fault, time_s) = self.fault.as_ref()?;
        time_s.contains(&now_s).then_some(*fault)
    }

    /// The fault, if it begins in the step.
    pub(super) fn beginning(&self, now_s: f64, step_s: f64) -> Option<LineFault> {
        let (fault, time_s) = self.fault.as_ref()?;
        let begins = (time_s.start..time_s.start + step_s).contains(&now_s);
        begins.then_some(*fault)
    }

    /// Frames that arrive at the host in the place of `frame`.
    pub(super) fn reply(
        &mut self,
        joint: usize,
        mut frame: Frame,
        now_s: f64,
        random: &mut ChaCha8Rng,
    ) -> Vec<Frame> {
        match self.active(now_s) {
            Some(LineFault::LostReplies(of, share)) if of == joint => {
                let arrives = !random.random_bool(share);
                return vec![frame; usize::from(arrives)];
            }
            Some(LineFault::DoubledReplies(of)) if of == joint => return vec![frame; 2],
            Some(LineFault::StuckReply(of)) if of == joint => {
                frame = *self.stuck.get_or_insert(frame);
            }
            Some(LineFault::WrongIdentifier(of, byte)) if of == joint => {
                if let Some(first) = frame.bytes_mut().first_mut() {
                    *first = *first & 0xf0 | byte;
                }
            }
            Some(LineFault::FlippedBits(of, share)) if of == joint && random.random_bool(share) => {
                // Position or torque: the first five bytes behind the identifier.
                let place = random.random_range(1..6);
                if let Some(byte) = frame.bytes_mut().get_mut(place) {
                    *byte ^= 1 << random.random_range(0..8);
                }
            }
            Some(LineFault::LateReplies(of, replies)) if of == joint => {
                self.late.push_back(frame);
                if self.late.len() <= replies {
                    return Vec::new();
                }
                frame = self.late.pop_front().unwrap_or(frame);
            }
            _ => {}
        }
        vec![frame]
    }
}
