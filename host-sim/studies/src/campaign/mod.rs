//! Studies made of many jobs that do not depend on each other: on all cores, or sharded over machines and merged.
//!
//! Job k of a study belongs to shard `k mod n + 1` of n. A shard leaves one file with its records and everything they
//! depend on; [`merge`] puts the records of all shards in order and finishes the study as if it had run at once.

mod shard;

pub use shard::{Shard, ShardError, ShardFile};

use foretorque_workbench::parallel::in_parallel;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::error::Error;
use std::path::{Path, PathBuf};

/// What a job fails with, on whatever thread.
pub type JobError = Box<dyn Error + Send + Sync>;

/// A study made of independent jobs.
pub trait Campaign: Sync {
    /// Name, as in `experiment NAME`.
    const NAME: &'static str;
    /// Everything that the records depend on.
    type Config: Serialize + DeserializeOwned;
    /// What a job finds. A record comes back from its file as it was.
    type Record: Serialize + DeserializeOwned + Send;

    /// What it was made from.
    fn config(&self) -> &Self::Config;

    /// Number of jobs.
    fn jobs(&self) -> usize;

    /// Jobs that may run at once on this machine.
    fn threads(&self) -> usize;

    /// Does one job.
    ///
    /// Errors: whatever stops the study.
    fn run(&self, job: usize) -> Result<Self::Record, JobError>;

    /// Writes the report of all records, in the order of the jobs, into `out`. Returns what is to be said.
    ///
    /// Errors: of the files and the plots.
    fn finish(&self, records: &[Self::Record], out: &Path) -> Result<Vec<String>, Box<dyn Error>>;
}

/// Runs the jobs of `shard`, and finishes the study or writes the shard's file. Returns what is to be said.
///
/// Errors: those of the jobs, of the first in their order; of the files.
pub fn run<C: Campaign>(
    campaign: &C,
    shard: Shard,
    out: &Path,
    progress: &dyn Fn(usize, usize),
) -> Result<Vec<String>, Box<dyn Error>> {
    let mine: Vec<usize> = (0..campaign.jobs()).filter(|job| shard.has(*job)).collect();
    // A directory that cannot be written is said now, not after the work.
    std::fs::create_dir_all(out).map_err(|error| foretorque_workbench::files::at(out, error))?;
    let mut done = 0;
    progress(done, mine.len());
    let records = in_parallel(
        campaign.threads(),
        &mine,
        |job| campaign.run(*job),
        || {
            done += 1;
            progress(done, mine.len());
        },
    );
    let records: Vec<C::Record> = records
        .into_iter()
        .collect::<Result<_, _>>()
        .map_err(|error: JobError| -> Box<dyn Error> { error })?;
    if shard.is_all() {
        return campaign.finish(&records, out);
    }
    let path = out.join(shard.file_name());
    ShardFile::new(campaign, shard, &mine, &records)?.write(&path)?;
    Ok(vec![path.display().to_string()])
}

/// Finishes the study whose shards are in `files`. `open` makes the study of a configuration.
///
/// Errors: [`ShardError`]; those of the study's end.
pub fn merge<C: Campaign>(
    files: &[(PathBuf, ShardFile)],
    open: impl FnOnce(C::Config) -> Result<C, Box<dyn Error>>,
    out: &Path,
) -> Result<Vec<String>, Box<dyn Error>> {
    let records = shard::records(files)?;
    let Some((path, first)) = files.first() else {
        return Err(Box::new(ShardError::None));
    };
    let damaged = |error: &dyn std::fmt::Display| ShardError::Damaged {
        path: path.clone(),
        reason: error.to_string(),
    };
    let config: C::Config =
        serde_json::from_value(first.config.clone()).map_err(|error| damaged(&error))?;
    let records: Vec<C::Record> = records
        .into_iter()
        .map(serde_json::from_value)
        .collect::<Result<_, _>>()
        .map_err(|error| damaged(&error))?;
    open(config)?.finish(&records, out)
}

#[cfg(test)]
mod tests;
