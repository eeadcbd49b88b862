//! The arm of the images: the UR5, or that of the module that `FORETORQUE_ARM` named to the build; types that follow from
//! it.
//!
//! `cargo xtask arm` writes such a module and sets the variable.

use core::mem::MaybeUninit;

use crate::counter::Counter;
use crate::flash_driver::StoreFlash;
use foretorque::learning::{ParameterSet, StartDeviations};
use foretorque_link::session::{Housekeeping, Mailboxes, Session};

/// Session of a board.
pub type BoardSession = Session<Arm, JOINTS, PARAMETERS, Counter>;
/// Its housekeeping, with the store.
pub type BoardHousekeeping = Housekeeping<Arm, JOINTS, PARAMETERS, StoreFlash>;
/// Mailboxes between its tick and the tasks below.
pub type BoardMailboxes = Mailboxes<JOINTS, PARAMETERS>;

#[cfg(not(described_arm))]
pub use foretorque::arm::ur5::{JOINTS, Learner, PARAMETERS, Ur5 as Arm};

#[cfg(described_arm)]
include!(concat!(env!("OUT_DIR"), "/described_arm.rs"));

/// Initialises a learner that starts from `prior`; `None` if the period is not positive.
///
/// A function of its own: a frame that passes a learner on by value needs stack for all of it. Generic: so the binary has
/// one copy of what it calls, and not a second one of this crate.
#[inline(never)]
pub fn init_learner<A: foretorque::arm::Arm<N, P>, const N: usize, const P: usize>(
    place: &'static mut MaybeUninit<foretorque::learning::Learner<A, N, P>>,
    period_s: f32,
    prior: &ParameterSet<N, P>,
) -> Option<&'static mut foretorque::learning::Learner<A, N, P>> {
    // Zeros until it is restarted: built on the stack it would not fit, and the image of one with a single other number in
    // it would take 33 kB of flash.
    // SAFETY: zeros are a value of every field.
    let learner = place.write(const { unsafe { MaybeUninit::zeroed().assume_init() } });
    learner
        .restart_for_arm(period_s, prior, &StartDeviations::PRIOR)
        .ok()?;
    Some(learner)
}
