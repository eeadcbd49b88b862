//! Steps of commissioning with torque: a push, slow sweeps in the loop, a known weight.

use super::{Ask, BusError, Commissioning, check, silent};
use crate::bus::Network;
use crate::closed_loop::motion_f32;
use crate::dynamics::{Joints, State};
use crate::robot::Link;
use foretorque::arm::Arm;
use foretorque_link::bus::SILENCE_S;
use foretorque_link::drives::{Carry, DriveState, Event, Frames, JointCommand, Order};
use nalgebra::{Matrix5, Vector5};

/// Torques of the probe, parts of the limit, in the order in which they are tried. The last is the largest.
const LEVELS: [f64; 7] = [0.005, 0.0085, 0.02, 0.035, 0.05, 0.07, 0.095];
/// Longest rest before a push, longest push and longest coasting, s.
const REST_S: f64 = 0.1;
const PUSH_S: f64 = 0.4;
const COAST_S: f64 = 0.1;
/// Travel of any joint that ends each of them, rad: those that are off may give way, and none is to fall.
const TRAVEL_RAD: f64 = 0.04;
/// Speed of a joint that is held that ends each of them, rad/s.
const GIVES_RAD_S: f64 = 0.5;
/// Least speed that is motion, rad/s: Coulomb friction has its full torque there.
const MOTION_RAD_S: f64 = 0.05;
/// Samples on either side over which the speed is the mean.
const AROUND: usize = 4;
/// Largest relative standard deviation of a ratio by which a drive is judged.
const DEVIATION: f64 = 0.05;
/// Largest relative standard deviation of a ratio that may end the rise of the torque.
const MOST_DEVIATION: f64 = 0.2;
/// Half the largest relative difference between the ratios of both ways.
const SPREAD: f64 = 0.15;
/// Ratios of the torque that arrives to the commanded one that pass: a scale wrong by 2 does not, even where the described
/// inertia is a fifth off.
const RATIOS: std::ops::Range<f64> = 0.6..1.0 / 0.6;
/// Part of the limit that no push may exceed by what arrives.
const MOST: f64 = 0.1;
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
    /// Pushes a joint both ways, with rising torques until both pushes give one ratio of the torque that arrives.
    pub(super) fn torque(&mut self, joint: usize) -> Result<(), BusError> {
        let limit = self.limit(joint);
        let holds = !self.player.controller.config().joints[joint]
            .drive
            .carries_gains();
        let found = &mut self.found[joint];
        (found.breakaway_nm, found.torque_ratio) = (None, None);
        if holds {
            let reason = "its drive holds it by gains of its own against a push; the step weight shows scale and sign";
            self.undetermined.push((joint, reason.to_owned()));
            return Ok(());
        }
        let mut gives_way = None;
        for (place, level) in LEVELS.into_iter().enumerate() {
            let push_nm = level * limit;
            let mut ratios: Vec<f64> = Vec::new();
            let mut worst: f64 = 0.0;
            for way in [1.0, -1.0] {
                let (ratio, gives) = self.push(joint, way * push_nm)?;
                gives_way = gives.or(gives_way);
                let Some((ratio, deviation)) = ratio else {
                    continue;
                };
                self.found[joint].breakaway_nm.get_or_insert(push_nm);
                let relative = deviation / ratio.abs().max(1.0);
                if relative <= MOST_DEVIATION {
                    ratios.push(ratio);
                    worst = worst.max(relative);
                }
            }
            // The next push would be too much: what has been seen has to do.
            let size = ratios.iter().map(|ratio| ratio.abs()).sum::<f64>() / ratios.len() as f64;
            let next = LEVELS.get(place + 1).copied().unwrap_or(1.0);
            let last = size >= RATIOS.end && size * next > MOST;
            if let [one, other] = ratios[..] {
                let ratio = 0.5 * (one + other);
                let spread = 0.5 * (one - other).abs() / ratio.abs().max(1.0);
                let clear = last && one.abs().min(other.abs()) >= RATIOS.end;
                if clear || worst <= DEVIATION && spread <= SPREAD {
                    return self.judge(joint, push_nm, ratio);
                }
            }
            if last {
                break;
            }
        }
        let most = LEVELS[LEVELS.len() - 1] * limit;
        let friction = self.friction_nm[joint];
        let moved = self.found[joint].breakaway_nm.is_some();
        // Friction that is described, and far below the push, holds no joint.
        let explained = moved || gives_way.is_some() || friction == 0.0 || friction > 0.5 * most;
        check(joint, explained, || {
            format!(
                "scale of torque: no motion at {most:.2} N·m, a tenth of its limit, against a friction of {friction:.2} N·m; is it too small, or is the joint blocked?"
            )
        })?;
        let reason = match (gives_way, moved) {
            (Some(other), _) => format!(
                "joint {} gives way; does the arm rest in rest_rad?",
                other + 1
            ),
            (None, true) => "pushes both ways differ".to_owned(),
            (None, false) => format!("no motion at {most:.2} N·m, a tenth of its limit"),
        };
        self.undetermined.push((joint, reason));
        Ok(())
    }

    /// Errors: the ratio of the torque that arrives to the commanded one is not that of a sound drive.
    fn judge(&mut self, joint: usize, push_nm: f64, ratio: f64) -> Result<(), BusError> {
        self.found[joint].torque_ratio = Some(ratio);
        check(joint, RATIOS.contains(&ratio), || {
            let arrives = ratio * push_nm;
            let wrong = match ratio < -0.5 * RATIOS.start {
                true => "torque sign",
                false => "scale of torque",
            };
            format!(
                "{wrong}: of {push_nm:.2} N·m about {arrives:.2} N·m arrive, by its acceleration"
            )
        })
    }

    /// Pushes a joint from where brakes or friction hold the arm, and lets it coast: [`ratio`](Self::ratio) of the torque
    /// that arrives, and a joint that gave way.
    fn push(
        &mut self,
        joint: usize,
        push_nm: f64,
    ) -> Result<(Option<Ratio>, Option<usize>), BusError> {
        self.player.switch_off()?;
        if let (_, Some(other)) = self.run(joint, f64::NAN, REST_S)? {
            return Ok((None, Some(other)));
        }
        let (mut path, gave) = self.run(joint, push_nm, PUSH_S)?;
        let switch = path.len();
        let end_s = path.last().map_or(0.0, |sample| sample.t_s) + self.player.period_s();
        let (coasted, strayed) = self.run(joint, 0.0, COAST_S)?;
        path.extend(coasted.into_iter().map(|sample| Sample {
            t_s: end_s + sample.t_s,
            ..sample
        }));
        let gives = gave.or(strayed).filter(|other| *other != joint);
        Ok((self.ratio(joint, &path, switch), gives))
    }

    /// Torque that arrives over the commanded one, and its standard deviation, by the motion around sample `switch`, from
    /// which on the joint coasts; none without motion there.
    ///
    /// While joint j moves one way, r τ = M_j q̈ + g_j + c + d q̇ with its friction c + d q̇. Integrated twice:
    ///
    /// ```text
    /// M_j Δq + ∬ g_j = r ∬ τ − c t²/2 − d ∫ Δq + b t + a
    /// ```
    ///
    /// Nothing is differentiated. Δq has all joints: those that swing or give way count. An error of the described
    /// gravity, constant over so small a travel, goes into c. Velocity products are left out.
    fn ratio(&self, joint: usize, path: &[Sample<N>], switch: usize) -> Option<Ratio> {
        path.get(switch)?;
        let way = speed(path, switch, joint).signum();
        let moves = |k: &usize| way * speed(path, *k, joint) > MOTION_RAD_S;
        let start = (0..=switch).rev().take_while(moves).last()?;
        let end = (switch..path.len()).take_while(moves).last()?;
        let path = &path[start..=end];
        let (first, mass) = (
            path.first()?,
            self.model.mass_matrix(&path[path.len() / 2].q),
        );
        let mut rows = Vec::new();
        let (mut torque, mut gravity, mut area) = ([0.0; 2], [0.0; 2], 0.0);
        for (place, sample) in path.iter().enumerate() {
            let (t_s, moved) = (sample.t_s - first.t_s, sample.q - first.q);
            let row = Vector5::new(torque[1], 0.5 * t_s * t_s, area, t_s, 1.0);
            rows.push((row, (mass * moved)[joint] + gravity[1]));
            let Some(next) = path.get(place + 1) else {
                break;
            };
            let h = next.t_s - sample.t_s;
            let integrate = |sums: &mut [f64; 2], value: f64| {
                sums[1] += h * (sums[0] + 0.5 * h * value);
                sums[0] += h * value;
            };
            integrate(&mut torque, sample.torque_nm);
            integrate(&mut gravity, self.model.gravity_torques(&sample.q)[joint]);
            area += h * (0.5 * (sample.q + next.q) - first.q)[joint];
        }
        let gram: Matrix5<f64> = rows.iter().map(|(row, _)| row * row.transpose()).sum();
        let moment: Vector5<f64> = rows.iter().map(|(row, y)| row * *y).sum();
        let inverse = gram.try_inverse()?;
        let fitted = inverse * moment;
        let left = |(row, y): &(Vector5<f64>, f64)| y - row.dot(&fitted);
        let left: Vec<f64> = rows.iter().map(left).collect();
        let squares: f64 = left.iter().map(|e| e * e).sum();
        // What friction does beside c + d q̇, cogging above all, is no white noise: neighbours count as one.
        let products: f64 = left.iter().zip(&left[1..]).map(|(a, b)| a * b).sum();
        let alike = (products / squares).clamp(0.0, 0.999);
        let free = rows.len().checked_sub(fitted.len() + 1)? as f64 + 1.0;
        let variance = squares / free * inverse[(0, 0)] * (1.0 + alike) / (1.0 - alike);
        Some((fitted[0], variance.sqrt()))
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

    /// Weighs a known body with each joint, in the pose near rest where its torque is largest.
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
            let lever_length = |q: &Joints<N>| lever(q, joint).abs();
            let best = admissible.max_by(|a, b| lever_length(a).total_cmp(&lever_length(b)));
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
            // A lever below the noise is no evidence.
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

    /// Sends a torque to one joint, N·m, while those that have passed before it are held and the others are off: samples of
    /// the arm, and the joint whose motion has ended them.
    ///
    /// * `torque_nm` not a number: the joint is left without torque, and off where it has not passed
    /// * `longest_s` the time after which it ends where no joint has travelled [`TRAVEL_RAD`]
    fn run(
        &mut self,
        joint: usize,
        torque_nm: f64,
        longest_s: f64,
    ) -> Result<(Vec<Sample<N>>, Option<usize>), BusError> {
        let period_s = self.player.period_s();
        let joints = self.player.controller.config().joints;
        let here = self.player.positions();
        let mut carries = [Carry::default(); N];
        // Time since the last reply of each joint, s.
        let mut ages = [0.0; N];
        let left_out_s = self.player.left_out_s();
        let mut path: Vec<Sample<N>> = Vec::new();
        let mut state = None;
        let held: [bool; N] =
            std::array::from_fn(|other| other < joint && self.found[other].torque_ratio.is_some());
        for tick in 0..(longest_s / period_s) as usize {
            self.player.wait();
            let t_s = tick as f64 * period_s + self.player.left_out_s() - left_out_s;
            ages.iter_mut().for_each(|age| *age += period_s);
            while let Some((bus, frame)) = self.player.network.receive()? {
                let own = joints.iter().zip(&mut ages).enumerate();
                for (index, (entry, age)) in own.filter(|(_, (entry, _))| entry.bus == bus) {
                    let Some(Event::Reply(reply)) = entry.drive.decode(&frame) else {
                        continue;
                    };
                    if index == joint {
                        state = reply.state.or(state);
                    }
                    if reply.position.is_some() {
                        *age = 0.0;
                    }
                }
                self.player.controller.receive(bus, &frame);
            }
            let replied = ages[joint] == 0.0;
            // Without replies nothing ends a push, or holds a joint where it is.
            let watched = |other: &usize| *other == joint || held[*other];
            let mut watched = (0..N).filter(watched);
            if let Some(lost) = watched.find(|other| ages[*other] > f64::from(SILENCE_S)) {
                return Err(silent(lost));
            }
            if let Some(DriveState::Fault(code)) = state {
                let problem = format!("the drive reports fault {code:#x}");
                return Err(BusError::Mistake(joint, problem));
            }
            // The first reply is of the command before.
            if replied && tick > 0 {
                path.push(Sample {
                    t_s,
                    torque_nm,
                    q: self.player.positions().cast(),
                });
            }
            let gives = |other: &usize| {
                let speed = speed(&path, path.len(), *other);
                let travel = path.last().map_or(0.0, |last| (last.q - path[0].q)[*other]);
                travel.abs() > TRAVEL_RAD || held[*other] && speed.abs() > GIVES_RAD_S
            };
            if let Some(other) = (0..N).find(gives) {
                return Ok((path, Some(other)));
            }
            for (index, entry) in joints.iter().enumerate() {
                let mut frames = Frames::new();
                if index != joint && !held[index] {
                    if tick < 3 || !entry.drive.order(Order::Report, &mut frames) {
                        entry.drive.order(Order::Disable, &mut frames);
                    }
                } else if tick < 3 && torque_nm.is_nan() {
                    entry.drive.order(Order::Enable, &mut frames);
                } else {
                    let mut command = JointCommand {
                        position: here[index],
                        ..JointCommand::default()
                    };
                    if held[index] {
                        let most = MOST * self.limit(index);
                        let (kp, kd) = (f64::from(entry.kp), f64::from(entry.kd));
                        // The position that ends the run is a few periods old.
                        let travel = TRAVEL_RAD + 4.0 * period_s * GIVES_RAD_S;
                        let part = (most / (kp * travel + kd * GIVES_RAD_S)).min(0.1) as f32;
                        (command.kp, command.kd) = (part * entry.kp, part * entry.kd);
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
        Ok((path, None))
    }
}

/// Torque that arrives over the commanded one, and its standard deviation.
type Ratio = (f64, f64);

/// Position of the arm, rad, with the time, s, and the torque that the joint is sent from there on, N·m.
struct Sample<const N: usize> {
    t_s: f64,
    torque_nm: f64,
    q: Joints<N>,
}

/// Speed of a joint around sample `k`, rad/s; not a number before there are two samples.
fn speed<const N: usize>(path: &[Sample<N>], k: usize, joint: usize) -> f64 {
    let end = (k + AROUND + 1).min(path.len());
    let around = &path[k.saturating_sub(AROUND).min(end)..end];
    let ends = around.first().zip(around.last());
    ends.map_or(f64::NAN, |(one, later)| {
        (later.q - one.q)[joint] / (later.t_s - one.t_s)
    })
}
