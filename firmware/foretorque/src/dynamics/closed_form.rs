//! The closed form of the dynamics, `tau = M(q) qdd + V(q, qd) + G(q)` (eq. 12).
//!
//! The paper prints θ̇ where M multiplies θ̈; Craig 2005, eq. 6.59, has it right. The tick does not need the sum:
//! its torque comes from [`rnea`] in one go, and G alone is what friction is reckoned with. M and V are for whoever designs
//! or checks a controller.

use super::{BaseParameters, gravity_torque, rnea};
use crate::arm::Arm;
use crate::joint::{JointMotion, JointVector};
use nalgebra::SMatrix;

/// Mass matrix M(q), N × N, kg·m²: column j is what a unit acceleration of joint j adds to the torque at rest
/// (Walker and Orin 1982, method 1).
///
/// Limits: an angle beyond ±1000 rad or NaN makes every entry NaN.
/// Cost: N passes of [`rnea`] and one of [`gravity_torque`].
pub fn mass_matrix<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    q: &JointVector<N>,
) -> SMatrix<f32, N, N> {
    let mut motion = at_rest(q);
    let gravity = gravity_torque::<A, N, P>(beta, q);
    let mut mass = SMatrix::<f32, N, N>::zeros();
    for (joint, mut column) in mass.column_iter_mut().enumerate() {
        motion.qdd = JointVector::from_fn(|k, _| if k == joint { 1.0 } else { 0.0 });
        column.copy_from(&(rnea::<A, N, P>(beta, &motion) - gravity));
    }
    mass
}

/// Centrifugal and Coriolis torques V(q, qd), N × N·m.
///
/// Cost: one pass of [`rnea`] and one of [`gravity_torque`].
pub fn velocity_torque<A: Arm<N, P>, const N: usize, const P: usize>(
    beta: &BaseParameters<P>,
    q: &JointVector<N>,
    qd: &JointVector<N>,
) -> JointVector<N> {
    let moving = JointMotion {
        qd: *qd,
        ..at_rest(q)
    };
    rnea::<A, N, P>(beta, &moving) - gravity_torque::<A, N, P>(beta, q)
}

fn at_rest<const N: usize>(q: &JointVector<N>) -> JointMotion<N> {
    JointMotion {
        q: *q,
        ..JointMotion::zero()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{JOINTS, PARAMETERS, Ur5};

    fn motion(seed: u32) -> JointMotion<JOINTS> {
        let wave = |shift: f32, size: f32| {
            JointVector::from_fn(|joint, _| {
                size * (seed as f32 * 1.7 + joint as f32 * 2.3 + shift).sin()
            })
        };
        JointMotion {
            q: wave(0.0, 3.0),
            qd: wave(1.0, 3.0),
            qdd: wave(2.0, 10.0),
        }
    }

    #[test]
    fn the_parts_of_the_closed_form_add_up_to_the_torque() {
        let beta = BaseParameters::<PARAMETERS>::from(Ur5::NOMINAL);
        for seed in 0..200 {
            let JointMotion { q, qd, qdd } = motion(seed);
            let sum = mass_matrix::<Ur5, JOINTS, PARAMETERS>(&beta, &q) * qdd
                + velocity_torque::<Ur5, JOINTS, PARAMETERS>(&beta, &q, &qd)
                + gravity_torque::<Ur5, JOINTS, PARAMETERS>(&beta, &q);
            let tau = rnea::<Ur5, JOINTS, PARAMETERS>(&beta, &motion(seed));
            // A few roundings of torques up to 150 N·m, carried from M by accelerations up to 10 rad/s².
            assert!((sum - tau).amax() < 1e-3, "{}", (sum - tau).amax());
        }
    }

    #[test]
    fn the_mass_matrix_is_symmetric_and_every_motion_has_energy() {
        let beta = BaseParameters::<PARAMETERS>::from(Ur5::NOMINAL);
        for seed in 0..200 {
            let mass = mass_matrix::<Ur5, JOINTS, PARAMETERS>(&beta, &motion(seed).q);
            assert!((mass - mass.transpose()).amax() < 1e-4);
            assert!((0..64).all(|k| motion(k).qd.dot(&(mass * motion(k).qd)) > 0.0));
        }
    }

    #[test]
    fn a_joint_at_rest_feels_no_velocity_torque() {
        let beta = BaseParameters::<PARAMETERS>::from(Ur5::NOMINAL);
        let still = JointVector::<JOINTS>::zeros();
        let torque = velocity_torque::<Ur5, JOINTS, PARAMETERS>(&beta, &motion(3).q, &still);
        assert_eq!(torque, still);
    }
}
