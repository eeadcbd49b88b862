use super::*;
use crate::Random;
use crate::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use crate::dynamics::{DISSIPATION_BOUNDS, FrictionColumn, FrictionParameters};
use crate::joint::{JointMotion, JointVector};
use crate::learning::conditioning::AVERAGED;
use crate::learning::parameters::dot;
use crate::sines;
use core::array::from_fn;
use nalgebra::{DMatrix, SVector};

const WIDTH: usize = FRICTION_COLUMNS;

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
fn an_outlier_moves_the_estimate_by_a_bounded_step_and_teaches_no_certainty() {
    let config = LearnerConfig::<N, P>::for_arm::<Ur5>(1e-3);
    let prior = ParameterSet::nominal::<Ur5>(1);
    let limit = Ur5::LIMITS[0].torque;
    let (row, tau) = row_and_torque(0, 0, &mut Random(7));
    let corrected = |off: f32| {
        let mut estimator = Estimator::<N, P>::new::<Ur5>(&prior);
        let before = *estimator.filter().diagonal();
        let correction = estimator.correct(&config, 0, limit, &row, tau + off * limit);
        assert!(correction.is_some());
        let is_kept = before == *estimator.filter().diagonal();
        (*estimator.parameters(), is_kept)
    };
    let (near, far) = (corrected(0.0), corrected(100.0));
    assert!(near.0 != far.0 && !near.1 && far.1);
    assert!(far.0 == corrected(10_000.0).0);
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
