//! Feed-forward and learner together, on torques of an arm with other parameters than theirs.
//!
//! The plant here is the rigid-body model itself with other parameters, and friction with a Stribeck curve of another
//! width than the linear columns have, and cogging. Measured positions are rounded as a 17-bit encoder does; torque carries noise.

use super::{FeedForward, FeedForwardConfig, ParameterSet, Torque, evaluate};
use crate::Random;
use crate::arm::Arm;
use crate::arm::ur5::Ur5;
use crate::dynamics::{BaseParameters, FrictionColumn, FrictionParameters, rnea};
use crate::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use crate::learning::{Exchange, Learner, LearnerConfig, LearningSample};
use crate::limits::Flags;
use std::collections::VecDeque;

mod convergence;
mod events;
mod other_arms;

const N: usize = 6;
const P: usize = 40;
const PERIOD: f64 = 1e-3;
const VISCOUS: [f64; N] = [12.0, 13.0, 9.0, 1.8, 1.6, 1.4];
const COULOMB: [f64; N] = [7.0, 8.0, 5.5, 1.2, 1.1, 0.9];
const COGGING: [f64; N] = [0.5, 0.5, 0.5, 0.15, 0.15, 0.15];

/// Friction of the drives beside viscous and Coulomb friction.
#[derive(Clone, Copy, Debug)]
struct Drive {
    /// Height of the Stribeck peak, as a part of the Coulomb torque.
    stribeck: f64,
    /// Part of the cogging torque of the arm as it is.
    cogging: f64,
    /// Friction for each unit of the rigid body's torque.
    load: f64,
}

const AS_IT_IS: Drive = Drive {
    stribeck: 0.25,
    cogging: 1.0,
    load: 0.0,
};
const PLAIN: Drive = Drive {
    stribeck: 0.0,
    cogging: 0.0,
    load: 0.0,
};
/// Gears that rub more under load, as those of a real arm do.
const UNDER_LOAD: Drive = Drive {
    load: 0.07,
    ..AS_IT_IS
};

type Set = ParameterSet<N, P>;

/// A Fourier series of order five for each joint, scaled to 80 % of its speed limit and 2.8 rad.
struct Fourier {
    base: f64,
    sine: [[f64; 5]; N],
    cosine: [[f64; 5]; N],
    centre: [f64; N],
}

impl Fourier {
    fn new(seed: u64, period_s: f64, speed: f64) -> Self {
        let mut random = Random(seed);
        let mut series = Self {
            base: core::f64::consts::TAU / period_s,
            sine: core::array::from_fn(|_| core::array::from_fn(|_| random.uniform())),
            cosine: core::array::from_fn(|_| core::array::from_fn(|_| random.uniform())),
            centre: [0.0, -1.2, 0.3, 0.0, 0.0, 0.0],
        };
        let mut peak = [(0.0f64, 0.0f64); N];
        for k in 0..4000 {
            let (q, qd, _) = series.at(f64::from(k) * period_s / 4000.0);
            for (j, peak) in peak.iter_mut().enumerate() {
                peak.0 = peak.0.max((q[j] - series.centre[j]).abs());
                peak.1 = peak.1.max(qd[j].abs());
            }
        }
        for (j, (reach, fastest)) in peak.into_iter().enumerate() {
            let scale = (speed / fastest).min(2.8 / reach);
            series.sine[j] = series.sine[j].map(|c| c * scale);
            series.cosine[j] = series.cosine[j].map(|c| c * scale);
        }
        series
    }

    fn at(&self, t: f64) -> ([f64; N], [f64; N], [f64; N]) {
        let (mut q, mut qd, mut qdd) = (self.centre, [0.0; N], [0.0; N]);
        for j in 0..N {
            for k in 0..5 {
                let w = self.base * (k + 1) as f64;
                let (s, c) = (w * t).sin_cos();
                let (a, b) = (self.sine[j][k] / w, self.cosine[j][k] / w);
                q[j] += a * s - b * c;
                qd[j] += w * (a * c + b * s);
                qdd[j] += w * w * (b * c - a * s);
            }
        }
        (q, qd, qdd)
    }

    fn motion(&self, t: f64) -> JointMotion<N> {
        let (q, qd, qdd) = self.at(t);
        JointMotion {
            q: JointVector::from_fn(|j, _| q[j] as f32),
            qd: JointVector::from_fn(|j, _| qd[j] as f32),
            qdd: JointVector::from_fn(|j, _| qdd[j] as f32),
        }
    }
}

/// The arm as it is.
fn true_torque(motion: &JointMotion<N>, drive: Drive) -> [f64; N] {
    loaded_torque(&Ur5::NOMINAL.into(), motion, drive)
}

/// The arm with the rigid body `beta`.
fn loaded_torque(beta: &BaseParameters<P>, motion: &JointMotion<N>, drive: Drive) -> [f64; N] {
    let rigid = rnea::<Ur5, N, P>(beta, motion);
    core::array::from_fn(|j| {
        let v = f64::from(motion.qd[j]);
        let peak = 1.0 + drive.stribeck * (-(v / 0.1).powi(2)).exp();
        let cogging = drive.cogging * COGGING[j] * (202.0 * f64::from(motion.q[j])).sin();
        let rigid = f64::from(rigid[j]);
        let dry = COULOMB[j] * peak + drive.load * rigid.abs();
        rigid + VISCOUS[j] * v + dry * (v / 0.005).tanh() + cogging
    })
}

