//! Inverse dynamics on the base parameters. Knows nothing of learning.

#[macro_use]
mod unroll;

mod closed_form;
mod friction;
mod link;
mod regressor;
mod rnea;
mod term;

pub use closed_form::{mass_matrix, velocity_torque};
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
pub use rnea::{gravity_torque, rnea, rnea_of};
pub use unroll::MAX_JOINTS;

use nalgebra::SVector;

/// The base parameters of an arm: links first, rotor inertias after them.
pub type BaseParameters<const P: usize> = SVector<f32, P>;
