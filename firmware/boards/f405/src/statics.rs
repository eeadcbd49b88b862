//! Session and learner in static memory, each initialised in a function of its own: a frame that passes them on by value
//! needs stack for all of them.

use core::mem::MaybeUninit;

use foretorque::arm::Arm;
use foretorque::learning::{Learner, LearnerConfig, ParameterSet};
use foretorque_link::session::{BoardDescription, Session};

use crate::arm::BoardSession;
use crate::counter::Counter;

/// Initialises a session at tick 0; `None` if a limit of the arm cannot work.
#[inline(never)]
pub fn init_session<A: Arm<N, P>, const N: usize, const P: usize>(
    place: &'static mut MaybeUninit<BoardSession<A, N, P>>,
    board: BoardDescription<Counter>,
) -> Option<&'static mut BoardSession<A, N, P>> {
    Session::init_in_place(place, board).ok()
}

/// Initialises a learner that starts from `prior`; `None` if its configuration does not validate.
#[inline(never)]
pub fn init_learner<A: Arm<N, P>, const N: usize, const P: usize>(
    place: &'static mut MaybeUninit<Learner<A, N, P>>,
    period_s: f32,
    prior: &ParameterSet<N, P>,
) -> Option<&'static mut Learner<A, N, P>> {
    // Zeros until it is restarted: built on the stack it would not fit, and the image of one with a single other number in
    // it would take 33 kB of flash.
    // SAFETY: zeros are a value of every field.
    let learner = place.write(const { unsafe { MaybeUninit::zeroed().assume_init() } });
    learner
        .restart(LearnerConfig::for_arm::<A>(period_s), prior)
        .ok()?;
    Some(learner)
}
