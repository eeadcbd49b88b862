//! Logs: the project's own columns, or foreign ones through the map of the robot description.

use crate::robot::{LogColumns, Robot};
use crate::table::{Rows, TableError, TableProblem};
use std::path::Path;

/// One instant of a log, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogRow<const N: usize> {
    /// Line of the file, from 1.
    pub line: u64,
    /// Time, s.
    pub t_s: f64,
    /// Positions, rad.
    pub q: [f64; N],
    /// Velocities, rad/s; zero where the log has none.
    pub qd: [f64; N],
    /// Accelerations, rad/s²; zero where the log has none.
    pub qdd: [f64; N],
    /// Torques, N·m: logged, or drive gain × current.
    pub tau: [f64; N],
}

/// Reads a log row by row, in constant memory.
pub(super) struct LogReader<const N: usize> {
    rows: Rows,
    time: usize,
    q: [usize; N],
    qd: Option<[usize; N]>,
    qdd: Option<[usize; N]>,
    tau: [usize; N],
    /// Torque per unit of the torque column: the drive gain where it is a current, N·m/A, else 1.
    gain: [f64; N],
    from_current: bool,
    mapped: bool,
}

impl<const N: usize> LogReader<N> {
    /// Opens a log. Own column names win over those of the map; time, position and torque (or current) must be there.
    ///
    /// Errors: [`TableError`] of the header.
    pub(super) fn open(path: &Path, robot: &Robot) -> Result<Self, TableError> {
        let rows = Rows::open(path)?;
        let none = LogColumns::default();
        let map = robot.log_columns.as_ref().unwrap_or(&none);
        let missing = |column: &str| TableProblem::MissingColumn(column.to_owned()).at(path, 1);
        let mapped_time = map.t_s.as_deref().map(|name| rows.find(name)).transpose()?;
        let time = rows.find("t_s")?.or(mapped_time.flatten());
        let time = time.ok_or_else(|| missing("t_s"))?;
        let joints = |name, unit, mapped: &Option<String>| {
            joint_places::<N>(&rows, (name, unit), mapped.as_deref())
        };
        let q = joints("q", "rad", &map.q_rad)?.ok_or_else(|| missing("q1_rad"))?;
        let qd = joints("qd", "rad_s", &map.qd_rad_s)?;
        let qdd = joints("qdd", "rad_s2", &map.qdd_rad_s2)?;
        let torque = joints("tau", "nm", &map.tau_nm)?;
        let mut gain = [1.0; N];
        let tau = match torque {
            Some(tau) => tau,
            None => {
                for (gain, joint) in gain.iter_mut().zip(&robot.joints) {
                    *gain = joint.drive.gain;
                }
                joints("i", "a", &map.i_a)?.ok_or_else(|| missing("tau1_nm"))?
            }
        };
        Ok(Self {
            time,
            q,
            qd,
            qdd,
            tau,
            gain,
            from_current: torque.is_none(),
            mapped: rows.find("q1_rad")?.is_none(),
            rows,
        })
    }

    /// The log has velocities.
    pub(super) fn has_velocity(&self) -> bool {
        self.qd.is_some()
    }

    /// The log has accelerations.
    pub(super) fn has_acceleration(&self) -> bool {
        self.qdd.is_some()
    }

    /// Torque is drive gain × motor current.
    pub(super) fn has_currents(&self) -> bool {
        self.from_current
    }

    /// The columns were found through the map of the description.
    pub(super) fn is_mapped(&self) -> bool {
        self.mapped
    }

    /// The next row, `None` at the end.
    ///
    /// Errors: [`TableError`] of that row, naming line and column.
    pub(super) fn next_row(&mut self) -> Result<Option<LogRow<N>>, TableError> {
        if !self.rows.advance()? {
            return Ok(None);
        }
        let t_s = self.rows.time(self.time)?;
        let numbers = |columns: &Option<[usize; N]>| {
            let mut values = [0.0; N];
            for (value, column) in values.iter_mut().zip(columns.iter().flatten()) {
                *value = self.rows.number(*column)?;
            }
            Ok::<_, TableError>(values)
        };
        let mut row = LogRow {
            line: self.rows.line(),
            t_s,
            q: numbers(&Some(self.q))?,
            qd: numbers(&self.qd)?,
            qdd: numbers(&self.qdd)?,
            tau: numbers(&Some(self.tau))?,
        };
        for (tau, gain) in row.tau.iter_mut().zip(&self.gain) {
            *tau *= gain;
        }
        Ok(Some(row))
    }
}

/// Columns of one quantity for all joints; `None` without a column of it.
///
/// * `mapped` pattern of the foreign names, `{}` for the joint
fn joint_places<const N: usize>(
    rows: &Rows,
    (name, unit): (&str, &str),
    mapped: Option<&str>,
) -> Result<Option<[usize; N]>, TableError> {
    let own = |joint: usize| Some(format!("{name}{joint}_{unit}"));
    let foreign = |joint: usize| Some(mapped?.replace("{}", &joint.to_string()));
    let has = |name: &dyn Fn(usize) -> Option<String>| {
        let mut names = (1..=N + 1).filter_map(name);
        names.any(|name| !matches!(rows.find(&name), Ok(None)))
    };
    let chosen: &dyn Fn(usize) -> Option<String> = match (has(&own), has(&foreign)) {
        (true, _) => &own,
        (false, true) => &foreign,
        (false, false) => return Ok(None),
    };
    // A seventh joint in the log of an arm with six is a log of another robot.
    rows.refuse(&chosen(N + 1).unwrap_or_default(), N)?;
    let mut columns = [0; N];
    for (column, joint) in columns.iter_mut().zip(1..) {
        *column = rows.require(&chosen(joint).unwrap_or_default())?;
    }
    Ok(Some(columns))
}
