//! The learner in static memory, initialised in a function of its own: a frame that passes it on by value needs stack for
//! all of it.

use core::mem::MaybeUninit;

use foretorque::learning::{LearnerConfig, ParameterSet};

use crate::arm::{Arm, JOINTS, Learner, PARAMETERS};

/// Initialises a learner that starts from `prior`; `None` if its configuration does not validate.
#[inline(never)]
pub fn init_learner(
    place: &'static mut MaybeUninit<Learner>,
    period_s: f32,
    prior: &ParameterSet<JOINTS, PARAMETERS>,
) -> Option<&'static mut Learner> {
    // Zeros until it is restarted: built on the stack it would not fit, and the image of one with a single other number in
    // it would take 33 kB of flash.
    // SAFETY: zeros are a value of every field.
    let learner = place.write(const { unsafe { MaybeUninit::zeroed().assume_init() } });
    learner
        .restart(LearnerConfig::for_arm::<Arm>(period_s), prior)
        .ok()?;
    Some(learner)
}
