//! Steps of commissioning with torque: a push, slow sweeps in the loop, a known weight.

use super::{Ask, BusError, Commissioning, check};
use crate::bus::Network;
use crate::closed_loop::motion_f32;
use crate::dynamics::{Joints, State};
use crate::robot::Link;
use foretorque::arm::Arm;
use foretorque::joint::JointMotion;
use foretorque_link::drives::{Carry, DriveState, Event, Frames, JointCommand, Order};
use nalgebra::{Matrix3, Vector3};

/// Torques of the probe, parts of the limit, in the order in which they are tried. The last is the largest.
const LEVELS: [f64; 7] = [0.005, 0.0085, 0.02, 0.035, 0.05, 0.07, 0.095];
/// Longest push, s, and the travel that ends it, rad.
const PUSH: (f64, f64) = (0.4, 0.04);
/// Smallest travel that is motion, rad.
const MOVED_RAD: f64 = 0.01;
/// Ratios of the torque that arrives to the commanded one that pass.
const RATIOS: std::ops::Range<f64> = 0.5..2.0;
/// Half the angle of a slow sweep, rad, and its speed, rad/s.
const SWEEP_RAD: f64 = 0.15;
const SWEEP_RAD_S: f64 = 0.15;
/// Parts of a sweep: their spread is the deviation of its mean.
const BLOCKS: usize = 8;
/// Angle between the pose of rest and that in which a joint weighs, rad.
const TILT_RAD: f64 = 0.6;
/// Largest error of a gain that a data sheet explains.
const GAIN_ERROR: f64 = 0.2;

