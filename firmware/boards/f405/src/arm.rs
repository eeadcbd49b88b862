//! The arm of the images: the UR5, or that of the module that `FORETORQUE_ARM` named to the build; types that follow from
//! the arm of a board.
//!
//! `cargo xtask arm` writes such a module and sets the variable.

use crate::counter::Counter;
use crate::store_flash::StoreFlash;
use foretorque_link::session::{Housekeeping, Session};

/// Session of a board.
pub type BoardSession<A, const N: usize, const P: usize> = Session<A, N, P, Counter>;
/// Its housekeeping, with the store.
pub type BoardHousekeeping<A, const N: usize, const P: usize> = Housekeeping<A, N, P, StoreFlash>;

#[cfg(not(described_arm))]
pub use foretorque::arm::ur5::{JOINTS, Learner, PARAMETERS, Ur5 as Arm};

#[cfg(described_arm)]
include!(concat!(env!("OUT_DIR"), "/described_arm.rs"));