/// Parameters that the board starts from: inertial parameters 20 % off either way, rotors −20 %, friction −40 %.
fn wrong_prior(seed: u64) -> Set {
    let mut random = Random(seed);
    let mut set = Set::nominal::<Ur5>(1);
    for (i, value) in set.rigid.iter_mut().enumerate() {
        *value *= if i >= 36 || random.uniform() < 0.0 {
            0.8
        } else {
            1.2
        };
    }
    set.friction = core::array::from_fn(|j| {
        FrictionParameters::NONE
            .with(FrictionColumn::Viscous, (0.6 * VISCOUS[j]) as f32)
            .with(FrictionColumn::Coulomb, (0.6 * COULOMB[j]) as f32)
    });
    set
}

/// The measurement of `tick` on the learning trajectory, with the desired motion it belongs to.
struct Plant {
    trajectory: Fourier,
    noise: Random,
    drive: Drive,
    /// Base parameters with what is in the hand.
    body: BaseParameters<P>,
    /// Torque from outside, N·m; positive accelerates +q.
    push: [f64; N],
    /// From the first stop on.
    playback: Option<Playback>,
}

/// Playback of the trajectory at a rate of its own.
struct Playback {
    /// Time on the trajectory, s.
    time: f64,
    /// Present rate, and the one it goes to within 0.3 s: 0 at a stop, 1 in motion.
    rate: f64,
    wanted: f64,
}

impl Plant {
    fn new(drive: Drive) -> Self {
        Self {
            trajectory: Fourier::new(3, 10.0, 2.4),
            noise: Random(77),
            drive,
            body: Ur5::NOMINAL.into(),
            push: [0.0; N],
            playback: None,
        }
    }

    /// Motion of `tick`; from the first stop on, that of the playback.
    fn desired(&mut self, tick: u32) -> JointMotion<N> {
        let Some(Playback { time, rate, wanted }) = &mut self.playback else {
            return self.trajectory.motion(f64::from(tick) * PERIOD);
        };
        let growth = ((*wanted - *rate) / PERIOD).clamp(-1.0 / 0.3, 1.0 / 0.3);
        *rate += growth * PERIOD;
        *time += *rate * PERIOD;
        let (motion, scale) = (self.trajectory.motion(*time), *rate as f32);
        JointMotion {
            q: motion.q,
            qd: motion.qd * scale,
            qdd: motion.qdd * (scale * scale) + motion.qd * growth as f32,
        }
    }

    /// Bring the trajectory to a stop, from the time of `tick` on, or let it go on.
    fn play(&mut self, tick: u32, plays: bool) {
        let playback = self.playback.get_or_insert(Playback {
            time: f64::from(tick) * PERIOD,
            rate: 1.0,
            wanted: 1.0,
        });
        playback.wanted = f64::from(u8::from(plays));
    }

    fn sample(&mut self, tick: u32) -> JointSample<N> {
        let desired = self.desired(tick);
        self.measure(desired)
    }

    /// Sample of the arm that moves as `desired`.
    fn measure(&mut self, desired: JointMotion<N>) -> JointSample<N> {
        let encoder = core::f64::consts::TAU / 131_072.0;
        let tau = loaded_torque(&self.body, &desired, self.drive);
        let push = self.push;
        let noisy = |j: usize, noise: &mut Random| {
            tau[j] - push[j] + 0.01 * f64::from(Ur5::LIMITS[j].torque) * noise.normal()
        };
        let measured = JointMeasurement {
            q: desired
                .q
                .map(|q| ((f64::from(q) / encoder).round() * encoder) as f32),
            tau: JointVector::from_fn(|j, _| noisy(j, &mut self.noise) as f32),
        };
        JointSample {
            desired,
            measured: Some(measured),
        }
    }
}

/// Feed-forward, learner and the learning samples between them, used `delay` ticks late.
struct Board {
    feedforward: FeedForward<Ur5, N, P>,
    learner: Learner<Ur5, N, P>,
    exchange: Exchange<N, P>,
    queue: VecDeque<LearningSample<N>>,
    delay: usize,
}

impl Board {
    fn new(prior: Set, delay: usize) -> Self {
        let config = FeedForwardConfig::for_arm::<Ur5, P>(PERIOD as f32);
        let learning = LearnerConfig::for_arm::<Ur5>(PERIOD as f32);
        Self {
            feedforward: FeedForward::new(config, prior).unwrap(),
            learner: Learner::new(learning, prior).unwrap(),
            exchange: Exchange::new(),
            queue: VecDeque::new(),
            delay,
        }
    }

    /// A board that learns from a wrong prior, at the arm as it is.
    fn learning() -> (Self, Plant) {
        let mut board = Self::new(wrong_prior(1), 0);
        board.feedforward.set_learning(true);
        (board, Plant::new(AS_IT_IS))
    }

    fn tick(&mut self, sample: &JointSample<N>) -> Torque<N> {
        self.feedforward.adopt(&mut self.exchange);
        let torque = self.feedforward.step(sample);
        self.queue
            .push_back(self.feedforward.learning_sample(sample.measured));
        while self.queue.len() > self.delay {
            let learning_sample = self.queue.pop_front().unwrap();
            self.learner.learn(&learning_sample, &mut self.exchange);
        }
        torque
    }

    /// Ticks on samples of the plant.
    fn run(&mut self, plant: &mut Plant, ticks: core::ops::Range<u32>) {
        ticks.for_each(|tick| _ = self.tick(&plant.sample(tick)));
    }

    fn active(&self) -> &Set {
        &self.feedforward.state().active
    }
}
