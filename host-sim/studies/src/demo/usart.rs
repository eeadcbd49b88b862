//! The part on the flashable firmware, over its USART.

use super::setup::Setup;
use super::stages::{ReplyBits, error_of, learn, predictions};
use super::config::DemoConfig;
use super::record::{LinkFigures, UsartFigures};
use crate::{Progress, StudyError};
use foretorque_workbench::board::Client;

/// Points of the unseen path for the USART, whose link carries a few hundred frames a second.
const USART_POINTS: usize = 300;

/// The shorter job on the flashable firmware: the first seconds of the long run again, bit for bit.
pub(super) fn run<const N: usize>(
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
