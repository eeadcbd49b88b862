use super::noise::EFFECTIVE_ROWS;
use super::*;
use crate::Random;
use crate::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use crate::dynamics::{DISSIPATION_BOUNDS, FrictionColumn, FrictionParameters};
use crate::joint::{JointMotion, JointVector};
use crate::learning::conditioning::AVERAGED;
use crate::learning::parameters::dot;
use crate::sines;
use core::array::from_fn;
use nalgebra::{DMatrix, DVector, SVector};

const WIDTH: usize = FRICTION_COLUMNS;

/// Reference filter on the plain covariance, in f64. Parameters in prior standard deviations from the start.
struct Twin {
    start: DVector<f64>,
    sigma: DVector<f64>,
    theta: DVector<f64>,
    p: DMatrix<f64>,
    variance: [f64; N],
    effective_rows: [f64; N],
    visits: [usize; N],
}

impl Twin {
    fn correct(
        &mut self,
        joint: usize,
        phi: &DVector<f64>,
        innovation: f64,
        process_noise: f64,
        factor: f64,
    ) {
        let turn = self.visits[joint] % RANDOM_WALK_COLUMNS.len();
        let column = RANDOM_WALK_COLUMNS[turn];
        let k = WIDTH * joint + column as usize;
        self.visits[joint] += 1;
        let variance = self.p[(k, k)];
        if variance < 1.0 {
            let mean = self.start[k] / self.sigma[k] + self.theta[k];
            let square = match column {
                FrictionColumn::Offset => 1.0,
                _ => (mean * mean + variance).min(1.0),
            };
            self.p[(k, k)] += RANDOM_WALK_COLUMNS.len() as f64 * process_noise * square;
        }
        let gain = &self.p * phi;
        let total = gain.dot(phi) + factor * self.variance[joint];
        let s = total - (factor - 1.0) * self.variance[joint];
        let z = innovation / s.sqrt();
        if z.abs() <= 3.0 {
            self.p.ger(-1.0 / total, &gain, &gain, 1.0);
        }
        let up = z.abs() > 0.6745;
        let mut step = 1.005;
        if self.effective_rows[joint] < f64::from(EFFECTIVE_ROWS) {
            self.effective_rows[joint] += self.variance[joint] / s;
            step = 1.0 + 2.3 * self.variance[joint] / s / self.effective_rows[joint];
        }
        self.variance[joint] *= if up { step } else { 1.0 / step };
        self.theta += gain * (z.clamp(-3.0, 3.0) * s.sqrt() / total);
        self.project(WIDTH * joint);
    }

    /// Most likely estimate within the bounds of the friction columns from `first` on.
    fn project(&mut self, first: usize) {
        const BOUNDS: usize = DISSIPATION_BOUNDS.len();
        let mut directions = DMatrix::zeros(self.theta.len(), BOUNDS);
        for (mut direction, bound) in directions.column_iter_mut().zip(&DISSIPATION_BOUNDS) {
            direction
                .rows_mut(first, WIDTH)
                .copy_from(&SVector::from(*bound).cast());
        }
        let friction = &self.start + self.sigma.component_mul(&self.theta);
        let mut values = directions.tr_mul(&friction);
        for (mut direction, value) in directions.column_iter_mut().zip(values.iter_mut()) {
            direction.component_mul_assign(&self.sigma);
            *value /= direction.normalize_mut();
        }
        if values.iter().all(|&value| value > -1e-4) {
            return;
        }
        let images = &self.p * &directions;
        let products = directions.tr_mul(&images);
        let mut lambda = DVector::zeros(BOUNDS);
        for _ in 0..10_000 {
            let before = lambda.clone();
            for i in 0..BOUNDS {
                let inside = values[i] + products.column(i).dot(&lambda);
                lambda[i] = f64::max(lambda[i] - inside / products[(i, i)], 0.0);
            }
            if (&lambda - before).amax() < 1e-9 {
                break;
            }
        }
        self.theta += images * lambda;
    }
}

/// Numbers in f64, friction first.
fn wide(numbers: &LinearParameters<N, P>) -> DVector<f64> {
    DVector::from_iterator(WIDTH * N + P, numbers.iter().copied().map(f64::from))
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
fn prior_covariance() -> DMatrix<f64> {
    let mut covariance = DMatrix::identity(WIDTH * N + P, WIDTH * N + P);
    let mut rigid = covariance.view_mut((WIDTH * N, WIDTH * N), (P, P));
    rigid.set_diagonal(&SVector::from(prior_floor::<Ur5, N, P>()).cast());
    for factor in (0..).map_while(prior_factor::<Ur5, N, P>) {
        let factor = SVector::from(factor).cast::<f64>();
        rigid += factor * factor.transpose();
    }
    covariance
}

#[test]
fn the_initial_covariance_is_that_of_the_prior_factors() {
    let prior = ParameterSet::nominal::<Ur5>(1);
    let estimator = Estimator::<N, P>::new::<Ur5>(&prior);
    let twin = prior_covariance();
    let first = WIDTH * N;
    for k in 0..P {
        let variance = f64::from(estimator.filter().rigid_variance(k).unwrap());
        assert!((variance - 1.0).abs() < 1e-4, "{k}: {variance}");
        let exact = twin[(first + k, first + k)];
        assert!((variance - exact).abs() < 1e-4, "{k}");
    }
    // The first moments of upper arm and forearm share the masses beyond the elbow.
    let shared = twin[(first + 1, first + 8)];
    assert!(shared > 0.5, "{shared}");
}

/// Row and noisy torque of an arm 10 % heavier than its description, on sines without common period, at most 2 rad/s.
fn row_and_torque(tick: u32, joint: usize, random: &mut Random) -> (LinearParameters<N, P>, f32) {
    let motion = sines::<N>(1e-3 * f64::from(tick), |j| {
        [1.0, 1.1 + 0.37 * j as f64, j as f64]
    });
    let mut tau = JointVector::<N>::zeros();
    let row = torque_row::<Ur5, N, P>(joint, &ConditionedSample { motion, tau });
    let truth = LinearParameters {
        friction: [friction_truth().0; N],
        rigid: Ur5::NOMINAL.map(|theta| 1.1 * theta),
    };
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
    let mut twin = Twin {
        start: wide(&start),
        sigma: wide(&sigma),
        theta: DVector::zeros(WIDTH * N + P),
        p: prior_covariance(),
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
        let row = wide(&row);
        let expected = row.dot(&(&twin.start + twin.sigma.component_mul(&twin.theta)));
        let innovation = (f64::from(tau) - expected) / unit;
        let phi = row.component_mul(&twin.sigma) / unit;
        let noise = f64::from(config.process_noise);
        twin.correct(joint, &phi, innovation, noise, factor);
        if tick % 1000 == 999 {
            let theta = (wide(estimator.parameters()) - &twin.start).component_div(&twin.sigma);
            worst = worst.max((theta - &twin.theta).amax());
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
    let rigid = Ur5::NOMINAL.map(|theta| 1.1 * theta);
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
