//! The reproducible studies of foretorque, and its fault campaign.
//!
//! A study takes a configuration and gives an [`Outcome`]: figures for `report.json`, a page for `report.html`, and the same
//! figures as text that a snapshot keeps. A study of independent jobs keeps their [`Records`].

pub mod demo;
pub mod efficiency;
pub mod excitation;
pub mod faults;
pub mod learning;
pub mod paper;
pub mod real_ur5;
pub mod replay;

use foretorque::arm::Arm;
use foretorque::dynamics::FrictionColumn;
use foretorque::learning::ParameterSet;
use foretorque_link::bank::{NETWORK_SEED, ParameterBank};
use foretorque_workbench::files::{at, write_whole};
use foretorque_workbench::parallel::in_parallel;
use foretorque_workbench::report::page::Page;
use foretorque_workbench::robot::Robot;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;

/// Progress: stage, steps done, steps in all.
pub type Progress<'p> = &'p (dyn Fn(&'static str, usize, usize) + Sync);

/// Result of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome<R> {
    /// Figures, units in the keys.
    pub report: R,
    /// The page.
    pub page: Page,
    /// The main figures as lines of text; no line depends on the machine.
    pub text: String,
    /// Reason why the command of the study fails, a broken promise; `None` where all are kept.
    pub broken: Option<String>,
}

/// Failure of a study: a sentence of its own, or the error of a board, a file, a log or an identification.
pub type StudyError = Box<dyn std::error::Error + Send + Sync>;

/// The failure for a robot with another number of joints.
fn unsupported(joints: usize) -> StudyError {
    format!("robots of {joints} joints are not supported").into()
}

/// The parameter bank of a robot as described: rigid body, viscous and Coulomb friction, networks with zero output.
///
/// Assumes: `robot` has the geometry of `A`; only its masses and friction may differ from the description.
pub fn bank_of<A: Arm<N, P>, const N: usize, const P: usize>(robot: &Robot) -> ParameterBank {
    let mut set = ParameterSet::<N, P>::nominal::<A>(NETWORK_SEED);
    for (place, value) in set.rigid.iter_mut().zip(robot.base_parameters()) {
        *place = value as f32;
    }
    for (place, joint) in set.friction.iter_mut().zip(&robot.joints) {
        place[FrictionColumn::Viscous] = joint.friction.viscous as f32;
        place[FrictionColumn::Coulomb] = joint.friction.coulomb as f32;
    }
    ParameterBank::from_set::<A, N, P>(&set)
}

/// Source of the records of independent jobs, and what becomes of them.
///
/// A scheduler's job computes a range of seeds and leaves one line a record. The lines of all jobs, concatenated in any
/// order, make the report of the whole study.
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
    fn of<J: PartialEq + Sync, R: Serialize + DeserializeOwned + Send>(
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
    let refused = |reason: String| StudyError::from(format!("{}: {reason}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| at(path, error))?;
    let mut found: Vec<Option<R>> = jobs.iter().map(|_| None).collect();
    for (number, line) in (1..).zip(text.lines()) {
        let of_line = |problem: String| refused(format!("line {number} is {problem}"));
        let line: Line<R> =
            serde_json::from_str(line).map_err(|error| of_line(format!("no record: {error}")))?;
        if line.made_of != made_of {
            return Err(of_line("of another configuration or version".to_owned()));
        }
        let job = job_of(&line.record);
        // Seeds beyond those of this report are left out.
        if let Some(place) = jobs.iter().position(|known| *known == job) {
            found[place] = Some(line.record);
        }
    }
    let missing = found.iter().filter(|record| record.is_none()).count();
    if missing > 0 {
        let count = jobs.len();
        return Err(refused(format!("{missing} of {count} records are missing")));
    }
    Ok(found.into_iter().flatten().collect())
}

/// Version of the program and hash of the configuration.
fn fingerprint(config: &impl Serialize) -> Result<String, StudyError> {
    let mut hasher = DefaultHasher::new();
    serde_json::to_string(config)?.hash(&mut hasher);
    let (version, hash) = (env!("CARGO_PKG_VERSION"), hasher.finish());
    Ok(format!("{version} {hash:016x}"))
}
