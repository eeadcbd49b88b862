//! Learning on a 7-joint arm that the learner was not tuned on: motor currents or link-side torque sensors, disturbances that
//! last for tenths of a second.

use crate::Random;
use crate::arm::Arm;
use crate::arm::panda::{JOINTS as N, PARAMETERS as P, Panda};
use crate::dynamics::{FrictionColumn, FrictionParameters};
use crate::feedforward::{FeedForward, FeedForwardConfig, ParameterSet, evaluate};
use crate::joint::{JointMeasurement, JointMotion, JointSample};
use crate::learning::{Exchange, Learner, LearnerConfig};

type Set = ParameterSet<N, P>;

/// Position, velocity and acceleration at time `t`, s, on sines around the middle of the range.
fn motion(t: f64, seed: f64, speed: f64) -> JointMotion<N> {
    let mut motion = JointMotion::zero();
    for j in 0..N {
        let (lower, upper) = Panda::LIMITS[j].position;
        let (mut q, mut qd, mut qdd) = (f64::from(0.5 * (lower + upper)), 0.0, 0.0);
        for k in 0..3 {
            let w = 0.4 + 0.55 * f64::from(k) + 0.037 * j as f64 * (1.0 + seed);
            let (s, c) = (w * t + seed + 1.7 * j as f64 * f64::from(k + 1)).sin_cos();
            let a = speed / (3.0 * w);
            q += a * s;
            qd += a * w * c;
            qdd -= a * w * w * s;
        }
        (motion.q[j], motion.qd[j], motion.qdd[j]) = (q as f32, qd as f32, qdd as f32);
    }
    motion
}

/// The arm: rigid body of the description, and friction of a part of the torque limits.
fn truth(friction: f32) -> Set {
    let mut set = Set::nominal::<Panda>(1);
    for (joint, limits) in set.friction.iter_mut().zip(&Panda::LIMITS) {
        *joint = FrictionParameters::NONE
            .with(
                FrictionColumn::Viscous,
                friction * limits.torque / limits.velocity,
            )
            .with(FrictionColumn::Coulomb, friction * limits.torque)
            .with(FrictionColumn::Offset, 0.3 * friction * limits.torque);
    }
    set
}

/// `set` with its base parameters off by `part` either way.
fn off(mut set: Set, part: f32) -> Set {
    let mut random = Random(3);
    for value in &mut set.rigid {
        *value *= if random.uniform() < 0.0 {
            1.0 - part
        } else {
            1.0 + part
        };
    }
    set
}

/// Torque error of `set` over that of `start`, on an unseen path: mean over the joints of the ratio of squares to the
/// torque limits.
fn error(set: &Set, truth: &Set) -> f64 {
    let mut sum = 0.0;
    for k in 0..400 {
        let motion = motion(0.05 * f64::from(k), 0.77, 1.0);
        let [wanted, found] = [truth, set].map(|set| evaluate::<Panda, N, P>(set, &motion).total);
        for j in 0..N {
            sum += f64::from((wanted[j] - found[j]) / Panda::LIMITS[j].torque).powi(2);
        }
    }
    sum.sqrt()
}

/// Ratios of the error to that at the start, second by second.
fn learn(truth: &Set, start: &Set, seconds: u32) -> Vec<f64> {
    let period_s = 1e-3;
    let config = FeedForwardConfig::for_arm::<Panda, P>(period_s);
    let mut feedforward = FeedForward::<Panda, N, P>::new(config, *start).unwrap();
    let config = LearnerConfig::for_arm::<Panda>(period_s);
    let mut learner = Learner::<Panda, N, P>::new(config, *start).unwrap();
    let mut exchange = Exchange::new();
    feedforward.set_learning(true);
    let (mut random, mut drift, mut curve) = (Random(9), [0.0; N], Vec::new());
    let before = error(start, truth);
    for tick in 0..1000 * seconds {
        let desired = motion(f64::from(tick) * 1e-3, 0.0, 1.0);
        let mut tau = evaluate::<Panda, N, P>(truth, &desired).total;
        for j in 0..N {
            let limit = f64::from(Panda::LIMITS[j].torque);
            // 1 % of the limit for 0.3 s, and half of that as white noise.
            drift[j] +=
                -drift[j] / 300.0 + 0.01 * limit * (2.0f64 / 300.0).sqrt() * random.normal();
            tau[j] += (drift[j] + 0.005 * limit * random.normal()) as f32;
        }
        let q = desired.q.map(|q| ((q * 20_000.0).round()) / 20_000.0);
        let measured = Some(JointMeasurement { q, tau });
        feedforward.adopt(&mut exchange);
        feedforward.step(&JointSample { desired, measured });
        learner.learn(&feedforward.learning_sample(measured), &mut exchange);
        if tick % 1000 == 999 {
            curve.push(error(&feedforward.state().active, truth) / before);
        }
    }
    println!("{curve:.2?}");
    curve
}

#[test]
fn a_description_becomes_an_arm_with_and_without_friction() {
    for friction in [0.05, 0.0] {
        let truth = truth(friction);
        let start = off(self::truth(0.0), 0.2);
        let curve = learn(&truth, &start, 30);
        assert!(curve[29] < 0.35, "{}", curve[29]);
    }
}
