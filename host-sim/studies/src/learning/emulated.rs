//! The samples of a native run through the firmware's session, over a real link: bits compared.

use super::setup::{N, P, Set};
use super::trace::Trace;
use foretorque::arm::ur5::Ur5;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::board::{BoardError, Client};
use serde::Serialize;

/// The scenarios that are replayed.
pub(super) const REPLAYED: [&str; 6] = [
    "convergence-pd6",
    "payload-1kg-pd6",
    "outliers-pd6",
    "glitches-pd6",
    "lost-and-late-pd6",
    "not-a-number-pd6",
];

/// Agreement of native run and board.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EmulatedReport {
    /// Ticks replayed, those not counted in which no sample arrived: a board that the link paces answers none.
    pub ticks_count: usize,
    /// Ticks in which a torque had other bits.
    pub ticks_with_other_bits_count: usize,
}

/// Replays the samples of a native run.
///
/// Errors: the board's.
pub(super) fn replay(
    board: &mut Client<N>,
    start: &Set,
    native: &Trace,
    progress: &dyn Fn(usize),
) -> Result<EmulatedReport, BoardError> {
    board.reset()?;
    board.upload_bank(&ParameterBank::from_set::<Ur5, N, P>(start))?;
    board.learning(true)?;
    if let Some(arming) = &native.arming {
        board.arm(arming)?;
    }
    let (mut ticks, mut other) = (0, 0);
    for (sample, torque) in &native.recording {
        let Some(sample) = sample else {
            board.skip_period();
            continue;
        };
        let reply = board.sample(sample)?;
        let bits = <[f32; N]>::from(reply.total).map(f32::to_bits);
        ticks += 1;
        other += usize::from(bits != *torque);
        if ticks % 1000 == 0 {
            progress(1000);
        }
    }
    board.learning(false)?;
    Ok(EmulatedReport {
        ticks_count: ticks,
        ticks_with_other_bits_count: other,
    })
}
