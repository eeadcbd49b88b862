use super::super::Failure;
use super::super::progress::Bar;
use super::super::terminal::say;
use super::{Logs, Out};
use crate::experiment::replay_real;
use crate::files::{WholeFile, write_whole};
use clap::Args;
use std::io::Write;

/// The board learns a real UR5 from its logs, row by row, against batch least squares
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    #[command(flatten)]
    out: Out,
    #[command(flatten)]
    logs: Logs,
    /// Seed of plant, prior, paths and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = &arguments.out.out;
    // A directory that cannot be written is said now, not after the work.
    let mut json = WholeFile::create(&out.join("report.json"))?;
    let bar = Bar::new();
    let (report, page) =
        replay_real::run(&arguments.logs.logs, arguments.seed, &|stage, done, all| {
            bar.show(stage, done, all);
        })?;
    drop(bar);
    serde_json::to_writer_pretty(&mut json, &report)?;
    json.write_all(b"\n")?;
    write_whole(&out.join("report.html"), page.as_bytes())?;
    json.finish()?;
    for (value, what) in [
        (report.aged_10_s_vs_rich_wls_ratio, "parameters 10 s old"),
        (
            report.aged_10_s_after_other_paths_vs_rich_wls_ratio,
            "the same, other paths before",
        ),
        (report.newest_vs_rich_wls_ratio, "parameters as they are"),
        (report.frozen_vs_rich_wls_ratio, "data sheet, frozen"),
        (
            report.plain_wls_vs_rich_wls_ratio,
            "plain batch least squares",
        ),
    ] {
        say(format_args!("{what:<28} {value:.3} × {}", report.reference))?;
    }
    say(format_args!(
        "decisions of the guard       {:?}",
        report.decisions_count
    ))?;
    Ok(())
}
