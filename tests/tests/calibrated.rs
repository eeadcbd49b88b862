//! An arm whose geometry has no round numbers: the kernels must not depend on the zeros of a data sheet.

use acceptance::arms::description;
use acceptance::arms::ur5_calibrated::{JOINTS, PARAMETERS, Ur5Calibrated};
use foretorque::arm::Arm;
use foretorque::dynamics::{BaseParameters, regressor, rnea};
use foretorque::joint::{JointMotion, JointVector};
use foretorque_workbench::dynamics::{ReferenceModel, State};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn torque_and_regressor_hold_without_structural_zeros() {
    let model = ReferenceModel::<JOINTS>::new(&description(Ur5Calibrated::NAME)).unwrap();
    let beta = BaseParameters::<PARAMETERS>::from_row_slice(&Ur5Calibrated::NOMINAL);
    let mut random = ChaCha8Rng::seed_from_u64(31);
    let mut draw =
        |size: f32| JointVector::<JOINTS>::from_fn(|_, _| random.random_range(-size..=size));
    for _ in 0..20_000 {
        let motion = JointMotion {
            q: draw(core::f32::consts::TAU),
            qd: draw(core::f32::consts::PI),
            qdd: draw(10.0),
        };
        let truth = model.inverse_dynamics(&State {
            q: motion.q.map(f64::from),
            qd: motion.qd.map(f64::from),
            qdd: motion.qdd.map(f64::from),
        });
        let tau = rnea::<Ur5Calibrated, JOINTS, PARAMETERS>(&beta, &motion);
        let rows = regressor::<Ur5Calibrated, JOINTS, PARAMETERS>(&motion) * beta;
        for (joint, limits) in Ur5Calibrated::LIMITS.iter().enumerate() {
            let allowed = 1e-6 * f64::from(limits.torque);
            let error = (f64::from(tau[joint]) - truth[joint]).abs();
            assert!(error <= allowed, "joint {}: {error}", joint + 1);
            let error = (f64::from(rows[joint]) - truth[joint]).abs();
            assert!(error <= allowed, "regressor {}: {error}", joint + 1);
        }
    }
}
