//! The arm of the images: the UR5, or that of the module that `FORETORQUE_ARM` named to the build.
//!
//! `cargo xtask arm` writes such a module and sets the variable.

#[cfg(not(described_arm))]
pub use foretorque::arm::ur5::{JOINTS, Learner, PARAMETERS, Ur5 as Arm};

#[cfg(described_arm)]
include!(concat!(env!("OUT_DIR"), "/described_arm.rs"));
