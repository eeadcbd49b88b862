//! The stages that a board goes through: it is asked along a path, it tracks, it learns.

use super::setup::{PAGE_POINTS, Setup};
use crate::{Progress, StudyError};
use foretorque::feedforward::Torque;
use foretorque_workbench::board::{BoardError, Client};
use foretorque_workbench::closed_loop::{ClosedLoop, motion_f32};
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::metrics::{TorqueError, TrackingError};
use foretorque_workbench::plant::Plant;

/// Time between two looks at the error while learning goes on, s.
const WATCH_EVERY_S: f64 = 1.0;

/// Position error over time: s and mrad.
pub(super) type ErrorCurve<const N: usize> = Vec<(f64, Joints<N>)>;

/// Plays the unseen path in closed loop; the error in figures, and as a thinned curve.
pub(super) fn track<const N: usize>(
    plant: &mut Plant<N>,
    setup: &Setup<N>,
    ticks: usize,
    mut board: Option<&mut Client<N>>,
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<(TrackingError<N>, ErrorCurve<N>), BoardError> {
    let (mut error, mut curve) = (TrackingError::default(), Vec::new());
    let every = (ticks / PAGE_POINTS).max(1);
    let mut run = ClosedLoop::new(
        plant,
        &setup.pd,
        &setup.validation,
        setup.period_s,
        board.as_deref_mut(),
    )?;
    for tick in 0..ticks {
        let seen = run.tick(plant, board.as_deref_mut())?;
        let distance = seen.desired.q - seen.q;
        error.add(&distance);
        if tick % every == 0 {
            curve.push((seen.t_s, distance * 1e3));
        }
        report_every(progress, stage, tick, ticks);
    }
    if let Some(board) = board {
        board.disarm()?;
    }
    Ok((error, curve))
}

/// Bits of one reply: torques and flags.
pub(super) type ReplyBits<const N: usize> = ([u32; N], u16);

/// From the wrong prior on: plays the excitation with learning on, then freezes. Returns the bits of the replies.
///
/// The board starts as after boot, so that every board goes through the very same ticks. `watch` is called every second
/// of the arm's time, and at the end.
pub(super) fn learn<const N: usize>(
    board: &mut Client<N>,
    setup: &Setup<N>,
    plant: &mut Plant<N>,
    ticks: usize,
    mut watch: impl FnMut(&mut Client<N>, &Plant<N>, f64) -> Result<(), StudyError>,
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<Vec<ReplyBits<N>>, StudyError> {
    board.reset()?;
    board.upload_bank(&setup.prior)?;
    let mut replies = Vec::with_capacity(ticks);
    let mut run = ClosedLoop::new(
        plant,
        &setup.pd,
        &setup.excitation,
        setup.period_s,
        Some(&mut *board),
    )?;
    board.learning(true)?;
    let watch_every = ((WATCH_EVERY_S / setup.period_s).round() as usize).max(1);
    for tick in 0..ticks {
        if tick % watch_every == 0 {
            watch(board, plant, tick as f64 * setup.period_s)?;
        }
        let seen = run.tick(plant, Some(&mut *board))?;
        let bits: [f32; N] = seen.feed_forward.into();
        replies.push((bits.map(f32::to_bits), seen.flags));
        report_every(progress, stage, tick, ticks);
    }
    board.learning(false)?;
    board.disarm()?;
    watch(board, plant, ticks as f64 * setup.period_s)?;
    Ok(replies)
}

/// Torques that the board predicts along `path`.
pub(super) fn predictions<const N: usize>(
    board: &mut Client<N>,
    path: &[(f64, State<N>)],
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<Vec<Torque<N>>, BoardError> {
    path.iter()
        .enumerate()
        .map(|(k, (_, state))| {
            report_every(progress, stage, k, path.len());
            board.evaluate(&motion_f32(state))
        })
        .collect()
}

/// Error of these torques against what the motion takes at the arm's present age.
pub(super) fn error_of<const N: usize>(
    plant: &Plant<N>,
    path: &[(f64, State<N>)],
    torques: &[Torque<N>],
) -> TorqueError<N> {
    let mut error = TorqueError::default();
    for ((_, state), torque) in path.iter().zip(torques) {
        error.add(&plant.true_torque(state), &torque.total.cast(), &state.qd);
    }
    error
}

fn report_every(progress: Progress<'_>, stage: &'static str, done: usize, all: usize) {
    if (done + 1).is_multiple_of(256) || done + 1 == all {
        progress(stage, done + 1, all);
    }
}
