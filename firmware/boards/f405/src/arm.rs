//! The arm of the images: the UR5, or that of the module that `FORETORQUE_ARM` named to the build; types that follow from
//! it.
//!
//! `cargo xtask arm` writes such a module and sets the variable.

use crate::counter::Counter;
use crate::store_flash::StoreFlash;
use foretorque_link::session::{Housekeeping, Mailboxes, Session};

/// Session of a board.
pub type BoardSession = Session<Arm, JOINTS, PARAMETERS, Counter>;
/// Its housekeeping, with the store.
pub type BoardHousekeeping = Housekeeping<Arm, JOINTS, PARAMETERS, StoreFlash>;
/// What its tick shares with the tasks below.
pub type BoardMailboxes = Mailboxes<JOINTS, PARAMETERS>;

#[cfg(not(described_arm))]
pub use foretorque::arm::ur5::{JOINTS, Learner, PARAMETERS, Ur5 as Arm};

#[cfg(described_arm)]
include!(concat!(env!("OUT_DIR"), "/described_arm.rs"));
