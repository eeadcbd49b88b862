use super::super::Failure;
use super::super::progress::Bar;
use super::super::terminal::say;
use super::Beside;
use clap::Args;
use foretorque_studies::learning::soak::{self, SoakConfig};
use foretorque_workbench::files::WholeFile;
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Ten million ticks of learning: finite, positive, where exact arithmetic is, the same bits on the board
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    /// Directory for report.json
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    beside: Beside,
    /// Seed of plant, prior, paths and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Ticks in this process
    #[arg(long, default_value = "10000000")]
    ticks: NonZeroUsize,
    /// Ticks that are compared with the board
    #[arg(long, default_value = "1000000")]
    board_ticks: NonZeroUsize,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let config = SoakConfig {
        seed: arguments.seed,
        ticks: arguments.ticks.get(),
        board_ticks: arguments.board_ticks.get(),
    };
    let mut json = WholeFile::create(&arguments.out.join("report.json"))?;
    let mut board = arguments.beside.connect()?;
    let bar = Bar::new();
    let report = soak::run(&config, board.as_mut(), &|stage, done, all| {
        bar.show(stage, done, all);
    })?;
    drop(bar);
    serde_json::to_writer_pretty(&mut json, &report)?;
    json.write_all(b"\n")?;
    json.finish()?;
    say(serde_json::to_string_pretty(&report)?)?;
    Ok(())
}
