//! Commissioning: what the profile states of the drives, checked on the arm step by step.
//!
//! Every check is one that the drives cannot pass by being wrong in the same way in both directions: positions against
//! turns by hand, torques against the acceleration of the described arm. The torque rises in steps to a tenth of the limit.

use super::{BusError, BusPlayer, Network};
use crate::closed_loop::motion_f32;
use crate::dynamics::{Joints, ReferenceModel, State};
use foretorque::arm::Arm;
use foretorque::joint::JointMotion;
use foretorque_link::drives::{Carry, DriveState, Event, Frames, JointCommand, Order};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Angle by which each joint is turned by hand, rad.
const TURN_RAD: f64 = 0.5;
/// Largest relative error of a turn by hand.
const TURN_ERROR: f64 = 0.3;
/// Largest distance from the pose of rest, rad.
const ZERO_RAD: f64 = 0.1;
/// Largest torque of gravity in the pose of rest, part of the limit.
const RESTING: f64 = 0.03;
/// Torques of the probe, parts of the limit, in the order in which they are tried. The last is the largest.
const LEVELS: [f64; 7] = [0.005, 0.0085, 0.02, 0.035, 0.05, 0.07, 0.095];
/// Longest push, s, and the travel that ends it, rad.
const PUSH: (f64, f64) = (0.4, 0.04);
/// Smallest travel that is motion, rad.
const MOVED_RAD: f64 = 0.01;
/// Ratios of the torque that arrives to the commanded one that pass.
const RATIOS: std::ops::Range<f64> = 0.5..2.0;
/// Half the angle of a friction sweep, rad, and its speed, rad/s.
const SWEEP_RAD: f64 = 0.15;
const SWEEP_RAD_S: f64 = 0.15;
/// Identifiers that are tried when a drive does not answer.
const IDS: std::ops::RangeInclusive<u16> = 1..=32;

/// Request to whoever stands beside the arm. The drives are off meanwhile.
#[derive(Clone, Debug, PartialEq)]
pub enum Ask {
    /// Put the arm into this pose, rad.
    Pose(Vec<f64>),
    /// Turn a joint, from 0, in its positive direction by this angle, rad.
    Turn {
        /// Joint, from 0.
        joint: usize,
        /// Angle, rad.
        by_rad: f64,
    },
}

/// Somebody who can move the arm.
pub trait Operator {
    /// Returns when it is done.
    ///
    /// Errors: nobody is there.
    fn ask(&mut self, ask: &Ask) -> Result<(), BusError>;
}

/// Step of commissioning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Every drive answers, and reports no fault and the scales of its profile.
    Find,
    /// Each joint turned by hand: identifier, sign, gear.
    Turn,
    /// Pose of rest: zeros.
    Zero,
    /// Torque of each joint, up to a tenth: sign and scale.
    Torque,
    /// Slow sweep of each joint in the loop, both ways: friction. The torque is that of the loop from here on.
    Friction,
}

impl Step {
    /// All steps, in their order.
    pub const ALL: [Self; 5] = [
        Self::Find,
        Self::Turn,
        Self::Zero,
        Self::Torque,
        Self::Friction,
    ];
    /// Number of the first steps, in which no torque exceeds a tenth of its limit.
    pub const BELOW_A_TENTH: usize = 4;
}

/// Findings of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Found {
    /// Turn that the drive reports over the turn by hand.
    pub turn_ratio: Option<f64>,
    /// Position in the pose of rest beyond the profile's, rad.
    pub zero_error_rad: Option<f64>,
    /// Torque at which the joint moves, N·m.
    pub breakaway_nm: Option<f64>,
    /// Torque that arrives, by the acceleration of the described arm, over the commanded one.
    pub torque_ratio: Option<f64>,
    /// Friction in a slow sweep, half the difference of both ways, N·m.
    pub friction_nm: Option<f64>,
}

/// Arm that is being commissioned.
pub struct Commissioning<A: Arm<N, P>, W: Network + Operator, const N: usize, const P: usize> {
    /// Loop and bus.
    pub player: BusPlayer<A, W, N, P>,
    /// Findings so far.
    pub found: [Found; N],
    model: ReferenceModel<N>,
    rest: Joints<N>,
}

fn mistake(joint: usize, mistake: String) -> BusError {
    BusError::Mistake { joint, mistake }
}

