use super::super::Failure;
use super::super::kept_table::KeptTable;
use super::super::progress::Bar;
use super::super::report_files::ReportFiles;
use super::super::terminal::say;
use super::Beside;
use clap::Args;
use foretorque_studies::learning::{self, LearningConfig, table};
use std::path::PathBuf;

/// Name of the table of measured against reach.
const TABLE: &str = "learning";

/// Learned against frozen, in closed loop, over everything that may go wrong
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    /// List the scenarios
    #[arg(long)]
    list: bool,
    /// Only the scenarios whose names begin so
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// The short form
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    table: KeptTable,
    /// Directory for report.json and report.html
    #[arg(
        long,
        value_name = "DIR",
        required_unless_present = "list",
        conflicts_with = "list"
    )]
    out: Option<PathBuf>,
    #[command(flatten)]
    beside: Beside,
    /// Seed of plant, prior, paths and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Some(out) = &arguments.out else {
        return list();
    };
    // Said now, not after the work.
    arguments.table.look(TABLE)?;
    let config = LearningConfig {
        seed: arguments.seed,
        only: arguments.only.clone(),
        quick: arguments.quick,
    };
    let files = ReportFiles::create(out)?;
    let mut board = arguments.beside.connect()?;
    let bar = Bar::new();
    let (report, page) = learning::run(&config, board.as_mut(), &|stage, done, all| {
        bar.show(stage, done, all);
    })?;
    drop(bar);
    files.finish(&report, &page)?;
    for outcome in &report.outcomes {
        say(format_args!(
            "{:<26} {:<44} {:>10.4}  {} {:<6} {}",
            outcome.scenario,
            outcome.figure,
            outcome.measured,
            outcome.side,
            outcome.bar,
            if outcome.met { "met" } else { "MISSED" }
        ))?;
    }
    arguments.table.keep(TABLE, &table::text(&report))?;
    for (name, replayed) in &report.emulated {
        say(format_args!(
            "{name:<26} {} ticks on board {}, {} with other bits",
            replayed.ticks_count, arguments.beside.board, replayed.ticks_with_other_bits_count
        ))?;
    }
    Ok(())
}

fn list() -> Result<(), Failure> {
    for (name, shows) in learning::scenarios() {
        say(format_args!("{name:<26} {shows}"))?;
    }
    Ok(())
}
