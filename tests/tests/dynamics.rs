//! The firmware's f32 dynamics against the host's f64 reference.

use foretorque::arm::{Arm, ur5::Ur5};
use foretorque::dynamics::{BaseParameters, regressor, regressor_row, rnea};
use foretorque::joint::{JointMotion, JointVector};
use foretorque_workbench::dynamics::{ReferenceModel, State};
use foretorque_workbench::robot::{Perturbation, Robot};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Largest torque error allowed, N·m: three decimal places below the friction of the joint.
const TORQUE_TOLERANCE: [f64; 6] = [1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5];

fn random_motion(random: &mut ChaCha8Rng) -> JointMotion<6> {
    let mut draw = |size: f32| JointVector::<6>::from_fn(|_, _| random.random_range(-size..=size));
    JointMotion {
        q: draw(core::f32::consts::TAU),
        qd: draw(core::f32::consts::PI),
        qdd: draw(10.0),
    }
}

#[test]
fn rnea_agrees_with_the_reference_over_random_states() {
    let ur5 = Robot::load("ur5").unwrap();
    for robot in [ur5.clone(), ur5.perturbed(1, &Perturbation::PLANT)] {
        let beta = robot.base_parameters();
        let beta = BaseParameters::<40>::from_fn(|k, _| beta[k] as f32);
        let model = ReferenceModel::<6>::new(&robot).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(20);
        for _ in 0..100_000 {
            let motion = random_motion(&mut random);
            let truth = model.inverse_dynamics(&State {
                q: motion.q.map(f64::from),
                qd: motion.qd.map(f64::from),
                qdd: motion.qdd.map(f64::from),
            });
            let tau = rnea::<Ur5, 6, 40>(&beta, &motion).map(f64::from);
            for j in 0..6 {
                let error = (tau[j] - truth[j]).abs();
                assert!(error <= TORQUE_TOLERANCE[j], "joint {}: {error}", j + 1);
            }
        }
    }
}

#[test]
fn the_regressor_times_base_parameters_is_the_torque_and_its_rows_are_the_single_rows() {
    let beta = BaseParameters::<40>::from_row_slice(&Ur5::NOMINAL);
    let mut random = ChaCha8Rng::seed_from_u64(25);
    for _ in 0..10_000 {
        let motion = random_motion(&mut random);
        let rows = regressor::<Ur5, 6, 40>(&motion);
        let errors = (rows * beta - rnea::<Ur5, 6, 40>(&beta, &motion)).map(f64::from);
        for j in 0..6 {
            let error = errors[j].abs();
            assert!(error <= TORQUE_TOLERANCE[j], "joint {}: {error}", j + 1);
            // The same operations in the same order: the same bits.
            let row = regressor_row::<Ur5, 6, 40>(j, &motion);
            assert_eq!(rows.row(j).transpose(), row);
        }
    }
}

#[test]
fn an_angle_that_is_no_angle_gives_no_torque() {
    let beta = BaseParameters::<40>::from_row_slice(&Ur5::NOMINAL);
    for angle in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1001.0] {
        for joint in 0..6 {
            let mut motion = JointMotion::zero();
            motion.q[joint] = angle;
            let tau = rnea::<Ur5, 6, 40>(&beta, &motion);
            assert!(tau.iter().all(|torque| torque.is_nan()));
        }
    }
}

#[test]
fn torques_at_rest_and_without_gravity_share_are_zero() {
    // Only inertias, no first moments: an arm at rest needs no torque.
    let mut beta = BaseParameters::<40>::from_row_slice(&Ur5::NOMINAL);
    for link in 1..6 {
        beta[7 * link - 6] = 0.0;
        beta[7 * link - 5] = 0.0;
    }
    let motion = JointMotion {
        q: JointVector::<6>::new(0.3, -1.2, 0.8, 2.0, -0.4, 1.0),
        ..JointMotion::zero()
    };
    assert_eq!(rnea::<Ur5, 6, 40>(&beta, &motion).amax(), 0.0);
}
