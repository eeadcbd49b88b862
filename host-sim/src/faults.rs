use super::terminal::{Bar, show};
use super::{Failure, Snapshot, bail, unusable};
use clap::Args;
use foretorque_studies::faults::{self, Campaign, Lengths, scenarios};
use foretorque_workbench::report::write_json;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Break the line, the flash, the watchdog and the processor of every board, and count what comes of it
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// File for the counts (JSON)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Three seconds of each kind instead of the whole campaign
    #[arg(long)]
    short: bool,
    /// Seed of all damage
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    snapshot: Snapshot,
}

#[derive(Serialize)]
struct Report {
    seed: u64,
    campaigns: Vec<Campaign>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let lengths = match arguments.short {
        true => Lengths::SHORT,
        false => Lengths::FULL,
    };
    let mut report = Report {
        seed: arguments.seed,
        campaigns: Vec::new(),
    };
    // A place that cannot be written or compared is refused before the work.
    arguments.snapshot.check()?;
    write_json(&arguments.out, &report)?;
    let scratch = tempfile::tempdir()?;
    let all = scenarios(lengths, arguments.seed, scratch.path());
    let (bar, count) = (Bar::new(), all.len());
    for (place, scenario) in all.iter().enumerate() {
        bar.show(scenario.name, place, count);
        let (name, start) = (scenario.name, Instant::now());
        let campaign = scenario.run();
        let campaign = campaign.map_err(|error| unusable(format!("{name}: {error}")))?;
        show!(
            "{}, {}: {} faults, {} recovered, {:.1} s",
            campaign.name,
            campaign.board,
            campaign.injected,
            campaign.recovered,
            start.elapsed().as_secs_f64()
        )?;
        report.campaigns.push(campaign);
        write_json(&arguments.out, &report)?;
    }
    drop(bar);
    let failed = report.campaigns.iter().filter(|own| !own.is_survived());
    let failed: Vec<String> = failed
        .map(|campaign| format!("{} ({})", campaign.name, campaign.board))
        .collect();
    let text = faults::text(arguments.seed, &report.campaigns);
    let (count, out) = (failed.len(), arguments.out.display());
    show!("{text}\n{count} not survived; {out}")?;
    if !failed.is_empty() {
        bail!("not survived: {}", failed.join(", "));
    }
    arguments.snapshot.keep(&text)
}