impl<A: Arm<N, P>, W: Network + Operator, const N: usize, const P: usize>
    Commissioning<A, W, N, P>
{
    /// An arm whose drives are off.
    ///
    /// * `rest` pose in which it rests without torque, rad
    pub fn new(player: BusPlayer<A, W, N, P>, model: ReferenceModel<N>, rest: Joints<N>) -> Self {
        Self {
            player,
            found: [Found::default(); N],
            model,
            rest,
        }
    }

    /// Executes a step; it may be repeated.
    ///
    /// Errors: the mistake that it finds, with joint, field and both values; a bus that has gone.
    pub fn step(&mut self, step: Step) -> Result<(), BusError> {
        match step {
            Step::Find => self.find(),
            Step::Turn => (0..N).try_for_each(|joint| self.turn(joint)),
            Step::Zero => self.zero(),
            Step::Torque => {
                self.zero()?;
                let outcome = (0..N).try_for_each(|joint| self.torque(joint));
                self.switch_off()?;
                outcome
            }
            Step::Friction => self.friction(),
        }
    }

    /// Lets the drives answer for a while; positions, rad.
    fn listen(&mut self) -> Result<Joints<N>, BusError> {
        let ticks = (0.1 / self.player.period_s()) as usize;
        for _ in 0..ticks {
            self.player.tick(None)?;
        }
        Ok(self.player.positions().cast())
    }

    fn find(&mut self) -> Result<(), BusError> {
        let gravity = self.model.gravity_torques(&self.rest);
        for joint in 0..N {
            let most = RESTING * f64::from(A::limits()[joint].torque);
            if gravity[joint].abs() > most {
                let (rest, gravity) = (self.rest[joint], gravity[joint]);
                return Err(mistake(
                    joint,
                    format!(
                        "rest_rad {rest}: gravity is {gravity:.2} N·m there, more than {most:.2} N·m"
                    ),
                ));
            }
        }
        self.listen()?;
        for joint in 0..N {
            let counters = self.player.controller.counters(joint);
            let config = self.player.controller.config().joints[joint];
            if counters.replies == 0 {
                let (id, bus) = (config.drive.id, config.bus);
                let answering = self.scan(joint)?;
                let list: Vec<String> = answering
                    .iter()
                    .map(|(bus, id)| format!("{id} on bus {bus}"))
                    .collect();
                let list = if list.is_empty() {
                    "none".to_owned()
                } else {
                    list.join(", ")
                };
                return Err(mistake(
                    joint,
                    format!("no drive answers at id {id} on bus {bus}; ids that answer: {list}"),
                ));
            }
            if counters.doubled > counters.replies / 4 {
                let id = config.drive.id;
                return Err(mistake(joint, format!("two drives answer at id {id}")));
            }
        }
        self.player.controller.ready().map_err(BusError::Fault)
    }

    /// Identifiers of the drives of a joint's kind that answer, with their buses.
    fn scan(&mut self, joint: usize) -> Result<Vec<(u8, u16)>, BusError> {
        let config = self.player.controller.config().joints;
        let mut found = Vec::new();
        for bus in 0..=config
            .iter()
            .map(|joint| joint.bus)
            .max()
            .unwrap_or_default()
        {
            for id in IDS {
                let mut drive = config[joint].drive;
                drive.id = id;
                // Replies go to the host's identifier, which may be configured with the drive's own.
                let hosts = config
                    .iter()
                    .map(|joint| joint.drive.host_id)
                    .chain([0, id | 0x10]);
                let hosts: Vec<u16> = hosts.collect();
                let mut frames = Frames::new();
                drive.order(Order::Disable, &mut frames);
                for frame in &frames {
                    self.player.network.send(bus, frame)?;
                }
                self.player.network.wait();
                self.player.network.wait();
                while let Some((from, frame)) = self.player.network.receive()? {
                    let answers = hosts.iter().any(|host| {
                        drive.host_id = *host;
                        drive.decode(&frame).is_some()
                    });
                    if answers && !found.contains(&(from, id)) {
                        found.push((from, id));
                    }
                }
            }
        }
        Ok(found)
    }

    fn turn(&mut self, joint: usize) -> Result<(), BusError> {
        let before = self.listen()?;
        self.player.network.ask(&Ask::Turn {
            joint,
            by_rad: TURN_RAD,
        })?;
        let change = self.listen()? - before;
        self.player.network.ask(&Ask::Turn {
            joint,
            by_rad: -TURN_RAD,
        })?;
        let ratio = change[joint] / TURN_RAD;
        let moved = (0..N).max_by(|a, b| change[*a].abs().total_cmp(&change[*b].abs()));
        let moved = moved.unwrap_or(joint);
        let drive = self.player.controller.config().joints[joint].drive;
        if change[moved].abs() < 0.02 {
            return Err(mistake(
                joint,
                format!("its position stays when it is turned by {TURN_RAD} rad"),
            ));
        }
        if moved != joint {
            let (id, other) = (drive.id, moved + 1);
            return Err(mistake(
                joint,
                format!(
                    "id {id} is not its drive: turning it moves the position of joint {other}; are ids swapped?"
                ),
            ));
        }
        if ratio < 0.0 && (-ratio - 1.0).abs() < TURN_ERROR {
            let sign = drive.sign;
            return Err(mistake(
                joint,
                format!(
                    "sign {sign}: a positive turn is reported as negative, sign must be {}",
                    -sign
                ),
            ));
        }
        if (ratio - 1.0).abs() > TURN_ERROR {
            let (gear, is) = (f64::from(drive.gear), f64::from(drive.gear) * ratio.abs());
            return Err(mistake(
                joint,
                format!(
                    "gear {gear}: a turn of {TURN_RAD} rad is reported as {:.3} rad, gear is about {is:.3}",
                    change[joint]
                ),
            ));
        }
        self.found[joint].turn_ratio = Some(ratio);
        Ok(())
    }

    fn zero(&mut self) -> Result<(), BusError> {
        let pose = self.rest.iter().copied().collect();
        self.player.network.ask(&Ask::Pose(pose))?;
        let here = self.listen()?;
        for joint in 0..N {
            let error = here[joint] - self.rest[joint];
            if error.abs() > ZERO_RAD {
                let zero = f64::from(self.player.controller.config().joints[joint].drive.zero);
                return Err(mistake(
                    joint,
                    format!(
                        "zero {zero}: {:.3} rad are reported in the pose of rest of {:.3} rad, zero is about {:.3}",
                        here[joint],
                        self.rest[joint],
                        zero - error
                    ),
                ));
            }
            self.found[joint].zero_error_rad = Some(error);
        }
        Ok(())
    }

    /// Pushes a joint with rising torques until it moves, then compares push and coasting with its inertia.
    fn torque(&mut self, joint: usize) -> Result<(), BusError> {
        let limit = f64::from(A::limits()[joint].torque);
        let inertia = self.model.mass_matrix(&self.rest)[(joint, joint)];
        self.settle(joint, 0.1)?;
        for level in LEVELS {
            let push_nm = level * limit;
            let pushed = self.run(joint, push_nm, PUSH)?;
            let travel = travel(&pushed);
            if travel.abs() < MOVED_RAD {
                self.settle(joint, 0.05)?;
                continue;
            }
            let coasted = self.run(joint, 0.0, (0.1, f64::INFINITY))?;
            self.settle(joint, 0.3)?;
            if travel < 0.0 {
                return Err(mistake(
                    joint,
                    format!("torque sign: +{push_nm:.2} N·m move it by {travel:.3} rad"),
                ));
            }
            self.found[joint].breakaway_nm = Some(push_nm);
            let moving = |(one, later): &(&(f64, f64), &(f64, f64))| {
                (later.1 - one.1) / (later.0 - one.0) > 0.05
            };
            let pairs = coasted.iter().zip(coasted.iter().skip(4));
            let moving = pairs.take_while(moving);
            let coasted: Vec<(f64, f64)> = moving.map(|(one, _)| *one).collect();
            let slowing = if coasted.len() >= 8 {
                acceleration(&coasted)
            } else {
                0.0
            };
            // The push starts when the joint breaks away.
            let start = pushed
                .iter()
                .position(|(_, q)| q - pushed[0].1 > 0.002)
                .unwrap_or(0);
            let ratio = inertia * (acceleration(&pushed[start..]) - slowing) / push_nm;
            self.found[joint].torque_ratio = Some(ratio);
            if !RATIOS.contains(&ratio) {
                let arrives = ratio * push_nm;
                return Err(mistake(
                    joint,
                    format!(
                        "scale of torque: of {push_nm:.2} N·m about {arrives:.2} N·m arrive, by its acceleration"
                    ),
                ));
            }
            return Ok(());
        }
        let most = LEVELS[LEVELS.len() - 1] * limit;
        Err(mistake(
            joint,
            format!(
                "scale of torque: no motion at {most:.2} N·m, a tenth of its limit; is it too small, or is the joint blocked?"
            ),
        ))
    }

    /// Sweeps each joint both ways in the loop and compares the torques with the described arm.
    fn friction(&mut self) -> Result<(), BusError> {
        self.player.arm()?;
        self.player.approach(&self.rest.clone())?;
        for joint in 0..N {
            let mut excess = [0.0; 2];
            for (way, excess) in [1.0, -1.0].into_iter().zip(&mut excess) {
                let mut start = self.rest;
                start[joint] -= way * SWEEP_RAD;
                self.player.approach(&start)?;
                let ticks = (2.0 * SWEEP_RAD / SWEEP_RAD_S / self.player.period_s()) as usize;
                let mut count = 0;
                for tick in 0..ticks {
                    let mut desired = State::rest(start);
                    let t_s = tick as f64 * self.player.period_s();
                    desired.q[joint] += way * SWEEP_RAD_S * t_s;
                    desired.qd[joint] = way * SWEEP_RAD_S;
                    let result = self.player.tick(Some(&motion_f32(&desired)))?;
                    self.player.check()?;
                    if let Some(measured) = result.measured.filter(|_| 2 * tick > ticks) {
                        let gravity = self.model.gravity_torques(&measured.q.cast())[joint];
                        *excess += f64::from(measured.tau[joint]) - gravity;
                        count += 1;
                    }
                }
                *excess /= f64::from(count.max(1));
            }
            self.found[joint].friction_nm = Some(0.5 * (excess[0] - excess[1]));
        }
        self.player.approach(&self.rest.clone())?;
        self.player.park().map(drop)
    }

    /// Holds the joints that have passed, damps this one, and waits.
    fn settle(&mut self, joint: usize, time_s: f64) -> Result<(), BusError> {
        self.run(joint, f64::NAN, (time_s, f64::INFINITY)).map(drop)
    }

    /// Sends a torque to one joint, N·m, while those before it are held and those behind it are off: times and positions.
    ///
    /// * `torque_nm` not a number: the joint is left without torque, and off where it has not passed
    /// * `until` longest time, s, and the travel that ends it, rad
    fn run(
        &mut self,
        joint: usize,
        torque_nm: f64,
        until: (f64, f64),
    ) -> Result<Vec<(f64, f64)>, BusError> {
        let period_s = self.player.period_s();
        let joints = self.player.controller.config().joints;
        let here = self.player.positions();
        let mut carries = [Carry::default(); N];
        let mut path: Vec<(f64, f64)> = Vec::new();
        let mut state = None;
        for tick in 0..(until.0 / period_s) as usize {
            self.player.network.wait();
            while let Some((bus, frame)) = self.player.network.receive()? {
                let of_joint = joints[joint]
                    .drive
                    .decode(&frame)
                    .filter(|_| bus == joints[joint].bus);
                if let Some(Event::Reply(reply)) = of_joint {
                    state = reply.state.or(state);
                    if let Some(q) = reply.position {
                        path.push((tick as f64 * period_s, f64::from(q)));
                    }
                }
                self.player.controller.receive(bus, &frame);
            }
            if let Some(DriveState::Fault(code)) = state {
                return Err(mistake(joint, format!("the drive reports fault {code:#x}")));
            }
            if travel(&path).abs() > until.1 {
                break;
            }
            for (index, entry) in joints.iter().enumerate().take(joint + 1) {
                let mut frames = Frames::new();
                let held = index < joint;
                if tick < 3 && torque_nm.is_nan() {
                    entry.drive.order(Order::Enable, &mut frames);
                } else {
                    let command = JointCommand {
                        position: here[index],
                        torque: if held || torque_nm.is_nan() {
                            0.0
                        } else {
                            torque_nm as f32
                        },
                        kp: if held { 0.1 * entry.kp } else { 0.0 },
                        kd: if held { 0.1 * entry.kd } else { 0.0 },
                        ..JointCommand::default()
                    };
                    entry
                        .drive
                        .command(&command, &mut carries[index], &mut frames);
                }
                for frame in &frames {
                    self.player.network.send(entry.bus, frame)?;
                }
            }
        }
        Ok(path)
    }

    /// Switches every drive off; the loop does so while it is off itself.
    fn switch_off(&mut self) -> Result<(), BusError> {
        for _ in 0..16 {
            self.player.tick(None::<&JointMotion<N>>)?;
        }
        Ok(())
    }
}

/// Travel from the first to the last position, rad.
fn travel(path: &[(f64, f64)]) -> f64 {
    path.first()
        .zip(path.last())
        .map_or(0.0, |(first, last)| last.1 - first.1)
}

/// Acceleration of times and positions by least squares, rad/s².
fn acceleration(path: &[(f64, f64)]) -> f64 {
    let (mut gram, mut moment) = (Matrix3::zeros(), Vector3::zeros());
    let start_s = path.first().map_or(0.0, |(t_s, _)| *t_s);
    for (t_s, q) in path {
        // In tenths of a second, so that the powers are alike.
        let x = 10.0 * (t_s - start_s);
        let powers = Vector3::new(1.0, x, x * x);
        gram += powers * powers.transpose();
        moment += powers * *q;
    }
    gram.cholesky()
        .map_or(0.0, |gram| 2.0 * 100.0 * gram.solve(&moment)[2])
}
