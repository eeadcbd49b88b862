//! The board's f32 dynamics: physical identities for every arm, with seeded random geometry too, and the host's f64 reference.

use crate::oracle::{LIMIT_SHARE, UR5_TOLERANCE};
use crate::{description, each_arm};
use foretorque::arm::{Arm, ur5::Ur5};
use foretorque::dynamics::{BaseParameters, gravity_torque, regressor, regressor_row, rnea};
use foretorque::joint::{JointMotion, JointVector};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::robot::Robot;
use nalgebra::SMatrix;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Random states of each arm.
const STATES: usize = 100;

/// Step of the central differences of the energy, rad and s: truncation about h² = 1e-10, rounding 1e-14 / h = 1e-9,
/// both far below f32.
const STEP: f64 = 1e-5;

/// The board's torque of an arm at its nominal parameters, widened to f64.
fn torque<A: Arm<N, P>, const N: usize, const P: usize>(
    q: &JointVector<N>,
    qd: &JointVector<N>,
    qdd: &JointVector<N>,
) -> Joints<N> {
    let beta = BaseParameters::<P>::from_fn(|k, _| A::NOMINAL[k]);
    let (q, qd, qdd) = (*q, *qd, *qdd);
    let motion = JointMotion { q, qd, qdd };
    rnea::<A, N, P>(&beta, &motion).map(f64::from)
}

/// Allowed error of `torques` f32 torques added up, N·m.
fn tolerance<A: Arm<N, P>, const N: usize, const P: usize>(torques: f64) -> Joints<N> {
    Joints::from_fn(|joint, _| torques * LIMIT_SHARE * f64::from(A::LIMITS[joint].torque))
}

fn close<const N: usize>(a: &Joints<N>, b: &Joints<N>, tolerance: &Joints<N>) -> bool {
    // Written so that not a number is not close.
    (0..N).all(|joint| (a[joint] - b[joint]).abs() <= tolerance[joint])
}

/// Draws q, q̇, q̈ within ±π rad, ±π rad/s, ±10 rad/s².
fn states<const N: usize>() -> impl Iterator<Item = [JointVector<N>; 3]> {
    use core::f32::consts::PI;
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut draw =
        move |size: f32| JointVector::<N>::from_fn(|_, _| random.random_range(-size..=size));
    (0..STATES).map(move |_| [draw(PI), draw(PI), draw(10.0)])
}

fn has_a_mass_matrix<A: Arm<N, P>, const N: usize, const P: usize>() {
    // Large, so that differences of torques keep their digits.
    let push = 10.0_f32;
    for [q, ..] in states::<N>() {
        let zero = JointVector::zeros();
        let still = torque::<A, N, P>(&q, &zero, &zero);
        let mut mass = SMatrix::<f64, N, N>::zeros();
        for joint in 0..N {
            let mut qdd = zero;
            qdd[joint] = push;
            let column = (torque::<A, N, P>(&q, &zero, &qdd) - still) / f64::from(push);
            mass.set_column(joint, &column);
        }
        let allowed = tolerance::<A, N, P>(2.0) / f64::from(push);
        for i in 0..N {
            for j in 0..i {
                let error = (mass[(i, j)] - mass[(j, i)]).abs();
                let symmetric = error <= allowed[i] + allowed[j];
                assert!(symmetric, "{} M{i}{j}: {error:e}", A::NAME);
            }
        }
        let symmetric = (mass + mass.transpose()) * 0.5;
        let definite = symmetric.cholesky().is_some();
        assert!(definite, "{}: M is not positive definite", A::NAME);
    }
}

fn gravity_is_a_gradient<A: Arm<N, P>, const N: usize, const P: usize>() {
    let model = ReferenceModel::<N>::new(&description(A::NAME)).expect("the arm's own size");
    for [q, ..] in states::<N>() {
        let zero = JointVector::zeros();
        let wide = q.map(f64::from);
        let gradient = Joints::<N>::from_fn(|joint, _| {
            let mut step = Joints::<N>::zeros();
            step[joint] = STEP;
            let energy = |q| model.energy(&q, &Joints::zeros());
            (energy(wide + step) - energy(wide - step)) / (2.0 * STEP)
        });
        let of_gravity = gravity_torque::<A, N, P>(&A::NOMINAL.into(), &q).map(f64::from);
        for tau in [torque::<A, N, P>(&q, &zero, &zero), of_gravity] {
            let same = close(&tau, &gradient, &tolerance::<A, N, P>(1.0));
            assert!(same, "{} {q}", A::NAME);
        }
    }
}

fn power_is_balanced<A: Arm<N, P>, const N: usize, const P: usize>() {
    let model = ReferenceModel::<N>::new(&description(A::NAME)).expect("the arm's own size");
    for [q, qd, qdd] in states::<N>() {
        let power = torque::<A, N, P>(&q, &qd, &qdd).dot(&qd.map(f64::from));
        let (q, qd, qdd) = (q.map(f64::from), qd.map(f64::from), qdd.map(f64::from));
        let energy = |t: f64| model.energy(&(q + qd * t + qdd * (0.5 * t * t)), &(qd + qdd * t));
        let change = (energy(STEP) - energy(-STEP)) / (2.0 * STEP);
        let balanced = (power - change).abs() <= tolerance::<A, N, P>(1.0).dot(&qd.abs());
        assert!(balanced, "{}: {power} W, {change} W", A::NAME);
    }
}

fn nothing_weighs_nothing<A: Arm<N, P>, const N: usize, const P: usize>() {
    for [q, qd, qdd] in states::<N>() {
        let tau = rnea::<A, N, P>(&BaseParameters::zeros(), &JointMotion { q, qd, qdd });
        assert_eq!(tau, JointVector::<N>::zeros(), "{}", A::NAME);
    }
}

#[test]
fn mass_matrix_is_symmetric_and_positive_definite() {
    each_arm!(has_a_mass_matrix);
}

#[test]
fn torque_at_rest_is_the_gradient_of_the_potential() {
    each_arm!(gravity_is_a_gradient);
}

#[test]
fn power_of_the_torques_is_the_change_of_energy() {
    each_arm!(power_is_balanced);
}

#[test]
fn arm_without_mass_needs_no_torque() {
    each_arm!(nothing_weighs_nothing);
}

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
    for robot in [ur5.clone(), ur5.perturbed(1)] {
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
                assert!(error <= UR5_TOLERANCE[j], "joint {}: {error}", j + 1);
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
            assert!(error <= UR5_TOLERANCE[j], "joint {}: {error}", j + 1);
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
