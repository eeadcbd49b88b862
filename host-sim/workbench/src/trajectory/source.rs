//! Sources of a trajectory: the argument `--trajectory` of the commands.

use super::cartesian::{self, CartesianError};
use super::{BeyondLimits, Trajectory};
use crate::excitation::{Excitation, ExcitationError};
use crate::files::at;
use crate::robot::Robot;
use crate::table::{StateReader, TableError, TimeColumn};
use std::io;
use std::path::{Path, PathBuf};

/// Reason for which a trajectory cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum TrajectoryError {
    /// The file cannot be read.
    #[error("{0}")]
    File(io::Error),
    /// The table is damaged.
    #[error("{0}")]
    Table(TableError),
    /// The file is no excitation.
    #[error("{path}: {reason}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Message of the parser.
        reason: String,
    },
    /// The excitation is for another robot.
    #[error("{path}: {error}")]
    Excitation {
        /// The file.
        path: PathBuf,
        /// Why.
        error: ExcitationError,
    },
    /// The path of the tool is damaged, or the arm cannot follow it.
    #[error("{path}: {error}")]
    Cartesian {
        /// The file.
        path: PathBuf,
        /// Why.
        error: Box<CartesianError>,
    },
    /// A joint is asked for more than it can do.
    #[error("{path}: {error}")]
    Limits {
        /// The file.
        path: PathBuf,
        /// Which one, and when.
        error: BeyondLimits,
    },
}

impl<const N: usize> Trajectory<N> {
    /// Loads the argument of `--trajectory`: `validation`; an excitation (`.json`); a path of the tool (`.toml`); else a table with
    /// time, q, qd and qdd. Limits are checked.
    ///
    /// * `seed` of the validation path
    /// * `duration_s` for which an excitation is repeated; one period where it is `None`
    /// * `period_s` step of the limit checks and of the samples of a tool path
    ///
    /// Errors: [`TrajectoryError`], one line that names the file.
    pub fn load(
        name: &str,
        robot: &Robot,
        seed: u64,
        duration_s: Option<f64>,
        period_s: f64,
    ) -> Result<Self, TrajectoryError> {
        if name == "validation" {
            return Ok(Self::validation(robot, seed));
        }
        let path = PathBuf::from(name);
        let trajectory = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => excitation(&path, robot, duration_s)?,
            Some("toml") => {
                if robot.coupling.is_some() {
                    let reason = "paths of the tool are not planned for coupled joints".to_owned();
                    return Err(TrajectoryError::Syntax { path, reason });
                }
                let text = read(&path)?;
                let samples = cartesian::plan(robot, &text, period_s).map_err(|error| {
                    TrajectoryError::Cartesian {
                        path: path.clone(),
                        error: Box::new(error),
                    }
                })?;
                // Every sample was checked when it was laid out, so that the message names the move.
                return Ok(Self::Sampled(samples));
            }
            _ => {
                let rows = StateReader::<N>::open(&path, TimeColumn::Required)
                    .and_then(StateReader::read_all)
                    .map_err(TrajectoryError::Table)?;
                Self::sampled(&rows, period_s)
            }
        };
        match trajectory.check(robot, period_s) {
            Ok(()) => Ok(trajectory),
            Err(error) => Err(TrajectoryError::Limits { path, error }),
        }
    }
}

fn read(path: &Path) -> Result<String, TrajectoryError> {
    std::fs::read_to_string(path).map_err(|error| TrajectoryError::File(at(path, error)))
}

fn excitation<const N: usize>(
    path: &Path,
    robot: &Robot,
    duration_s: Option<f64>,
) -> Result<Trajectory<N>, TrajectoryError> {
    let series: Excitation =
        serde_json::from_str(&read(path)?).map_err(|error| TrajectoryError::Syntax {
            path: path.to_owned(),
            reason: error.to_string(),
        })?;
    series
        .check(robot)
        .map_err(|error| TrajectoryError::Excitation {
            path: path.to_owned(),
            error,
        })?;
    let duration_s = duration_s.unwrap_or(series.period_s);
    Ok(Trajectory::Excitation { series, duration_s })
}
