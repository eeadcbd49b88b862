//! The world of arms as a table.

use crate::StudyError;
use foretorque_workbench::robot::{Perturbation, Robot};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// One arm: name, description, and the kind of arm it stands for.
#[derive(Debug)]
pub(super) struct WorldArm {
    pub(super) name: &'static str,
    text: &'static str,
    pub(super) kind: &'static str,
}

macro_rules! arms {
    ($($name:literal, $file:literal, $kind:literal;)*) => {
        &[$(WorldArm { name: $name, text: include_str!(concat!("../../../robots/", $file)), kind: $kind }),*]
    };
}

/// All arms. Masses of the true arm differ from the description by up to 20 %.
pub(super) const ARMS: &[WorldArm] = arms! {
    "ur5", "ur5.toml", "industrial, 6 joints, data sheet";
    "panda", "panda.urdf", "7 joints, URDF without rotors and friction";
    "iiwa", "iiwa.toml", "7 joints, LWR class, no rotors and friction";
    "gen3", "gen3.toml", "7 light joints, Gen3 class, no rotors and friction";
    "ur10e", "ur10e.toml", "industrial, 6 joints, data sheet, guessed rotors";
    "mit6", "mit6.toml", "6 low-ratio MIT actuators, little friction";
    "small5", "small5.toml", "5 hobby servos, much friction";
    "eight", "eight.toml", "8 joints, no rotors and friction";
};

/// Largest relative error of a rotor inertia that is described, and range of those that are not, rad/s²: the torque limit
/// over the inertia.
const ROTOR_ERROR: f64 = 0.25;
/// Friction of joints whose description has none: Coulomb, share of the torque limit; viscous, the same at the speed limit.
const COULOMB_SHARE: f64 = 0.04;
const VISCOUS_SHARE: f64 = 0.06;

impl WorldArm {
    /// The arm as described.
    pub(super) fn described(&self) -> Result<Robot, StudyError> {
        Ok(Robot::parse(self.name, self.text)?)
    }

    /// The description without friction, and without rotors where `described` gives them for certain: what a URDF has.
    pub(super) fn bare(described: &Robot, guessed_rotors: bool) -> Robot {
        let mut bare = described.clone();
        for joint in &mut bare.joints {
            (joint.friction.viscous, joint.friction.coulomb) = (0.0, 0.0);
            if !guessed_rotors {
                joint.drive.rotor_inertia = 0.0;
            }
        }
        bare
    }

    /// The arm as it is.
    pub(super) fn truth(described: &Robot, seed: u64) -> Robot {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(7);
        let (robot, _) = described.with_assumed_rotors();
        let mut truth = robot.perturbed(seed, &Perturbation::PLANT);
        for joint in &mut truth.joints {
            joint.drive.rotor_inertia *= 1.0 + ROTOR_ERROR * random.random_range(-1.0..1.0);
            let (limits, friction) = (joint.limits, &mut joint.friction);
            if friction.coulomb <= 0.0 {
                friction.coulomb = COULOMB_SHARE * limits.torque * random.random_range(0.7..1.3);
                friction.viscous = VISCOUS_SHARE * limits.torque / limits.velocity;
                (friction.stribeck_ratio, friction.stribeck_velocity) = (0.25, 0.1);
            }
        }
        truth
    }
}
