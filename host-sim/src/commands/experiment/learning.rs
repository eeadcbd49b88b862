use super::super::progress::Bar;
use super::super::report_files::ReportFiles;
use super::super::terminal::say;
use super::super::{Failure, unusable};
use super::Beside;
use crate::experiment::learning::{self, LearningConfig, LearningReport, table};
use crate::files::write_whole;
use clap::Args;
use std::path::{Path, PathBuf};

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
    /// Put the table of measured against reach between its marks in this file
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Compare with the table in that file instead, and fail where a figure differs
    #[arg(long, requires = "table")]
    check: bool,
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
    if let Some(file) = &arguments.table {
        // Said now, not after the work.
        marked(file)?;
    }
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
    if let Some(file) = &arguments.table {
        keep_table(&report, file, arguments.check)?;
    }
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

/// The text of the file for the table.
///
/// Errors: the file's, or that it has not the marks of the table.
fn marked(file: &Path) -> Result<String, Failure> {
    let text = std::fs::read_to_string(file).map_err(|error| crate::files::at(file, error))?;
    if table::has_marks(&text) {
        Ok(text)
    } else {
        let name = file.display();
        Err(unusable(format!(
            "{name}: has not the two marks of the table"
        )))
    }
}

/// Writes the table of measured against reach into `file`, or compares it with the one there.
fn keep_table(report: &LearningReport, file: &Path, check: bool) -> Result<(), Failure> {
    let text = marked(file)?;
    let renewed = table::renewed(&text, report).unwrap_or_default();
    if !check {
        return Ok(write_whole(file, renewed.as_bytes())?);
    }
    let complain = |what| unusable(format!("{}: {what}", file.display()));
    let lines = text.lines().zip(renewed.lines());
    match lines.into_iter().find(|(kept, new)| kept != new) {
        Some((kept, new)) => Err(complain(format_args!("says {kept}, measured {new}"))),
        None if text != renewed => Err(complain(format_args!("has a table of another length"))),
        None => Ok(()),
    }
}
