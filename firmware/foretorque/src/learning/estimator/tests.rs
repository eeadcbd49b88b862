use super::noise::EFFECTIVE_ROWS;
use super::*;
use crate::Random;
use crate::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use crate::dynamics::DISSIPATION_BOUNDS;
use crate::dynamics::{FrictionColumn, FrictionParameters};
use crate::joint::{JointMotion, JointVector};
use crate::learning::conditioning::AVERAGED;
use crate::learning::parameters::dot;
use core::array::from_fn;
use std::vec::Vec;

const WIDTH: usize = FRICTION_COLUMNS;

/// Reference filter on the plain covariance, in f64.
struct Twin {
    start: Vec<f64>,
    sigma: Vec<f64>,
    theta: Vec<f64>,
    p: Vec<Vec<f64>>,
    variance: [f64; N],
    effective_rows: [f64; N],
    visits: [usize; N],
}

impl Twin {
    fn correct(
        &mut self,
        joint: usize,
        phi: &[f64],
        innovation: f64,
        process_noise: f64,
        factor: f64,
    ) {
        let turn = self.visits[joint] % RANDOM_WALK_COLUMNS.len();
        let column = RANDOM_WALK_COLUMNS[turn];
        let k = WIDTH * joint + column as usize;
        self.visits[joint] += 1;
        if self.p[k][k] < 1.0 {
            let mean = self.start[k] / self.sigma[k] + self.theta[k];
            let square = match column {
                FrictionColumn::Offset => 1.0,
                _ => (mean * mean + self.p[k][k]).min(1.0),
            };
            self.p[k][k] += RANDOM_WALK_COLUMNS.len() as f64 * process_noise * square;
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let gain: Vec<f64> = self.p.iter().map(|row| dot(row, phi)).collect();
        let total = dot(&gain, phi) + factor * self.variance[joint];
        let s = total - (factor - 1.0) * self.variance[joint];
        let z = innovation / s.sqrt();
        if z.abs() <= 3.0 {
            for (row, a) in self.p.iter_mut().zip(&gain) {
                for (p, b) in row.iter_mut().zip(&gain) {
                    *p -= a * b / total;
                }
            }
        }
        let up = z.abs() > 0.6745;
        let mut step = 1.005;
        if self.effective_rows[joint] < f64::from(EFFECTIVE_ROWS) {
            self.effective_rows[joint] += self.variance[joint] / s;
            step = 1.0 + 2.3 * self.variance[joint] / s / self.effective_rows[joint];
        }
        self.variance[joint] *= if up { step } else { 1.0 / step };
        for (theta, gain) in self.theta.iter_mut().zip(&gain) {
            *theta += gain * z.clamp(-3.0, 3.0) * s.sqrt() / total;
        }
        self.project(WIDTH * joint);
    }

    /// Most likely estimate within the bounds of the friction columns from `first` on.
    fn project(&mut self, first: usize) {
        let n = self.theta.len();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (mut directions, mut values, mut images) = (Vec::new(), Vec::new(), Vec::new());
        for bound in &DISSIPATION_BOUNDS {
            let mut direction = std::vec![0.0; n];
            let mut value = 0.0;
            for (k, &a) in (first..).zip(bound) {
                direction[k] = f64::from(a) * self.sigma[k];
                value += f64::from(a) * (self.start[k] + self.sigma[k] * self.theta[k]);
            }
            let deviation = dot(&direction, &direction).sqrt();
            direction.iter_mut().for_each(|a| *a /= deviation);
            let image: Vec<f64> = self.p.iter().map(|row| dot(row, &direction)).collect();
            images.push(image);
            directions.push(direction);
            values.push(value / deviation);
        }
        if values.iter().all(|&value| value > -1e-4) {
            return;
        }
        let product = |i: usize, k: usize| dot(&directions[i], &images[k]);
        let products: [[f64; 5]; 5] = from_fn(|i| from_fn(|k| product(i, k)));
        let mut lambda = [0.0f64; 5];
        for _ in 0..10_000 {
            let before = lambda;
            for i in 0..lambda.len() {
                let inside = values[i] + dot(&products[i], &lambda);
                lambda[i] = (lambda[i] - inside / products[i][i]).max(0.0);
            }
            if lambda.iter().zip(before).all(|(a, b)| (a - b).abs() < 1e-9) {
                break;
            }
        }
        for (lambda, image) in lambda.iter().zip(&images) {
            for (theta, p) in self.theta.iter_mut().zip(image) {
                *theta += lambda * p;
            }
        }
    }
}

/// True friction of every joint.
fn friction_truth() -> FrictionParameters {
    FrictionParameters::NONE
        .with(FrictionColumn::Viscous, 2.0)
        .with(FrictionColumn::Coulomb, 3.0)
        .with(FrictionColumn::Stribeck, 0.5)
        .with(FrictionColumn::ShearThinning, 0.5)
        .with(FrictionColumn::Load, 0.05)
        .with(FrictionColumn::Offset, -0.3)
        .with(FrictionColumn::CoggingSine, 0.2)
        .with(FrictionColumn::CoggingCosine, -0.1)
}

/// Prior covariance in units of the prior standard deviations: uncorrelated friction, then base parameters.
fn prior_covariance(n: usize) -> Vec<Vec<f64>> {
    let floor = prior_floor::<Ur5, N, P>();
    let mut p: Vec<Vec<f64>> = (0..n).map(|_| std::vec![0.0; n]).collect();
    for (k, row) in p.iter_mut().enumerate() {
        row[k] = k.checked_sub(n - P).map_or(1.0, |k| f64::from(floor[k]));
    }
    for factor in (0..).map_while(prior_factor::<Ur5, N, P>) {
        for (row, a) in p[n - P..].iter_mut().zip(factor) {
            for (p, b) in row[n - P..].iter_mut().zip(factor) {
                *p += f64::from(a) * f64::from(b);
            }
        }
    }
    p
}

#[test]
fn the_initial_covariance_is_that_of_the_prior_factors() {
    let prior = ParameterSet::nominal::<Ur5>(1);
    let estimator = Estimator::<N, P>::new::<Ur5>(&prior);
    let n = WIDTH * N + P;
    let twin = prior_covariance(n);
    for k in 0..P {
        let variance = f64::from(estimator.filter().rigid_variance(k).unwrap());
        assert!((variance - 1.0).abs() < 1e-4, "{k}: {variance}");
        assert!((variance - twin[n - P + k][n - P + k]).abs() < 1e-4, "{k}");
    }
    // The first moments of upper arm and forearm share the masses beyond the elbow.
    let (upper, forearm) = (n - P + 1, n - P + 8);
    assert!(twin[upper][forearm] > 0.5, "{}", twin[upper][forearm]);
}

/// Row and noisy torque of an arm 10 % heavier than its description, on sines without common period, at most 2 rad/s.
fn row_and_torque(tick: u32, joint: usize, random: &mut Random) -> (LinearParameters<N, P>, f32) {
    let t = f64::from(tick) * 1e-3;
    let wave = |j: usize| {
        let w = 1.1 + 0.37 * j as f64;
        (w * t + j as f64, w)
    };
    let motion = JointMotion::<N> {
        q: JointVector::from_fn(|j, _| wave(j).0.sin() as f32),
        qd: JointVector::from_fn(|j, _| (wave(j).1 * wave(j).0.cos()) as f32),
        qdd: JointVector::from_fn(|j, _| (-wave(j).1.powi(2) * wave(j).0.sin()) as f32),
    };
    let mut tau = JointVector::<N>::zeros();
    let mut truth = LinearParameters::of(&ParameterSet::nominal::<Ur5>(1));
    truth.rigid = truth.rigid.map(|theta| 1.1 * theta);
    let row = torque_row::<Ur5, N, P>(joint, &ConditionedSample { motion, tau });
    truth.friction = [friction_truth().0; N];
    // The torque of a row is a mean.
    let noise = 0.01 * random.normal() / (AVERAGED as f64).sqrt();
    tau[joint] = row.dot(&truth) + noise as f32 * Ur5::LIMITS[joint].torque;
    (row, tau[joint])
}

#[test]
fn a_hundred_thousand_rows_agree_with_exact_arithmetic() {
    let config = LearnerConfig::<N, P>::for_arm::<Ur5>(1e-3);
    let prior = ParameterSet::nominal::<Ur5>(1);
    let (start, sigma) = (LinearParameters::of(&prior), config.sigma);
    let mut estimator = Estimator::<N, P>::new::<Ur5>(&prior);
    let n = start.iter().count();
    let wide = |numbers: &LinearParameters<N, P>| numbers.iter().copied().map(f64::from).collect();
    let mut twin = Twin {
        start: wide(&start),
        sigma: wide(&sigma),
        theta: std::vec![0.0; n],
        p: prior_covariance(n),
        variance: [f64::from(FIRST_VARIANCE); N],
        effective_rows: [f64::from(FIRST_ROWS); N],
        visits: [0; N],
    };
    let (mut worst, mut random) = (0.0f64, Random(7));
    for tick in 0..100_000 {
        let joint = tick as usize % N;
        let limit = Ur5::LIMITS[joint].torque;
        let (row, tau) = row_and_torque(tick, joint, &mut random);
        let factor = f64::from(config.noise_inflation);
        let before = estimator.correct(&config, joint, limit, &row, tau);
        assert!(before.is_some());
        let unit = f64::from(config.noise * limit);
        let mut innovation = f64::from(tau);
        let mut phi = Vec::with_capacity(n);
        let columns = row.iter().zip(start.iter()).zip(sigma.iter());
        for (((&row, &start), &sigma), theta) in columns.zip(&twin.theta) {
            let (row, sigma) = (f64::from(row), f64::from(sigma));
            innovation -= row * (f64::from(start) + sigma * theta);
            phi.push(row * sigma / unit);
        }
        let noise = f64::from(config.process_noise);
        twin.correct(joint, &phi, innovation / unit, noise, factor);
        if tick % 1000 == 999 {
            let numbers = estimator.parameters().iter().zip(start.iter());
            for (((&theta, &start), &sigma), twin) in numbers.zip(sigma.iter()).zip(&twin.theta) {
                let theta = (f64::from(theta) - f64::from(start)) / f64::from(sigma);
                worst = worst.max((theta - twin).abs());
            }
            assert!(estimator.filter().diagonal().iter().all(|&d| d > 0.0));
        }
    }
    std::println!("f32 and f64 at most {worst:.1e} prior standard deviations apart");
    // Rounding adds up in proportion to the rows at most: 1e-2 for a million.
    assert!(worst <= 1e-3, "{worst}");
}

#[test]
fn prediction_variance_is_that_of_a_row() {
    let mut filter = UdFilter::<N, P>::new();
    let mut gain = LinearParameters::filled(0.0);
    let mut random = Random(3);
    for tick in 0..600 {
        let joint = tick as usize % N;
        let (row, _) = row_and_torque(tick, joint, &mut random);
        filter.update(joint, &row, 1.0, &mut gain);
    }
    for joint in 0..N {
        let (mut phi, _) = row_and_torque(700 + joint as u32, joint, &mut random);
        phi.friction[joint] = friction_row(202.0, 0.4, 0.7, 2.0);
        let entries = phi.of_joint(joint).unwrap();
        let predicted = filter.prediction_variance(joint, &entries);
        let variance = { filter }.update(joint, &phi, 1.0, &mut gain);
        assert!(predicted > 1e-3, "{joint}: {predicted}");
        let error = (variance - 1.0 - predicted).abs();
        assert!(error < 1e-4 * variance, "{joint}: {predicted}");
    }
}

/// Row and torque of an arm without friction, as with a torque sensor behind the gear. A disturbance of 2 % of the limit
/// lasts for tenths of a second.
fn frictionless(
    tick: u32,
    joint: usize,
    random: &mut Random,
    drift: &mut f32,
) -> (LinearParameters<N, P>, f32) {
    let (row, _) = row_and_torque(tick, joint, random);
    let rigid = LinearParameters::of(&ParameterSet::nominal::<Ur5>(1))
        .rigid
        .map(|theta| 1.1 * theta);
    *drift = 0.98 * *drift + 0.02 * 6.0 * random.uniform() as f32;
    let tau = dot(&row.rigid, &rigid) + 0.02 * *drift * Ur5::LIMITS[joint].torque;
    (row, tau)
}

#[test]
fn friction_far_beyond_its_prior_is_learnt_in_a_second_of_rows() {
    // Joint 1 moves one way for a second, then the other way: without a reversal, friction and offset are one.
    let (config, joint) = (LearnerConfig::<N, P>::for_arm::<Ur5>(1e-3), 1);
    let limit = Ur5::LIMITS[joint].torque;
    let mut truth = LinearParameters::of(&ParameterSet::nominal::<Ur5>(1));
    let coulomb = FrictionColumn::Coulomb as usize;
    truth.friction[joint][coulomb] = 8.0 * config.sigma.friction[joint][coulomb];
    let mut estimator = Estimator::<N, P>::new::<Ur5>(&ParameterSet::nominal::<Ur5>(1));
    let mut random = Random(3);
    let mut error = f32::NAN;
    for row in 0..334 {
        let mut motion = JointMotion::<N>::zero();
        motion.qd[joint] = if row < 167 { 0.3 } else { -0.3 };
        let mut sample = ConditionedSample {
            motion,
            tau: JointVector::zeros(),
        };
        let columns = torque_row::<Ur5, N, P>(joint, &sample);
        sample.tau[joint] = columns.dot(&truth) + 0.003 * limit * random.normal() as f32;
        let corrected = estimator.correct(&config, joint, limit, &columns, sample.tau[joint]);
        assert!(corrected.is_some());
        error = columns.dot(&truth) - columns.dot(estimator.parameters());
    }
    assert!(error.abs() < 0.01 * limit, "{} of the limit", error / limit);
}

#[test]
fn friction_at_its_bound_leaves_correlated_columns_in_place() {
    let mut config = LearnerConfig::<N, P>::for_arm::<Ur5>(1e-3);
    for outlier_sigmas in [3.0, 1e6] {
        config.outlier_sigmas = outlier_sigmas;
        let prior = ParameterSet::nominal::<Ur5>(1);
        let sigma = config.sigma;
        let mut estimator = Estimator::<N, P>::new::<Ur5>(&prior);
        let (mut random, mut drifts) = (Random(5), [0.0; N]);
        let mut worst = 0.0f32;
        for tick in 0..240_000 {
            let joint = tick as usize % N;
            let limit = Ur5::LIMITS[joint].torque;
            let (row, tau) = frictionless(tick, joint, &mut random, &mut drifts[joint]);
            let correction = estimator.correct(&config, joint, limit, &row, tau);
            assert!(correction.is_some());
            let friction = estimator.parameters().friction[joint];
            for bound in &DISSIPATION_BOUNDS {
                let violation =
                    -dot(bound, &friction) / dot(&bound.map(f32::abs), &sigma.friction[joint]);
                assert!(
                    violation <= 1e-2,
                    "tick {tick}, joint {joint}: {friction:?}"
                );
            }
            if tick > 60_000 {
                worst = worst.max(friction[1] / limit);
            }
        }
        std::println!("Coulomb torque up to {worst:.4} of the limit");
        assert!(worst < 0.02, "{worst}");
    }
}

#[test]
fn process_noise_is_that_of_the_friction_and_constant_for_the_offset() {
    let config = LearnerConfig::<N, P>::for_arm::<Ur5>(1e-3);
    let limit = Ur5::LIMITS[0].torque;
    // Growth of the variances of Coulomb friction and offset of joint 0 in 500 rows of zeros, over the process noise.
    let growth = |friction: FrictionParameters| {
        let mut estimator = Estimator::<N, P>::new::<Ur5>(&ParameterSet::nominal::<Ur5>(1));
        let mut random = Random(5);
        for tick in (0..60_000).step_by(N) {
            let (row, tau) = row_and_torque(tick, 0, &mut random);
            let tau = tau + dot(&row.friction[0], &friction.0)
                - dot(&row.friction[0], &friction_truth().0);
            assert!(estimator.correct(&config, 0, limit, &row, tau).is_some());
        }
        let variances = |estimator: &Estimator<N, P>| {
            let variance = |column| estimator.filter().friction_variance(0, column as usize);
            [FrictionColumn::Coulomb, FrictionColumn::Offset]
                .map(|column| variance(column).unwrap())
        };
        let before = variances(&estimator);
        let config = LearnerConfig {
            process_noise: 1e-4,
            ..config
        };
        let nothing = LinearParameters::filled(0.0);
        for _ in 0..500 {
            let correction = estimator.correct(&config, 0, limit, &nothing, 0.0);
            assert!(correction.is_some());
        }
        let after = variances(&estimator);
        from_fn::<f32, 2, _>(|k| (after[k] - before[k]) / (500.0 * config.process_noise))
    };
    let prior = config.sigma.friction[0][FrictionColumn::Coulomb as usize];
    for (part, expected) in [(0.0, 0.0), (0.6, 0.36), (2.0, 1.0)] {
        let [coulomb, offset] =
            growth(FrictionParameters::NONE.with(FrictionColumn::Coulomb, part * prior));
        assert!((coulomb - expected).abs() < 0.1, "{part}: {coulomb}");
        assert!((offset - 1.0).abs() < 0.01, "{part}: {offset}");
    }
}
