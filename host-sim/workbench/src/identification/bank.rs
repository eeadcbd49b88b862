//! Identified parameters as a bank the board loads.

use super::cogging::CoggingAmplitudes;
use super::columns::Layout;
use super::methods::Fit;
use crate::robot::Robot;
use foretorque::arm::Arm;
use foretorque::dynamics::COGGING_COLUMNS;
use foretorque::feedforward::JointNetwork;
use foretorque::learning::ParameterSet;
use foretorque_link::bank::{NETWORK_SEED, ParameterBank};

/// The bank of a fit over columns the board has; `None` when the layout is not that of `A`.
///
/// Columns without a fit are zero and keep the deviation of an unidentified bank.
///
/// * `layout` the columns of `fit`
/// * `networks` one a joint; zero without
/// * `cogging` direct connections of the networks from the cogging phase, N·m: they go to the board's cogging columns
pub fn bank_of_fit<A: Arm<N, P>, const N: usize, const P: usize>(
    robot: &Robot,
    layout: &Layout,
    fit: &Fit,
    networks: Option<&[JointNetwork]>,
    cogging: Option<&CoggingAmplitudes>,
) -> Option<ParameterBank> {
    if layout.base != A::index().count {
        return None;
    }
    let mut set = ParameterSet::<N, P>::nominal::<A>(NETWORK_SEED);
    if let Some(networks) = networks {
        set.network = networks.try_into().ok()?;
    }
    let mut bank = ParameterBank::from_set::<A, N, P>(&set);
    let deviations = fit.deviations();
    for (place, parameter) in layout.parameters.iter().enumerate() {
        let mut columns = bank.columns.iter_mut();
        let column = columns.find(|column| column.id.to_string() == parameter.name)?;
        column.value = fit.theta[place] as f32;
        column.deviation = deviations[place] as f32;
    }
    for (joint, amplitudes) in cogging.iter().flat_map(|own| own.iter()).enumerate() {
        for (column, amplitude) in COGGING_COLUMNS.into_iter().zip(amplitudes) {
            let name = format!("{}{}", column.properties().symbol, joint + 1);
            let mut columns = bank.columns.iter_mut();
            let column = columns.find(|column| column.id.to_string() == name);
            // An arm without cogging has no such column and no amplitude either.
            match column {
                Some(column) => column.value += *amplitude as f32,
                None if *amplitude == 0.0 => (),
                None => return None,
            }
        }
    }
    for (gain, joint) in bank.drive_gains_nm_a.iter_mut().zip(&robot.joints) {
        *gain = joint.drive.gain as f32;
    }
    Some(bank)
}
