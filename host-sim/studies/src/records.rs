//! Records of independent jobs: computed here on all cores, or read from files that the jobs of a scheduler wrote.
//!
//! A scheduler's job computes a range of seeds and leaves one line a record. The lines of all jobs, concatenated in any
//! order, make the report of the whole study.

use crate::{Progress, StudyError};
use foretorque_workbench::files::{at, write_whole};
use foretorque_workbench::parallel::in_parallel;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;

/// Source of the records, and what becomes of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Records {
    /// Computed, then reported.
    Compute,
    /// Computed and written to this file, without a report.
    Write(PathBuf),
    /// Read from this file, then reported.
    Read(PathBuf),
}

#[derive(Serialize, Deserialize)]
struct Line<R> {
    made_of: String,
    record: R,
}

impl Records {
    /// The records of `jobs`, in their order; `None` if they were only written.
    ///
    /// * `config` everything that the records depend on besides their job
    /// * `job_of` the job of a record
    ///
    /// Errors: those of `work`, the first in the order of the jobs; of the file; a record that is missing, or made of
    /// another configuration or version.
    pub(crate) fn of<J: PartialEq + Sync, R: Serialize + DeserializeOwned + Send>(
        &self,
        config: &impl Serialize,
        (jobs, job_of): (&[J], fn(&R) -> J),
        threads: usize,
        work: impl Fn(&J) -> Result<R, StudyError> + Sync,
        progress: Progress<'_>,
    ) -> Result<Option<Vec<R>>, StudyError> {
        let made_of = fingerprint(config)?;
        if let Self::Read(path) = self {
            return Ok(Some(self::read(path, &made_of, jobs, job_of)?));
        }
        let mut done = 0;
        let results = in_parallel(threads, jobs, work, || {
            done += 1;
            progress("jobs", done, jobs.len());
        });
        let records = results.into_iter().collect::<Result<Vec<R>, _>>()?;
        let Self::Write(path) = self else {
            return Ok(Some(records));
        };
        let mut text = String::new();
        for record in records {
            let made_of = made_of.clone();
            text += &(serde_json::to_string(&Line { made_of, record })? + "\n");
        }
        write_whole(path, text.as_bytes())?;
        Ok(None)
    }
}

fn read<J: PartialEq, R: DeserializeOwned>(
    path: &PathBuf,
    made_of: &str,
    jobs: &[J],
    job_of: fn(&R) -> J,
) -> Result<Vec<R>, StudyError> {
    let refused = |reason: String| StudyError::Unusable(format!("{}: {reason}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| at(path, error))?;
    let mut found: Vec<Option<R>> = jobs.iter().map(|_| None).collect();
    for (number, line) in (1..).zip(text.lines()) {
        let line: Line<R> = serde_json::from_str(line)
            .map_err(|error| refused(format!("line {number} is no record: {error}")))?;
        if line.made_of != made_of {
            let what = "is of another configuration or version";
            return Err(refused(format!("line {number} {what}")));
        }
        let job = job_of(&line.record);
        // Seeds beyond those of this report are left out.
        if let Some(place) = jobs.iter().position(|known| *known == job) {
            found[place] = Some(line.record);
        }
    }
    let missing = found.iter().filter(|record| record.is_none()).count();
    if missing > 0 {
        return Err(refused(format!(
            "{missing} of {} records are missing",
            jobs.len()
        )));
    }
    Ok(found.into_iter().flatten().collect())
}

/// Version of the program and hash of the configuration.
fn fingerprint(config: &impl Serialize) -> Result<String, StudyError> {
    let mut hasher = DefaultHasher::new();
    serde_json::to_string(config)?.hash(&mut hasher);
    Ok(format!(
        "{} {:016x}",
        env!("CARGO_PKG_VERSION"),
        hasher.finish()
    ))
}
