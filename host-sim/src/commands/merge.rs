use super::terminal::tell;
use super::{Failure, unusable};
use clap::Args;
use foretorque_studies::campaign::{Campaign, ShardFile, merge};
use foretorque_studies::excitation::ExcitationCampaign;
use foretorque_studies::paper::PaperCampaign;
use std::path::PathBuf;

/// Put the shards of a study together: the same report as if it had run at once
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Files that `experiment --shard` wrote, all of them, in any order
    #[arg(required = true, value_name = "FILE")]
    shards: Vec<PathBuf>,
    /// Directory for the study's report
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut files = Vec::with_capacity(arguments.shards.len());
    for path in &arguments.shards {
        files.push((path.clone(), ShardFile::read(path)?));
    }
    let study = files.first().map_or("", |(_, file)| file.campaign.as_str());
    let lines = match study {
        ExcitationCampaign::NAME => merge(&files, ExcitationCampaign::new, &arguments.out)?,
        PaperCampaign::NAME => merge(&files, PaperCampaign::new, &arguments.out)?,
        other => return Err(unusable(format!("unknown study '{other}'"))),
    };
    Ok(tell(&lines)?)
}
