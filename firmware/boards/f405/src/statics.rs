//! Session and learner in static memory, each initialised in a function of its own: a frame that passes them on by value
//! needs stack for all of them.

use core::mem::MaybeUninit;

use foretorque_link::session::{BoardDescription, Session};

use crate::arm::{Arm, BoardLearner, BoardSession, LearnerConfig, ParameterSet};
use crate::counter::Counter;

/// Initialises a session at tick 0; `None` if a limit of the arm cannot work.
#[inline(never)]
pub fn init_session(
    place: &'static mut MaybeUninit<BoardSession>,
    board: BoardDescription<Counter>,
) -> Option<&'static mut BoardSession> {
    Session::init_in_place(place, board).ok()
}

/// Initialises a learner that starts from `prior`; `None` if its configuration does not validate.
#[inline(never)]
pub fn init_learner(
    place: &'static mut MaybeUninit<BoardLearner>,
    period_s: f32,
    prior: &ParameterSet,
) -> Option<&'static mut BoardLearner> {
    /// A learner of zeros, until it is restarted: built on the stack it would not fit, and the image of one with a single
    /// other number in it would take 33 kB of flash.
    const BLANK: BoardLearner = {
        // SAFETY: zeros are a value of every field. The compiler looks at the value of a constant, and takes none that is
        // not valid.
        unsafe { MaybeUninit::zeroed().assume_init() }
    };
    let learner = place.write(BLANK);
    learner
        .restart(LearnerConfig::for_arm::<Arm>(period_s), prior)
        .ok()?;
    Some(learner)
}
