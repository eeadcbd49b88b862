//! A bus of simulated drives around the simulated arm.
//!
//! Each drive has its own loop at 10 kHz behind its codec: quantised commands and replies, watchdog, limits and faults.
//! A bus carries one frame at a time; the reply of a drive follows its command. While every drive is off, the arm is
//! held by its brakes.

mod drive;

pub use drive::{DriveTruth, LineFault, SimulatedDrive, TimedFault};

use super::{Ask, BitRates, BusError, Network, frame_time_s};
use crate::dynamics::Joints;
use crate::plant::{Events, Payload, Plant, PlantConfig};
use drive::DRIVE_PERIOD_S;
use foretorque_link::bus::BusConfig;
use foretorque_link::drives::{DriveState, Frame};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::time::Duration;

/// Time without a command after which a simulated drive switches itself off, s.
const WATCHDOG_S: f64 = 0.05;

/// Frames of one bus on their way.
#[derive(Clone, Debug, Default)]
struct Line {
    /// Frames that wait: since when, s, and the drive that sends; `None` is the host.
    waiting: VecDeque<(f64, Option<usize>, Frame)>,
    free_s: f64,
}

/// Configuration of a plant around which drives run: its steps are theirs.
pub fn plant_config(config: PlantConfig) -> PlantConfig {
    PlantConfig {
        step_rate_hz: 1.0 / DRIVE_PERIOD_S,
        ..config
    }
}

/// Drives of an arm on simulated buses.
pub struct SimulatedNetwork<const N: usize> {
    /// The arm.
    pub plant: Plant<N>,
    /// The drives, base to tool.
    pub drives: [SimulatedDrive; N],
    /// Fault of bus or drives.
    pub fault: TimedFault,
    /// Largest torque that each drive has made, N × N·m.
    pub peak_nm: Joints<N>,
    rates: BitRates,
    lines: [Line; 2],
    inbox: VecDeque<(u8, Frame)>,
    random: ChaCha8Rng,
    steps: u64,
    period_s: f64,
    /// Begin of the period that is waited for, s.
    due_s: f64,
    braked: bool,
    interrupted: bool,
}

impl<const N: usize> SimulatedNetwork<N> {
    /// Drives as `config` has them around `plant`, which integrates at the rate of the drives.
    ///
    /// * `noise_nm` standard deviation of the reported torques, N × N·m
    pub fn new(
        plant: Plant<N>,
        config: &BusConfig<N>,
        rates: BitRates,
        noise_nm: &Joints<N>,
        seed: u64,
    ) -> Self {
        let mut noise = noise_nm.iter();
        let drives = config.joints.map(|joint| {
            SimulatedDrive::new(DriveTruth {
                profile: joint.drive,
                bus: joint.bus,
                watchdog_s: WATCHDOG_S,
                gain: 1.0,
                noise_nm: noise.next().copied().unwrap_or_default(),
                own_gains: (joint.kp.into(), joint.kd.into()),
            })
        });
        Self {
            plant,
            drives,
            fault: TimedFault::default(),
            peak_nm: Joints::zeros(),
            rates,
            lines: Default::default(),
            inbox: VecDeque::new(),
            random: ChaCha8Rng::seed_from_u64(seed),
            steps: 0,
            period_s: f64::from(config.period_s),
            due_s: 0.0,
            braked: true,
            interrupted: false,
        }
    }

    /// Time since the start, s.
    pub fn t_s(&self) -> f64 {
        self.steps as f64 * DRIVE_PERIOD_S
    }

    /// Feed-forward that each drive has in force, N × N·m.
    pub fn feed_forward(&self) -> Joints<N> {
        Joints::from_fn(|j, _| self.drives[j].feed_forward())
    }

    /// Every drive is switched off.
    pub fn all_off(&self) -> bool {
        let mut drives = self.drives.iter();
        drives.all(|drive| drive.state != DriveState::Enabled)
    }

    /// One period of the drives.
    fn step(&mut self) {
        let t_s = self.t_s();
        match self.fault.beginning(t_s, DRIVE_PERIOD_S) {
            Some(LineFault::Reset(j)) => {
                self.drives[j] = SimulatedDrive::new(self.drives[j].truth);
            }
            Some(LineFault::DriveFault(j, code)) => self.drives[j].state = DriveState::Fault(code),
            Some(LineFault::Interrupt) => self.interrupted = true,
            _ => {}
        }
        let q = *self.plant.q();
        let tau = Joints::from_fn(|j, _| self.drives[j].step(q[j]));
        self.peak_nm = self.peak_nm.zip_map(&tau, |peak, tau| peak.max(tau.abs()));
        // Brakes open with the first drive that is to do something, and close when all are off.
        let acts = |drive: &SimulatedDrive| {
            let (kp, kd) = drive.gains();
            let step = f64::from(drive.truth.profile.torque_resolution());
            drive.state == DriveState::Enabled
                && kp + kd + (drive.feed_forward().abs() - step).max(0.0) > 0.0
        };
        if self.braked {
            self.braked = !self.drives.iter().any(acts);
        } else if self.all_off() {
            self.plant.place(&q);
            self.braked = true;
        }
        if !self.braked {
            self.plant.advance(&tau, DRIVE_PERIOD_S);
        }
        self.steps += 1;
        for bus in 0..self.lines.len() {
            self.carry(bus);
        }
    }

