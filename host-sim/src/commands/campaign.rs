//! The studies that can be sharded.

use super::experiment::Arguments;
use super::progress::Bar;
use super::terminal::say;
use super::{Failure, unusable};
use crate::experiment::campaign::{self, Campaign, Shard};
use crate::experiment::excitation::{ExcitationCampaign, ExcitationConfig};
use crate::experiment::paper::{PaperCampaign, PaperConfig};
use std::path::Path;

pub(super) fn run_excitation(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let seeds = seeds(arguments, 20)?;
    let config = if arguments.quick {
        ExcitationConfig::quick(&arguments.robot, seeds)
    } else {
        ExcitationConfig::full(&arguments.robot, seeds)
    };
    run(&ExcitationCampaign::new(config)?, arguments, out)
}

pub(super) fn run_paper(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let seeds = seeds(arguments, 10)?;
    let mut config = if arguments.quick {
        PaperConfig::quick(arguments.seed, seeds)?
    } else {
        PaperConfig::full(arguments.seed, seeds)?
    };
    if let Some(path) = &arguments.excitation {
        let robot = crate::robot::Robot::load("ur5")?;
        config.excitation = super::excite::read(path, &robot)?;
    }
    run(&PaperCampaign::new(config)?, arguments, out)
}

fn seeds(arguments: &Arguments, usual: u64) -> Result<u64, Failure> {
    match arguments.seeds.unwrap_or(usual) {
        0 => Err(unusable("--seeds must be at least 1")),
        seeds => Ok(seeds),
    }
}

fn run<C: Campaign>(study: &C, arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    let bar = Bar::new();
    let shard = arguments.shard.unwrap_or(Shard::ALL);
    let lines = campaign::run(study, shard, out, &|done, all| bar.show(C::NAME, done, all))?;
    drop(bar);
    tell(&lines)
}

/// Says what a study has to say.
pub(super) fn tell(lines: &[String]) -> Result<(), Failure> {
    for line in lines {
        say(line)?;
    }
    Ok(())
}
