//! Parameters of the board before it learns.

use foretorque::arm::Arm;
use foretorque::dynamics::FrictionColumn;
use foretorque::learning::ParameterSet;
use foretorque_link::bank::{NETWORK_SEED, ParameterBank};
use foretorque_workbench::robot::Robot;

/// The parameter bank of a robot as described: rigid body, viscous and Coulomb friction, networks with zero output.
///
/// Assumes: `robot` has the geometry of `A`; only its masses and friction may differ from the description.
pub fn bank_of<A: Arm<N, P>, const N: usize, const P: usize>(robot: &Robot) -> ParameterBank {
    let mut set = ParameterSet::<N, P>::nominal::<A>(NETWORK_SEED);
    for (place, value) in set.rigid.iter_mut().zip(robot.base_parameters()) {
        *place = value as f32;
    }
    for (place, joint) in set.friction.iter_mut().zip(&robot.joints) {
        place[FrictionColumn::Viscous] = joint.friction.viscous as f32;
        place[FrictionColumn::Coulomb] = joint.friction.coulomb as f32;
    }
    ParameterBank::from_set::<A, N, P>(&set)
}

#[cfg(test)]
mod tests {
    use super::*;
    use foretorque::arm::ur5::Ur5;

    #[test]
    fn the_bank_of_the_description_holds_the_nominal_parameters_of_the_firmware() {
        let robot = Robot::load("ur5").expect("built in");
        let set = bank_of::<Ur5, 6, 40>(&robot)
            .set::<Ur5, 6, 40>()
            .expect("a bank for this arm");
        for (found, nominal) in set.rigid.iter().zip(<Ur5 as Arm<6, 40>>::NOMINAL) {
            assert!((found - nominal).abs() <= 1e-6 * nominal.abs().max(1.0));
        }
        assert_eq!(set.friction[0][FrictionColumn::Coulomb], 7.0);
    }
}
