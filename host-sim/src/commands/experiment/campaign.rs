//! The studies that can be sharded.

use super::super::Failure;
use super::super::excite;
use super::super::progress::Bar;
use super::super::terminal::tell;
use clap::Args;
use foretorque_studies::campaign::{self, Campaign, Shard};
use foretorque_studies::excitation::{ExcitationCampaign, ExcitationConfig};
use foretorque_studies::paper::{PaperCampaign, PaperConfig};
use foretorque_workbench::robot::Robot;
use std::path::PathBuf;

/// What the studies have in common.
#[derive(Debug, Args)]
struct Sharded {
    /// Directory for report.json and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The short form
    #[arg(long)]
    quick: bool,
    /// Only this part, for example 2/8; `merge` puts the parts together
    #[arg(long, value_name = "i/n")]
    shard: Option<Shard>,
}

/// One optimised excitation for every seed, every limit recounted; shardable
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct ExcitationArguments {
    #[command(flatten)]
    sharded: Sharded,
    /// Seeds, from 1 on
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Robot: a built-in name or a description file
    #[arg(long, default_value = "ur5")]
    robot: String,
}

/// The paper's experiment step by step, then every method over noise, friction and outliers; shardable
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct PaperArguments {
    #[command(flatten)]
    sharded: Sharded,
    /// Noise draws of every case
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Excitation to train on, an excitation.json for the UR5 [default: a precomputed one]
    #[arg(long, value_name = "FILE")]
    excitation: Option<PathBuf>,
    /// Seed of plant, paths and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run_excitation(arguments: &ExcitationArguments) -> Result<(), Failure> {
    let config = if arguments.sharded.quick {
        ExcitationConfig::quick(&arguments.robot, arguments.seeds)
    } else {
        ExcitationConfig::full(&arguments.robot, arguments.seeds)
    };
    run(&ExcitationCampaign::new(config)?, &arguments.sharded)
}

pub(super) fn run_paper(arguments: &PaperArguments) -> Result<(), Failure> {
    let mut config = if arguments.sharded.quick {
        PaperConfig::quick(arguments.seed, arguments.seeds)?
    } else {
        PaperConfig::full(arguments.seed, arguments.seeds)?
    };
    if let Some(path) = &arguments.excitation {
        config.excitation = excite::read(path, &Robot::load("ur5")?)?;
    }
    run(&PaperCampaign::new(config)?, &arguments.sharded)
}

fn run<C: Campaign>(study: &C, arguments: &Sharded) -> Result<(), Failure> {
    let bar = Bar::new();
    let shard = arguments.shard.unwrap_or(Shard::ALL);
    let progress = |done, all| bar.show(C::NAME, done, all);
    let lines = campaign::run(study, shard, &arguments.out, &progress)?;
    drop(bar);
    Ok(tell(&lines)?)
}
