//! The part of the page about the machine: what a tick costs, how the link did, how to repeat the run.

use super::record::{DemoReport, LinkFigures, TickInstructions};
use foretorque_workbench::report::joints::percent;
use foretorque_workbench::report::page::{self, Section};

pub(super) fn cost(report: &DemoReport) -> Section {
    let row = |name: &str, figures: TickInstructions| {
        vec![
            name.to_owned(),
            figures.mean.to_string(),
            figures.max.to_string(),
        ]
    };
    let phases = &report.tick_instructions_by_phase;
    let mut rows = vec![
        row("tick, learning off", phases.frozen),
        row("tick, learning on", phases.learning),
        row("tick, since learning began", report.tick_instructions),
        row(
            "learning from a tick, in the slack behind it",
            report.learning_instructions,
        ),
    ];
    if let Some(usart) = &report.usart {
        rows.push(row(
            "tick, flashable firmware over its USART",
            usart.tick_instructions,
        ));
    }
    let caption = if report.tick_instructions.max > 0 {
        "Instructions between a complete request and its reply, and those of learning behind it, counted by a timer of \
         the emulated board. They are instructions and not cycles: the emulator models neither wait states nor the \
         pipeline, and nothing here was measured on silicon. `cargo xtask bench` estimates cycles."
    } else {
        "The board in this process has no instruction counter; run on the emulated board to see its costs."
    };
    Section {
        heading: "Instructions per tick".to_owned(),
        caption: caption.to_owned(),
        legend: Vec::new(),
        body: page::table(&["instructions", "mean", "largest"], &rows),
    }
}

pub(super) fn link(report: &DemoReport) -> Section {
    let row = |name: &str, figures: LinkFigures| {
        vec![
            name.to_owned(),
            figures.frames.to_string(),
            figures.errors.to_string(),
        ]
    };
    let mut rows = vec![row(&format!("long run ({})", report.board), report.link)];
    let mut caption =
        "Frames the board received, and those that were damaged, foreign, missed or lost."
            .to_owned();
    if let Some(usart) = &report.usart {
        rows.push(row("flashable firmware (USART)", usart.link));
        caption += &format!(
            " On the flashable firmware the error on {} points of the unseen path went from {} to {} within {} ticks, and {} of its replies carried the very bits of the long run's.",
            usart.grid_points,
            percent(usart.torque_nrmse_before),
            percent(usart.torque_nrmse_after),
            usart.ticks,
            if usart.ticks_with_equal_bits == usart.ticks {
                "all".to_owned()
            } else {
                usart.ticks_with_equal_bits.to_string()
            }
        );
    }
    Section {
        heading: "Link".to_owned(),
        caption,
        legend: Vec::new(),
        body: page::table(&["link", "frames", "errors"], &rows),
    }
}

pub(super) fn this_run(report: &DemoReport) -> Section {
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    Section {
        heading: "This run".to_owned(),
        caption: "To repeat it, type this in the workspace's root after `cargo xtask demo` has built both sides; the same seed and firmware give the same figures to the last digit.".to_owned(),
        legend: Vec::new(),
        body: page::command(&command(report)) + &page::table(
            &["", "value"],
            &[
                row("robot", report.robot.clone()),
                row("board", report.board.clone()),
                row("seed", report.seed.to_string()),
                row("period", format!("{} ms", report.period_s * 1e3)),
                row("ticks with learning on", report.ticks.to_string()),
                row("compiler of the board's code", report.toolchain.clone()),
                row(
                    "torque NRMSE, all samples",
                    format!(
                        "{} → {}",
                        percent(report.torque_nrmse_before),
                        percent(report.torque_nrmse_after)
                    ),
                ),
                row(
                    "torque NRMSE, moving samples only",
                    format!(
                        "{} → {}",
                        percent(report.torque_nrmse_moving_before),
                        percent(report.torque_nrmse_moving_after)
                    ),
                ),
            ],
        ),
    }
}

/// What repeats this run.
fn command(report: &DemoReport) -> String {
    let seconds = |ticks: usize| ticks as f64 * report.period_s;
    let mut line = format!(
        "cargo run --release -p host-sim -- experiment demo --board {} --seed {} --learning-s {}",
        report.board,
        report.seed,
        seconds(report.ticks)
    );
    if let Some(usart) = &report.usart {
        line += &format!(" --usart-learning-s {}", seconds(usart.ticks));
    }
    line + " --out target/foretorque/demo"
}
