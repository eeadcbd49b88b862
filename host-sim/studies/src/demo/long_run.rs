//! The long run, everything that is asked of one board before, while and after it learns; and its first seconds again on the
//! flashable firmware, over its USART.

use super::record::{
    BeforeAfter, DemoCurves, DemoReport, LearningPoint, LinkFigures, TickPhases, Tracking,
    UsartFigures, ValidationPoint,
};
use super::setup::{
    DemoConfig, PAGE_POINTS, PD_BANDWIDTH_HZ, PERIOD_S, ReplyBits, Setup, error_of, learn,
    predictions, ticks_in, track,
};
use super::{N, Ur5};
use crate::{Progress, StudyError};
use foretorque::arm::Arm;
use foretorque_workbench::board::Client;

/// Points of the unseen path on which the error is watched while learning goes on.
pub(super) const WATCH_POINTS: usize = 250;

/// Takes `bulk` through the whole job: the report, the curves, and the bits of every reply while learning was on.
///
/// * `board`, `toolchain` names of the board and of the compiler of its code
///
/// Errors: the board's.
pub(super) fn long_run(
    bulk: &mut Client<N>,
    setup: &Setup,
    config: &DemoConfig,
    (board, toolchain): (String, String),
    progress: Progress<'_>,
) -> Result<(DemoReport, DemoCurves, Vec<ReplyBits>), StudyError> {
    let samples = ticks_in(config.validation_s);
    let path = setup.grid(samples, config.validation_s);
    bulk.reset()?;
    bulk.upload_bank(&setup.prior)?;
    let before = predictions(bulk, &path, "torque before", progress)?;
    // Both kinds of control meet the arm as it is when learning begins: same age, same noise.
    let mut fresh = setup.plant.clone();
    let pd_only = track(&mut fresh, setup, samples, None, "PD alone", progress)?;
    let mut fresh = setup.plant.clone();
    let wrong = track(
        &mut fresh,
        setup,
        samples,
        Some(bulk),
        "wrong model",
        progress,
    )?;
    let frozen = bulk.statistics()?;

    let mut plant = setup.plant.clone();
    let watched = setup.grid(WATCH_POINTS, config.validation_s);
    let mut learning_curve = Vec::new();
    let replies = learn(
        bulk,
        setup,
        &mut plant,
        ticks_in(config.learning_s),
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
    let learning = bulk.statistics()?;
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
        samples,
        Some(bulk),
        "learnt model",
        progress,
    )?;
    let statistics = bulk.statistics()?;
    let tracking = Tracking {
        pd_only: pd_only.0,
        before: wrong.0,
        after: learnt.0,
    };
    let curves = DemoCurves {
        validation_samples: samples,
        validation,
        tracking: Tracking {
            pd_only: pd_only.1,
            before: wrong.1,
            after: learnt.1,
        },
    };
    let [before, after] = errors;
    let report = DemoReport {
        robot: Ur5::NAME.to_owned(),
        board,
        seed: config.seed,
        ticks: ticks_in(config.learning_s),
        period_s: PERIOD_S,
        toolchain,
        torque_nrmse_before: before.nrmse(),
        torque_nrmse_after: after.nrmse(),
        torque_nrmse_moving_before: before.nrmse_moving(),
        torque_nrmse_moving_after: after.nrmse_moving(),
        torque_rmse_nm: BeforeAfter {
            before: before.rmse_nm(),
            after: after.rmse_nm(),
        },
        tracking_rms_mrad: tracking.map(|error| error.mean_rms_mrad()),
        tracking_rms_joint_mrad: tracking.map(|error| error.rms_mrad()),
        pd_bandwidth_hz: PD_BANDWIDTH_HZ,
        learning_curve,
        tick_instructions: statistics.tick_cost.into(),
        tick_instructions_by_phase: TickPhases {
            frozen: frozen.tick_cost.into(),
            learning: learning.tick_cost.into(),
        },
        learning_instructions: statistics.learn_cost.into(),
        link: LinkFigures::of(&[frozen, statistics]),
        usart: None,
    };
    Ok((report, curves, replies))
}

/// Points of the unseen path for the USART, whose link carries a few hundred frames a second.
const USART_POINTS: usize = 300;

/// The shorter job on the flashable firmware: the first seconds of the long run again, bit for bit.
pub(super) fn usart_run(
    board: &mut Client<N>,
    setup: &Setup,
    config: &DemoConfig,
    long_run: &[ReplyBits],
    progress: Progress<'_>,
) -> Result<UsartFigures, StudyError> {
    let ticks = ticks_in(config.usart_learning_s);
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