    /// Carries the frames of a bus whose time has come.
    fn carry(&mut self, bus: usize) {
        let (now_s, mut rates) = (self.t_s(), self.rates);
        match self.fault.active(now_s) {
            Some(LineFault::Babble(on, id)) if on == bus => {
                let frame = Frame::standard(id, &[0; 8]);
                self.lines[bus].waiting.push_front((now_s, None, frame));
            }
            Some(LineFault::Overload(on, share)) if on == bus => rates.nominal *= share,
            _ => {}
        }
        while let Some(&(since_s, sender, frame)) = self.lines[bus].waiting.front() {
            let end_s = self.lines[bus].free_s.max(since_s) + frame_time_s(&frame, &rates);
            if end_s > now_s {
                break;
            }
            self.lines[bus].free_s = end_s;
            self.lines[bus].waiting.pop_front();
            match sender {
                None => self.reach_drives(bus, &frame, end_s),
                Some(joint) => self.reach_host(bus, joint, frame),
            }
        }
    }

    /// A frame whose last bit was sent at `end_s`; the answers begin then.
    fn reach_drives(&mut self, bus: usize, frame: &Frame, end_s: f64) {
        if self.bus_is_off(bus) {
            return;
        }
        let (q, now_s) = (*self.plant.q(), self.t_s());
        let fault = self.fault.active(now_s);
        for j in 0..N {
            if usize::from(self.drives[j].truth.bus) != bus {
                continue;
            }
            let copies = match fault {
                Some(LineFault::Dead(of)) if of == j => 0,
                Some(LineFault::LostCommands(of, share)) if of == j => {
                    usize::from(!self.random.random_bool(share))
                }
                Some(LineFault::DoubledCommands(of)) if of == j => 2,
                _ => 1,
            };
            for _ in 0..copies {
                let answer = self.drives[j].take(frame, q[j], &mut self.random);
                for reply in answer.into_iter().rev() {
                    self.lines[bus].waiting.push_front((end_s, Some(j), reply));
                }
            }
        }
    }

    fn reach_host(&mut self, bus: usize, joint: usize, frame: Frame) {
        if self.bus_is_off(bus) {
            return;
        }
        let now_s = self.t_s();
        let arrived = self.fault.reply(joint, frame, now_s, &mut self.random);
        let arrived = arrived.into_iter().map(|frame| (bus as u8, frame));
        self.inbox.extend(arrived);
    }

    fn bus_is_off(&self, bus: usize) -> bool {
        self.fault.active(self.t_s()) == Some(LineFault::BusOff(bus))
    }
}

impl<const N: usize> Network for SimulatedNetwork<N> {
    fn name(&self) -> String {
        "sim".into()
    }

    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError> {
        let now_s = self.t_s();
        if let Some(line) = self.lines.get_mut(usize::from(bus)) {
            // A controller that cannot send keeps the newest frames of a few periods.
            if line.waiting.len() >= 64 {
                line.waiting.pop_front();
            }
            line.waiting.push_back((now_s, None, *frame));
        }
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError> {
        match std::mem::take(&mut self.interrupted) {
            true => Err(BusError::Interrupted(self.steps as u32)),
            false => Ok(self.inbox.pop_front()),
        }
    }

    fn wait(&mut self) -> Duration {
        // Half a step of the drives early or late, and none of it for good.
        self.due_s += self.period_s;
        while self.t_s() + 0.5 * DRIVE_PERIOD_S < self.due_s {
            self.step();
        }
        Duration::ZERO
    }

    fn is_off(&self) -> bool {
        (0..self.lines.len()).any(|bus| self.bus_is_off(bus))
    }

    fn ask(&mut self, ask: &Ask) -> Result<(), BusError> {
        let mut q = *self.plant.q();
        match ask {
            Ask::Pose(pose) => q.iter_mut().zip(pose).for_each(|(q, pose)| *q = *pose),
            Ask::Turn { joint, by_rad } => q[*joint] += by_rad,
            Ask::Weight(body) => {
                let held = body.map(|body| Payload {
                    body,
                    from_s: 0.0,
                    to_s: f64::INFINITY,
                });
                let events = Events {
                    payloads: held.into_iter().collect(),
                    ..Events::default()
                };
                self.plant = self.plant.clone().with_events(events);
            }
            Ask::Undetermined { .. } | Ask::Clear => return Ok(()),
        }
        self.plant.place(&q);
        self.braked = true;
        Ok(())
    }
}
