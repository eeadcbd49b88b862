//! Sources of a trajectory: the argument `--trajectory` of the commands.

use super::{Trajectory, cartesian};
use crate::Refusal;
use crate::excitation::Excitation;
use crate::files::at;
use crate::robot::Robot;
use crate::table::{StateReader, TimeColumn};
use std::fmt::Display;
use std::path::Path;

impl<const N: usize> Trajectory<N> {
    /// Loads the argument of `--trajectory`: `validation`; an excitation (`.json`); a path of the tool (`.toml`); else a table with
    /// time, q, qd and qdd. Limits are checked.
    ///
    /// * `seed` of the validation path
    /// * `duration_s` for which an excitation is repeated; one period where it is `None`
    /// * `period_s` step of the limit checks and of the samples of a tool path
    ///
    /// Errors: one line that names the file.
    pub fn load(
        name: &str,
        robot: &Robot,
        seed: u64,
        duration_s: Option<f64>,
        period_s: f64,
    ) -> Result<Self, Refusal> {
        if name == "validation" {
            return Ok(Self::validation(robot, seed));
        }
        let path = Path::new(name);
        let trajectory = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => {
                let series: Excitation =
                    serde_json::from_str(&read(path)?).map_err(in_file(name))?;
                series.check(robot).map_err(in_file(name))?;
                let duration_s = duration_s.unwrap_or(series.period_s);
                Self::Excitation { series, duration_s }
            }
            Some("toml") => {
                if robot.coupling.is_some() {
                    let reason = "paths of the tool are not planned for coupled joints";
                    return Err(Refusal::of(name, reason));
                }
                let samples = cartesian::plan(robot, &read(path)?, period_s);
                // Every sample was checked when it was laid out, so that the message names the move.
                return samples.map(Self::Sampled).map_err(in_file(name));
            }
            _ => {
                let rows = StateReader::<N>::open(path, TimeColumn::Required)
                    .and_then(StateReader::read_all)
                    .map_err(|error| Refusal(error.to_string()))?;
                Self::sampled(&rows, period_s)
            }
        };
        trajectory.check(robot, period_s).map_err(in_file(name))?;
        Ok(trajectory)
    }
}

fn read(path: &Path) -> Result<String, Refusal> {
    std::fs::read_to_string(path).map_err(|error| Refusal(at(path, error).to_string()))
}

fn in_file<E: Display>(name: &str) -> impl Fn(E) -> Refusal {
    move |error| Refusal::of(name, error)
}
