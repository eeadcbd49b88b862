//! Does it learn? Feed-forward and learner together, on torques of an arm whose parameters they do not know.
//!
//! The plant here is the rigid-body model itself with other parameters, and friction with a Stribeck curve that the
//! linear columns cannot follow. Measured positions are rounded as a 17-bit encoder does; torque carries noise.

use super::{FeedForward, FeedForwardConfig, ParameterSet, evaluate};
use crate::arm::Arm;
use crate::arm::ur5::Ur5;
use crate::dynamics::{FrictionParameters, rnea};
use crate::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use crate::learning::{Exchange, Learner, LearnerConfig, Lesson};

const N: usize = 6;
const P: usize = 40;
const PERIOD: f64 = 1e-3;
const VISCOUS: [f64; N] = [12.0, 13.0, 9.0, 1.8, 1.6, 1.4];
const COULOMB: [f64; N] = [7.0, 8.0, 5.5, 1.2, 1.1, 0.9];

type Set = ParameterSet<N, P>;

/// Seeded numbers uniform in ±1.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Sum of twelve: variance 1 is four times a third.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.roll()).sum::<f64>() * 0.5
    }
}

/// A Fourier series of order five for each joint, scaled to 80 % of its speed limit and 2.8 rad.
struct Fourier {
    base: f64,
    sine: [[f64; 5]; N],
    cosine: [[f64; 5]; N],
    centre: [f64; N],
}

