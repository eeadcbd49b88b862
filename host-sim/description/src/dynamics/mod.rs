//! The reference dynamics: f64, in a formulation of its own, as a reference for the firmware's recursion.
//!
//! The firmware runs Newton–Euler in link frames with moments about link origins. Here nothing is passed from link to
//! link but world-frame kinematics: the Newton–Euler equations of every link, about its centre of mass, are projected on
//! the partial velocities of the joints (Kane and Levinson 1985, chapter 6).

mod base_parameters;
mod kane;
mod per_joint;
mod reference;

pub use base_parameters::{BaseMap, BaseMapTerm};
pub use base_parameters::{STATES, independent_columns, random_motions};
pub use kane::RigidBodies;
pub use per_joint::{Motion, PerJoint};
pub use reference::{Joints, ReferenceModel, State};

#[cfg(test)]
mod tests;
