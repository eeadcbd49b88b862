//! The arm of the images, and the types that follow from it.

use foretorque_link::session::{Housekeeping, Mailboxes, Session};

use crate::counter::Counter;
use crate::store_flash::StoreFlash;

pub use crate::described::{
    Arm, JOINTS, Learner as BoardLearner, LearnerConfig, PARAMETERS, ParameterSet,
};

/// Session of a board.
pub type BoardSession = Session<Arm, JOINTS, PARAMETERS, Counter>;
/// Its housekeeping, with the store.
pub type BoardHousekeeping = Housekeeping<Arm, JOINTS, PARAMETERS, StoreFlash>;
/// Mailboxes between its tasks.
pub type BoardMailboxes = Mailboxes<JOINTS, PARAMETERS>;
