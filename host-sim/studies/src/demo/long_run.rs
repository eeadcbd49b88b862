//! The long run, everything that is asked of one board before, while and after it learns; and its first seconds again on the
//! flashable firmware, over its USART.

use super::record::{LearningPoint, LinkFigures, Tracking, UsartFigures, ValidationPoint};
use super::setup::{
    DemoConfig, ErrorCurve, PAGE_POINTS, ReplyBits, Setup, error_of, learn, predictions, track,
};
use crate::{Progress, StudyError};
use foretorque_link::telemetry::Statistics;
use foretorque_workbench::board::Client;
use foretorque_workbench::metrics::{TorqueError, TrackingError};

/// Points of the unseen path on which the error is watched while learning goes on.
pub(super) const WATCH_POINTS: usize = 250;

/// Records of the long run.
pub(super) struct LongRun<const N: usize> {
    /// Torque error on the unseen path with the wrong prior.
    pub(super) before: TorqueError<N>,
    /// Torque error after learning.
    pub(super) after: TorqueError<N>,
    /// Position error on the unseen path.
    pub(super) tracking: Tracking<TrackingError<N>>,
    /// Tracking errors over time.
    pub(super) tracking_curves: Tracking<ErrorCurve<N>>,
    /// Torque error while learning goes on.
    pub(super) learning_curve: Vec<LearningPoint>,
    /// Torques along the unseen path.
    pub(super) validation: Vec<ValidationPoint<N>>,
    /// Bits of every reply while learning was on.
    pub(super) replies: Vec<ReplyBits<N>>,
    /// Counters before the reset with which learning begins, and at the end.
    pub(super) statistics: [Statistics; 2],
    /// Counters when learning ends, since that reset.
    pub(super) learnt: Statistics,
}

/// Takes `bulk` through the whole job.
///
/// Errors: the board's.
pub(super) fn long_run<const N: usize>(
    bulk: &mut Client<N>,
    setup: &Setup<N>,
    config: &DemoConfig,
    progress: Progress<'_>,
) -> Result<LongRun<N>, StudyError> {
    let path = setup.grid(config.ticks(config.validation_s), config.validation_s);
    bulk.reset()?;
    bulk.upload_bank(&setup.prior)?;
    let before = predictions(bulk, &path, "torque before", progress)?;
    // Both kinds of control meet the arm as it is when learning begins: same age, same noise.
    let mut fresh = setup.plant.clone();
    let pd_only = track(&mut fresh, setup, path.len(), None, "PD alone", progress)?;
    let mut fresh = setup.plant.clone();
    let wrong = track(
        &mut fresh,
        setup,
        path.len(),
        Some(bulk),
        "wrong model",
        progress,
    )?;
    let earlier = bulk.statistics()?;

    let mut plant = setup.plant.clone();
    let watched = setup.grid(WATCH_POINTS, config.validation_s);
    let mut learning_curve = Vec::new();
    let replies = learn(
        bulk,
        setup,
        &mut plant,
        config.ticks(config.learning_s),
        |board, plant, t_s| {
            let seen = predictions(board, &watched, "learning", &|_, _, _| {})?;
            learning_curve.push(LearningPoint {
                t_s,
                torque_nrmse: error_of(plant, &watched, &seen).nrmse(),
            });
            Ok(())
        },
        "learning",
        progress,
    )?;
    let at_the_end_of_learning = bulk.statistics()?;
    let after = predictions(bulk, &path, "torque after", progress)?;
    let errors = [&before, &after].map(|torques| error_of(&plant, &path, torques));
    let validation = (0..path.len())
        .step_by((path.len() / PAGE_POINTS).max(1))
        .map(|k| ValidationPoint {
            t_s: path[k].0,
            truth: plant.true_torque(&path[k].1),
            before: before[k].total.cast(),
            after: after[k].total.cast(),
            rigid: after[k].shares.rigid.cast(),
            friction: after[k].shares.friction.cast(),
            network: after[k].shares.network.cast(),
        })
        .collect();
    let learnt = track(
        &mut plant,
        setup,
        path.len(),
        Some(bulk),
        "learnt model",
        progress,
    )?;
    let statistics = [earlier, bulk.statistics()?];
    let [before, after] = errors;
    Ok(LongRun {
        before,
        after,
        tracking: Tracking {
            pd_only: pd_only.0,
            before: wrong.0,
            after: learnt.0,
        },
        tracking_curves: Tracking {
            pd_only: pd_only.1,
            before: wrong.1,
            after: learnt.1,
        },
        learning_curve,
        validation,
        replies,
        statistics,
        learnt: at_the_end_of_learning,
    })
}

/// Points of the unseen path for the USART, whose link carries a few hundred frames a second.
const USART_POINTS: usize = 300;

/// The shorter job on the flashable firmware: the first seconds of the long run again, bit for bit.
pub(super) fn usart_run<const N: usize>(
    board: &mut Client<N>,
    setup: &Setup<N>,
    config: &DemoConfig,
    long_run: &[ReplyBits<N>],
    progress: Progress<'_>,
) -> Result<UsartFigures, StudyError> {
    let ticks = config.ticks(config.usart_learning_s);
    let grid = setup.grid(USART_POINTS, config.validation_s);
    let mut plant = setup.plant.clone();
    // Counters from here on: how often a booting board was greeted is a matter of the clock on the wall.
    board.reset()?;
    board.upload_bank(&setup.prior)?;
    let before = predictions(board, &grid, "USART: torque before", progress)?;
    let earlier = board.statistics()?;
    let replies = learn(
        board,
        setup,
        &mut plant,
        ticks,
        |_, _, _| Ok(()),
        "USART: learning",
        progress,
    )?;
    let after = predictions(board, &grid, "USART: torque after", progress)?;
    let statistics = board.statistics()?;
    let equal = replies
        .iter()
        .zip(long_run)
        .take_while(|(here, there)| here == there);
    Ok(UsartFigures {
        ticks,
        torque_nrmse_before: error_of(&plant, &grid, &before).nrmse(),
        torque_nrmse_after: error_of(&plant, &grid, &after).nrmse(),
        grid_points: grid.len(),
        ticks_with_equal_bits: equal.count(),
        tick_instructions: statistics.tick_cost.into(),
        learning_instructions: statistics.learn_cost.into(),
        link: LinkFigures::of(&[earlier, statistics]),
    })
}
