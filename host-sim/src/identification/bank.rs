//! Identified parameters as a bank the board loads.

use super::columns::Layout;
use crate::robot::Robot;
use foretorque::arm::Arm;
use foretorque::dynamics::FrictionParameters;
use foretorque::edge::bank::{NETWORK_SEED, ParameterBank};
use foretorque::feedforward::JointNetwork;
use foretorque::learning::ParameterSet;
use nalgebra::DVector;

/// The bank of a fit over the plain columns; `None` when the layout is not that of `A`.
///
/// * `theta`, `deviations` values and standard deviations in the order of `plain`, SI
/// * `networks` one a joint, or none: then they say nothing
pub fn bank_of_fit<A: Arm<N, P>, const N: usize, const P: usize>(
    robot: &Robot,
    plain: &Layout<N>,
    theta: &DVector<f64>,
    deviations: &DVector<f64>,
    networks: Option<&[JointNetwork; N]>,
) -> Option<ParameterBank> {
    let mut set = ParameterSet::<N, P>::nominal::<A>(NETWORK_SEED);
    if plain.base != P || plain.parameters.len() != P + 2 * N {
        return None;
    }
    for (place, value) in set.rigid.iter_mut().zip(theta.iter()) {
        *place = *value as f32;
    }
    for (joint, friction) in set.friction.iter_mut().enumerate() {
        *friction = FrictionParameters {
            viscous: theta[P + 2 * joint] as f32,
            coulomb: theta[P + 2 * joint + 1] as f32,
            ..FrictionParameters::NONE
        };
    }
    if let Some(networks) = networks {
        set.network = *networks;
    }
    let mut bank = ParameterBank::from_set::<A, N, P>(&set);
    // Columns that were not fitted keep the doubt of a bank nobody has identified.
    for (parameter, deviation) in plain.parameters.iter().zip(deviations.iter()) {
        let mut columns = bank.columns.iter_mut();
        let column = columns.find(|column| column.id.to_string() == parameter.name)?;
        column.deviation = *deviation as f32;
    }
    for (gain, joint) in bank.drive_gains_nm_a.iter_mut().zip(&robot.joints) {
        *gain = joint.drive.gain as f32;
    }
    Some(bank)
}
