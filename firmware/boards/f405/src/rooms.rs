//! The two largest things the board has, session and learner, each in a static room and made in a function of its own:
//! every frame they were handed through would need stack for all of them.

use core::mem::MaybeUninit;

use foretorque_link::session::{BoardDescription, Session};

use crate::board::{Arm, JOINTS, Learner, LearnerConfig, PARAMETERS, ParameterSet};
use crate::counter::Counter;

/// A session of a board with the arm of the images.
pub type BoardSession = Session<Arm, JOINTS, PARAMETERS, Counter>;
/// Its learner.
pub type BoardLearner = Learner;

/// Puts a session at tick 0 into `room`; `None` if a limit of the arm cannot work.
#[inline(never)]
pub fn open(
    room: &'static mut MaybeUninit<BoardSession>,
    board: BoardDescription<Counter>,
) -> Option<&'static mut BoardSession> {
    Session::init_in_place(room, board).ok()
}

/// Puts a learner that starts from `prior` into `room`; `None` if its configuration does not validate.
#[inline(never)]
pub fn furnish(
    room: &'static mut MaybeUninit<BoardLearner>,
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
    let learner = room.write(BLANK);
    learner
        .restart(LearnerConfig::for_arm::<Arm>(period_s), prior)
        .ok()?;
    Some(learner)
}
