//! Inverse dynamics on the base parameters. Independent of learning.

/// Most joints of an arm: as often the bodies below are written out.
pub const MAX_JOINTS: usize = 8;

macro_rules! each {
    ($i:ident < $n:ident $body:block, $($joint:literal)*) => {
        $({
            const $i: usize = $joint;
            if $i < $n $body
        })*
    };
}

/// `outward!(A: I < N { body })` runs the body for joint I = 0 to N − 1. For a compiled arm `I` is a constant each time,
/// so that everything the arm's geometry fixes is settled while compiling; for one that is read it is a loop.
macro_rules! outward {
    ($arm:ident: $i:ident < $n:ident $body:block) => {
        if const { $arm::COMPILED.is_some() } {
            each!($i < $n $body, 0 1 2 3 4 5 6 7);
        } else {
            for joint in 0..$n {
                #[expect(non_snake_case, reason = "the name of the constant")]
                let $i = joint;
                $body
            }
        }
    };
}

/// Loop as [`outward`] from joint N − 1 down to 0.
macro_rules! inward {
    ($arm:ident: $i:ident < $n:ident $body:block) => {
        if const { $arm::COMPILED.is_some() } {
            each!($i < $n $body, 7 6 5 4 3 2 1 0);
        } else {
            for joint in (0..$n).rev() {
                #[expect(non_snake_case, reason = "the name of the constant")]
                let $i = joint;
                $body
            }
        }
    };
}

mod friction;
mod link;
mod regressor;
mod rnea;
mod term;

pub use friction::{
    COGGING_COLUMNS, DISSIPATION_BOUNDS, FRICTION_COLUMNS, FrictionBound, FrictionColumn,
    FrictionParameters, FrictionPoint, FrictionPrior, FrictionProperties, Pose,
    RANDOM_WALK_COLUMNS, Real, SHEAR_WIDTH, SIGN_WIDTH, STRIBECK_WIDTH, SmoothedSign, cogging,
    friction, friction_load, friction_prior, friction_row, friction_under,
};
pub use link::{Angles, is_angle};
pub(crate) use regressor::regressor_row_at;
pub use regressor::{regressor, regressor_row};
pub(crate) use rnea::gravity_torque_at;
pub use rnea::{gravity_torque, mass_matrix, rnea, rnea_of, velocity_torque};

use nalgebra::SVector;

/// The base parameters of an arm: links first, rotor inertias after them.
pub type BaseParameters<const P: usize> = SVector<f32, P>;