impl<A: Arm<N, P>, W: Network, const N: usize, const P: usize> Commissioning<A, W, N, P> {
    /// Pushes a joint with rising torques until it moves, then compares push and coasting with its inertia.
    pub(super) fn torque(&mut self, joint: usize) -> Result<(), BusError> {
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
            check(joint, travel >= 0.0, || {
                format!("torque sign: +{push_nm:.2} N·m move it by {travel:.3} rad")
            })?;
            self.found[joint].breakaway_nm = Some(push_nm);
            let moving = |(one, later): &(&(f64, f64), &(f64, f64))| {
                (later.1 - one.1) / (later.0 - one.0) > 0.05
            };
            let pairs = coasted.iter().zip(coasted.iter().skip(4));
            let moving = pairs.take_while(moving);
            let coasted: Vec<(f64, f64)> = moving.map(|(one, _)| *one).collect();
            let slowing = match coasted.len() {
                8.. => acceleration(&coasted),
                _ => 0.0,
            };
            // The push starts when the joint breaks away.
            let start = pushed.iter().position(|(_, q)| q - pushed[0].1 > 0.002);
            let start = start.unwrap_or(0);
            let ratio = inertia * (acceleration(&pushed[start..]) - slowing) / push_nm;
            self.found[joint].torque_ratio = Some(ratio);
            return check(joint, RATIOS.contains(&ratio), || {
                let arrives = ratio * push_nm;
                format!(
                    "scale of torque: of {push_nm:.2} N·m about {arrives:.2} N·m arrive, by its acceleration"
                )
            });
        }
        let most = LEVELS[LEVELS.len() - 1] * limit;
        let problem = format!(
            "scale of torque: no motion at {most:.2} N·m, a tenth of its limit; is it too small, or is the joint blocked?"
        );
        Err(BusError::Mistake(joint, problem))
    }

    /// Sweeps each joint both ways in the loop and compares the torques with the described arm.
    pub(super) fn friction(&mut self) -> Result<(), BusError> {
        let swept = self.sweeps(&[self.rest; N])?;
        for (found, [up, down]) in self.found.iter_mut().zip(swept) {
            let mean = |way: [f64; BLOCKS]| way.iter().sum::<f64>() / BLOCKS as f64;
            found.friction_nm = Some(0.5 * (mean(up) - mean(down)));
        }
        Ok(())
    }

    /// Weighs a known body with each joint, in the pose near rest where the joint feels it most.
    pub(super) fn weigh(&mut self, body: &Link) -> Result<(), BusError> {
        let loaded = self.model.with_payload(body);
        let lever = |q: &Joints<N>, joint: usize| {
            loaded.gravity_torques(q)[joint] - self.model.gravity_torques(q)[joint]
        };
        let poses: [Joints<N>; N] = std::array::from_fn(|joint| {
            let (low, high) = A::limits()[joint].position;
            let inside = f64::from(low) + SWEEP_RAD..f64::from(high) - SWEEP_RAD;
            let tilted = [TILT_RAD, -TILT_RAD].map(|tilt| {
                let mut pose = self.rest;
                pose[joint] += tilt;
                pose
            });
            let admissible = tilted.into_iter().filter(|q| inside.contains(&q[joint]));
            let felt = |q: &Joints<N>| lever(q, joint).abs();
            let best = admissible.max_by(|a, b| felt(a).total_cmp(&felt(b)));
            best.unwrap_or(self.rest)
        });
        let expected: [f64; N] = std::array::from_fn(|joint| lever(&poses[joint], joint));
        self.player.network.ask(&Ask::Weight(None))?;
        let before = self.sweeps(&poses)?;
        self.player.network.ask(&Ask::Weight(Some(*body)))?;
        let after = self.sweeps(&poses);
        self.player.network.ask(&Ask::Weight(None))?;
        let after = after?;
        for (joint, expected) in expected.into_iter().enumerate() {
            // The mean of both ways is free of friction. Both ways pass the pose on opposite sides.
            let load = |[up, down]: [[f64; BLOCKS]; 2], k: usize| 0.5 * (up[k] + down[k]);
            let shares: [f64; BLOCKS] = std::array::from_fn(|k| {
                (load(after[joint], k) - load(before[joint], k)) / expected
            });
            let count = BLOCKS as f64;
            let mean = shares.iter().sum::<f64>() / count;
            let squares: f64 = shares.iter().map(|share| (share - mean).powi(2)).sum();
            let deviation = (squares / (count * (count - 1.0))).sqrt();
            // A lever that noise drowns says nothing.
            if deviation.is_nan() || 3.0 * deviation > GAIN_ERROR {
                self.found[joint].gain = None;
                continue;
            }
            let gain = mean.recip();
            self.found[joint].gain = Some((gain, deviation * gain * gain));
            check(joint, (gain - 1.0).abs() <= GAIN_ERROR, || {
                let (mass, measured) = (body.mass, mean * expected);
                format!(
                    "gain of torque: {mass} kg are {expected:.2} N·m, {measured:.2} N·m are reported; it is {gain:.2}"
                )
            })?;
        }
        Ok(())
    }

    /// Sweeps each joint in the loop about its pose, rad, both ways. In blocks of either way: torque beyond the described
    /// gravity, N·m.
    fn sweeps(&mut self, poses: &[Joints<N>; N]) -> Result<[[[f64; BLOCKS]; 2]; N], BusError> {
        self.player.arm()?;
        let outcome = self.swept(poses);
        let parked = self.player.park();
        let excess = outcome?;
        parked.map(|_| excess)
    }

    fn swept(&mut self, poses: &[Joints<N>; N]) -> Result<[[[f64; BLOCKS]; 2]; N], BusError> {
        let period_s = self.player.period_s();
        let mut all = [[[0.0; BLOCKS]; 2]; N];
        for (joint, (pose, ways)) in poses.iter().zip(&mut all).enumerate() {
            for (way, blocks) in [1.0, -1.0].into_iter().zip(ways) {
                let mut start = *pose;
                start[joint] -= way * SWEEP_RAD;
                self.player.approach(&start)?;
                let ticks = (2.0 * SWEEP_RAD / SWEEP_RAD_S / period_s) as usize;
                let mut counts = [0.0; BLOCKS];
                for tick in 0..ticks {
                    let mut desired = State::rest(start);
                    desired.q[joint] += way * SWEEP_RAD_S * tick as f64 * period_s;
                    desired.qd[joint] = way * SWEEP_RAD_S;
                    let result = self.player.tick(Some(&motion_f32(&desired)))?;
                    self.player.check()?;
                    // The first half is for what the start has moved.
                    let late = (2 * tick).checked_sub(ticks);
                    let block = late.map(|late| late * BLOCKS / ticks);
                    if let Some((measured, block)) = result.measured.zip(block) {
                        let gravity = self.model.gravity_torques(&measured.q.cast())[joint];
                        blocks[block] += f64::from(measured.tau[joint]) - gravity;
                        counts[block] += 1.0;
                    }
                }
                for (sum, count) in blocks.iter_mut().zip(counts) {
                    *sum /= count;
                }
            }
            self.player.approach(&self.rest.clone())?;
        }
        Ok(all)
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
                let event = joints[joint].drive.decode(&frame);
                if let Some(Event::Reply(reply)) = event.filter(|_| bus == joints[joint].bus) {
                    state = reply.state.or(state);
                    if let Some(q) = reply.position {
                        path.push((tick as f64 * period_s, f64::from(q)));
                    }
                }
                self.player.controller.receive(bus, &frame);
            }
            if let Some(DriveState::Fault(code)) = state {
                let problem = format!("the drive reports fault {code:#x}");
                return Err(BusError::Mistake(joint, problem));
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
                    let mut command = JointCommand {
                        position: here[index],
                        ..JointCommand::default()
                    };
                    if held {
                        (command.kp, command.kd) = (0.1 * entry.kp, 0.1 * entry.kd);
                    } else if !torque_nm.is_nan() {
                        command.torque = torque_nm as f32;
                    }
                    let carry = &mut carries[index];
                    entry.drive.command(&command, carry, &mut frames);
                }
                for frame in &frames {
                    self.player.network.send(entry.bus, frame)?;
                }
            }
        }
        Ok(path)
    }

    /// Switches every drive off; the loop does so while it is off itself.
    pub(super) fn switch_off(&mut self) -> Result<(), BusError> {
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
