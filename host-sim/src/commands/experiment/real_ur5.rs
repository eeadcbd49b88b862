use super::super::Failure;
use super::super::progress::Bar;
use super::super::terminal::say;
use super::{Logs, Out};
use crate::experiment::real_ur5;
use crate::files::{WholeFile, write_whole};
use clap::Args;
use std::io::Write;

/// Identify a real UR5 on some paths, validate on the others, every path held out in turn
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
    let (report, page) = real_ur5::run(&arguments.logs.logs, arguments.seed, &|done, all| {
        bar.show("path held out", done, all);
    })?;
    drop(bar);
    serde_json::to_writer_pretty(&mut json, &report)?;
    json.write_all(b"\n")?;
    write_whole(&out.join("report.html"), page.as_bytes())?;
    json.finish()?;
    for path in &report.paths {
        say(format_args!(
            "{:<12} {:.3}",
            path.path, path.geometric_mean_vs_wls
        ))?;
    }
    say(format_args!(
        "{} over {}: {:.3}, worst path {:.3}",
        report.recommended,
        report.reference,
        report.geometric_mean_vs_wls,
        report.worst_path_vs_wls
    ))?;
    say(format_args!(
        "report       {}",
        out.join("report.html").display()
    ))?;
    Ok(())
}