impl Fourier {
    fn new(seed: u64, period_s: f64, speed: f64) -> Self {
        let mut dice = Dice(seed);
        let mut series = Self {
            base: core::f64::consts::TAU / period_s,
            sine: core::array::from_fn(|_| core::array::from_fn(|_| dice.roll())),
            cosine: core::array::from_fn(|_| core::array::from_fn(|_| dice.roll())),
            centre: [0.0, -1.2, 0.3, 0.0, 0.0, 0.0],
        };
        let mut peak = [(0.0f64, 0.0f64); N];
        for k in 0..4000 {
            let (q, qd, _) = series.at(f64::from(k) * period_s / 4000.0);
            for j in 0..N {
                peak[j].0 = peak[j].0.max((q[j] - series.centre[j]).abs());
                peak[j].1 = peak[j].1.max(qd[j].abs());
            }
        }
        for j in 0..N {
            let scale = (speed / peak[j].1).min(2.8 / peak[j].0);
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
fn true_torque(motion: &JointMotion<N>) -> [f64; N] {
    let rigid = rnea::<Ur5, N, P>(&Ur5::NOMINAL.into(), motion);
    core::array::from_fn(|j| {
        let v = f64::from(motion.qd[j]);
        let stribeck = 1.0 + 0.25 * (-(v / 0.1).powi(2)).exp();
        f64::from(rigid[j]) + VISCOUS[j] * v + COULOMB[j] * stribeck * (v / 0.005).tanh()
    })
}

/// What the board believes at first: inertial parameters 20 % off either way, rotors −20 %, friction −40 %.
fn wrong_prior(seed: u64) -> Set {
    let mut dice = Dice(seed);
    let mut set = Set::nominal::<Ur5>(1);
    for (i, value) in set.rigid.iter_mut().enumerate() {
        *value *= if i >= 36 || dice.roll() < 0.0 {
            0.8
        } else {
            1.2
        };
    }
    set.friction = core::array::from_fn(|j| FrictionParameters {
        viscous: (0.6 * VISCOUS[j]) as f32,
        coulomb: (0.6 * COULOMB[j]) as f32,
    });
    set
}

/// NRMSE of `set` on the unseen trajectory: `sqrt(mean_j (RMS error_j / RMS torque_j)²)`, and joint by joint.
fn nrmse(set: &Set, unseen: &Fourier, gate: f32) -> (f64, [f64; N]) {
    let (mut error, mut power) = ([0.0; N], [0.0; N]);
    for k in 0..6000 {
        let motion = unseen.motion(f64::from(k) * 5e-3);
        let tau = true_torque(&motion);
        let said = evaluate::<Ur5, N, P>(set, &motion).total;
        for j in 0..N {
            if motion.qd[j].abs() < gate {
                continue;
            }
            error[j] += (f64::from(said[j]) - tau[j]).powi(2);
            power[j] += tau[j].powi(2);
        }
    }
    let ratio: [f64; N] = core::array::from_fn(|j| error[j] / power[j]);
    (
        (ratio.iter().sum::<f64>() / N as f64).sqrt(),
        ratio.map(f64::sqrt),
    )
}

/// The sets active after each of `seconds`, and the learner.
fn learn(
    config: LearnerConfig<N, P>,
    prior: Set,
    seconds: &[u32],
    mut seen: impl FnMut(u32, &Set),
) -> Learner<Ur5, N, P> {
    let motion = Fourier::new(3, 10.0, 2.4);
    let mut noise = Dice(77);
    let mut feedforward =
        FeedForward::<Ur5, N, P>::new(FeedForwardConfig::for_arm::<Ur5, P>(1e-3), prior).unwrap();
    let mut learner = Learner::<Ur5, N, P>::new(config, prior).unwrap();
    let mut exchange = Exchange::new();
    feedforward.set_learning(true);
    let step = core::f64::consts::TAU / 131_072.0;
    for tick in 0..1000 * seconds.last().copied().unwrap_or(0) {
        let desired = motion.motion(f64::from(tick) * PERIOD);
        let tau = true_torque(&desired);
        let measured = JointMeasurement {
            q: desired
                .q
                .map(|q| ((f64::from(q) / step).round() * step) as f32),
            tau: JointVector::from_fn(|j, _| {
                (tau[j] + 0.01 * f64::from(Ur5::LIMITS[j].torque) * noise.normal()) as f32
            }),
        };
        feedforward.adopt(&mut exchange);
        feedforward.step(&JointSample {
            desired,
            measured: Some(measured),
        });
        let lesson: Lesson<N> = feedforward.lesson(Some(measured));
        learner.learn(&lesson, &mut exchange);
        let now = (tick + 1) / 1000;
        if (tick + 1) % 1000 == 0 && seconds.contains(&now) {
            seen(now, &feedforward.state().active);
        }
    }
    assert_eq!(feedforward.state().late_sets, 0);
    learner
}

#[test]
#[ignore = "tuning"]
fn tune() {
    let unseen = Fourier::new(99, 15.0, 2.7);
    let get = |k: &str, d: f32| {
        std::env::var(k)
            .ok()
            .and_then(|v| v.parse().ok())
            .unwrap_or(d)
    };
    for seed in [1u64, 2] {
        let mut config = LearnerConfig::for_arm::<Ur5>(1e-3);
        config.rate = get("RATE", config.rate);
        config.noise = get("NOISE", config.noise);
        config.network.learning_rate = get("NET", config.network.learning_rate);
        config.network.error_clip = get("NCLIP", config.network.error_clip);
        let prior = wrong_prior(seed);
        let before = nrmse(&prior, &unseen, 0.0);
        println!("before {:.4} {:.3?}", before.0, before.1);
        let learner = learn(config, prior, &[5, 20, 60, 100], |s, set| {
            let after = nrmse(set, &unseen, 0.0);
            let mut linear = *set;
            linear.network = prior.network;
            println!(
                "{s:4} s {:.4} ratio {:.3} {:.3?} linear {:.4} moving {:.4} linear {:.4}",
                after.0,
                after.0 / before.0,
                after.1,
                nrmse(&linear, &unseen, 0.0).0,
                nrmse(set, &unseen, 0.05).0,
                nrmse(&linear, &unseen, 0.05).0
            );
        });
        println!("{:?}", learner.state().statistics);
    }
}
