//! Shards: which jobs are whose, and the file that holds what one shard found.

use super::Campaign;
use foretorque_workbench::files::{at, write_whole};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// One of several equal parts of a study.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    number: usize,
    of: usize,
}

impl Shard {
    /// The whole study.
    pub const ALL: Self = Self { number: 1, of: 1 };

    /// Job `job` belongs to this shard.
    pub fn has(self, job: usize) -> bool {
        job % self.of == self.number - 1
    }

    /// It is the whole study.
    pub fn is_all(self) -> bool {
        self.of == 1
    }

    /// Name of its file: `shard-2-of-8.json`.
    pub fn file_name(self) -> String {
        format!("shard-{}-of-{}.json", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    /// `2/8`, counted from 1.
    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/');
        let numbers = parts.and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((number, of)) if 1 <= number && number <= of => Ok(Self { number, of }),
            _ => Err(format!("'{text}' is no shard: write i/n with 1 <= i <= n")),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

/// What one shard found, and what it depends on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardFile {
    /// Name of the study.
    pub campaign: String,
    /// Version of the program.
    pub version: String,
    /// The study's configuration.
    pub config: Value,
    /// Jobs of the whole study.
    pub jobs: usize,
    /// Which shard: `2/8`.
    pub shard: String,
    /// Job and record.
    pub records: Vec<(usize, Value)>,
}

/// Why shards do not make a study.
#[derive(Debug)]
pub enum ShardError {
    /// A file cannot be read.
    File(io::Error),
    /// There is no file.
    None,
    /// A file is no shard.
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file belongs to another study, another configuration or another version than the first file.
    Foreign {
        /// The file.
        path: PathBuf,
        /// The first file.
        first: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// Two files hold the same job.
    Twice {
        /// The second of them.
        path: PathBuf,
        /// The job.
        job: usize,
    },
    /// Jobs are missing.
    Missing {
        /// How many.
        count: usize,
        /// Jobs of the study.
        jobs: usize,
        /// The first of them.
        first: usize,
    },
}

impl fmt::Display for ShardError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(error) => write!(f, "{error}"),
            Self::None => f.write_str("no shard to merge"),
            Self::Damaged { path, reason } => {
                write!(f, "{}: not a shard: {reason}", path.display())
            }
            Self::Foreign { path, first, what } => write!(
                f,
                "{}: its {what} is not that of {}",
                path.display(),
                first.display()
            ),
            Self::Twice { path, job } => {
                write!(f, "{}: job {job} is in another file, too", path.display())
            }
            Self::Missing { count, jobs, first } => write!(
                f,
                "{count} of {jobs} jobs are missing, the first is {first}: not all shards are there"
            ),
        }
    }
}

impl std::error::Error for ShardError {}

impl ShardFile {
    pub(super) fn new<C: Campaign>(
        campaign: &C,
        shard: Shard,
        jobs: &[usize],
        records: &[C::Record],
    ) -> serde_json::Result<Self> {
        let records = jobs.iter().zip(records);
        Ok(Self {
            campaign: C::NAME.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            config: serde_json::to_value(campaign.config())?,
            jobs: campaign.jobs(),
            shard: shard.to_string(),
            records: records
                .map(|(job, record)| Ok((*job, serde_json::to_value(record)?)))
                .collect::<serde_json::Result<_>>()?,
        })
    }

    pub(super) fn write(&self, path: &Path) -> io::Result<()> {
        write_whole(path, (serde_json::to_string(self)? + "\n").as_bytes())
    }

    /// Reads the file of a shard.
    ///
    /// Errors: [`ShardError::File`], [`ShardError::Damaged`].
    pub fn read(path: &Path) -> Result<Self, ShardError> {
        let text =
            std::fs::read_to_string(path).map_err(|error| ShardError::File(at(path, error)))?;
        serde_json::from_str(&text).map_err(|error| ShardError::Damaged {
            path: path.to_owned(),
            reason: error.to_string(),
        })
    }
}

/// The records of all jobs, in their order.
pub(super) fn records(files: &[(PathBuf, ShardFile)]) -> Result<Vec<Value>, ShardError> {
    let Some((first_path, first)) = files.first() else {
        return Err(ShardError::None);
    };
    let mut records: Vec<Option<Value>> = vec![None; first.jobs];
    for (path, file) in files {
        let differs = [
            (file.campaign != first.campaign, "study"),
            (file.version != first.version, "version"),
            (file.config != first.config, "configuration"),
            (file.jobs != first.jobs, "number of jobs"),
        ];
        if let Some((_, what)) = differs.into_iter().find(|(differs, _)| *differs) {
            return Err(ShardError::Foreign {
                path: path.clone(),
                first: first_path.clone(),
                what,
            });
        }
        for (job, record) in &file.records {
            let place = records.get_mut(*job).ok_or_else(|| ShardError::Damaged {
                path: path.clone(),
                reason: format!("job {job} of {}", first.jobs),
            })?;
            if place.is_some() {
                return Err(ShardError::Twice {
                    path: path.clone(),
                    job: *job,
                });
            }
            *place = Some(record.clone());
        }
    }
    let count = records.iter().filter(|record| record.is_none()).count();
    if let Some(first) = records.iter().position(Option::is_none) {
        return Err(ShardError::Missing {
            count,
            jobs: records.len(),
            first,
        });
    }
    Ok(records.into_iter().flatten().collect())
}
