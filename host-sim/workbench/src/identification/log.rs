//! Logs: the project's own columns, or foreign ones through the map of the robot description.

use crate::robot::{ColumnNames, EffortKind, LOG_SOURCES, LogColumns, Robot};
use crate::table::{Rows, TableError, TableProblem};
use std::f64::consts::TAU;
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
    time: (usize, f64),
    q: Columns<N>,
    qd: Option<Columns<N>>,
    qdd: Option<Columns<N>>,
    tau: Columns<N>,
    from_current: bool,
    mapped: bool,
    unwrap: Unwrap<N>,
    notes: Vec<String>,
}

/// Columns of one quantity, and the value in SI of one unit of each.
#[derive(Clone, Copy)]
struct Columns<const N: usize> {
    places: [usize; N],
    scale: [f64; N],
}

/// Angles that continue beyond a wrap at ±π.
struct Unwrap<const N: usize> {
    /// The joint turns through its whole circle.
    continuous: [bool; N],
    last: Option<[f64; N]>,
    offset: [f64; N],
    count: [usize; N],
}

/// Distance from a whole turn within which a step is a wrap, rad.
const WRAP_RAD: f64 = 1.0;
/// Magnitude in SI beyond which a number is no measurement of a joint.
const LARGEST: f64 = 1e7;
/// Range from which a joint is continuous, rad: a turn, but for rounding.
const TURN_RAD: f64 = TAU - 0.01;

impl<const N: usize> LogReader<N> {
    /// Opens a log. Own column names win over those of the map; time, position and torque (or current) must be there.
    /// Without either, the columns of a known source are taken.
    ///
    /// Errors: [`TableError`] of the header.
    pub(super) fn open(path: &Path, robot: &Robot) -> Result<Self, TableError> {
        let given = robot.log_columns.clone().unwrap_or_default();
        let rows = Rows::named(path, &given.names)?;
        let own = ["q1_rad", "q2_rad", "tau1_nm", "i1_a"];
        let own =
            given.source.is_none() && own.iter().any(|name| !matches!(rows.find(name), Ok(None)));
        let mut notes = rows.notes().to_vec();
        let named = |map: &LogColumns| match &map.q_rad {
            Some(q) => is_there(&rows, q, robot),
            None => false,
        };
        let (map, mapped) = if own || named(&given) {
            (given.clone(), !own)
        } else {
            let known = LogColumns::known();
            let Some((source, map)) = known.into_iter().find(|(source, map)| {
                given.source.as_ref().is_none_or(|wanted| wanted == source) && named(map)
            }) else {
                return Err(no_columns(&rows, robot));
            };
            notes.push(format!("{}: columns of {source}", path.display()));
            let effort = given.effort.or(map.effort);
            let (gear_ratios, all_units) = (given.gear_ratios.clone(), given.all_units.clone());
            let map = LogColumns {
                effort,
                gear_ratios,
                all_units,
                ..map
            };
            (map, true)
        };
        let missing = |column: &str| TableProblem::MissingColumn(column.to_owned()).at(path, 1);
        let own_units = map.all_units.clone().unwrap_or_default().scale();
        let map_units = map.all_units.as_ref().or(map.units.as_ref());
        let map_units = map_units.cloned().unwrap_or_default().scale();
        let time = match (rows.find("t_s")?, &map.t_s) {
            (Some(place), _) => (place, own_units[0]),
            (None, Some(name)) => (rows.require(name)?, map_units[0]),
            (None, None) => return Err(missing("t_s")),
        };
        let quantity = |unit: usize, name, names: &Option<ColumnNames>| {
            let found = joint_places::<N>(&rows, name, names.as_ref(), robot)?;
            Ok::<_, TableError>(found.map(|(places, own)| Columns {
                places,
                scale: [if own { own_units } else { map_units }[unit]; N],
            }))
        };
        let q = quantity(1, ("q", "rad"), &map.q_rad)?.ok_or_else(|| missing("q1_rad"))?;
        let qd = quantity(2, ("qd", "rad_s"), &map.qd_rad_s)?;
        let qdd = quantity(3, ("qdd", "rad_s2"), &map.qdd_rad_s2)?;
        let torque = quantity(4, ("tau", "nm"), &map.tau_nm)?;
        let effort = match torque {
            Some(_) => map.effort.unwrap_or_default(),
            None => EffortKind::Current,
        };
        let mut tau = match torque {
            Some(tau) => tau,
            None => quantity(5, ("i", "a"), &map.i_a)?.ok_or_else(|| missing("tau1_nm"))?,
        };
        for (joint, scale) in tau.scale.iter_mut().enumerate() {
            *scale *= match effort {
                EffortKind::Torque => 1.0,
                EffortKind::Current => robot.joints[joint].drive.gain,
                EffortKind::Motor => *map.gear_ratios.get(joint).ok_or_else(|| {
                    let problem =
                        "torques of motors need gear_ratios, one a joint, in --columns-from FILE";
                    TableProblem::Unreadable(problem.to_owned()).at(path, None)
                })?,
            };
        }
        if let (Some(true), Some(names)) = (
            map.q_rad.as_ref().map(|q| q.around_name().is_some()),
            &map.q_rad,
        ) && mapped
            && names
                .of(0, &robot.joints[0].name)
                .is_some_and(|own| matches!(rows.find(&own), Ok(None)))
        {
            notes.push(format!(
                "{}: joint {} of the description is {} there, and so on",
                path.display(),
                robot.joints[0].name,
                rows.header()[q.places[0]]
            ));
        }
        Ok(Self {
            time,
            q,
            qd,
            qdd,
            tau,
            from_current: effort == EffortKind::Current,
            mapped,
            unwrap: Unwrap {
                continuous: std::array::from_fn(|joint| {
                    let (low, high) = robot.joints[joint].limits.position;
                    high - low >= TURN_RAD
                }),
                last: None,
                offset: [0.0; N],
                count: [0; N],
            },
            notes,
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

    /// The columns were found through a map.
    pub(super) fn is_mapped(&self) -> bool {
        self.mapped
    }

    /// Remarks on the columns.
    pub(super) fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Remark on the joints whose angles were wrapped so far.
    pub(super) fn wraps(&self) -> Option<String> {
        let joints = self.unwrap.count.iter().enumerate();
        let wrapped: Vec<String> = joints
            .filter(|(_, count)| **count > 0)
            .map(|(joint, count)| format!("joint {} {count} times", joint + 1))
            .collect();
        let name = self.rows.path().display();
        (!wrapped.is_empty()).then(|| format!("{name}: angles un-wrapped: {}", wrapped.join(", ")))
    }

    /// The next row, `None` at the end.
    ///
    /// Errors: [`TableError`] of that row, naming line and column.
    pub(super) fn next_row(&mut self) -> Result<Option<LogRow<N>>, TableError> {
        if !self.rows.advance()? {
            return Ok(None);
        }
        let t_s = self.rows.time(self.time.0)? * self.time.1;
        let numbers = |columns: &Option<Columns<N>>| {
            let mut values = [0.0; N];
            let Some(columns) = columns else {
                return Ok(values);
            };
            for (joint, value) in values.iter_mut().enumerate() {
                let place = columns.places[joint];
                *value = self.rows.number(place)? * columns.scale[joint];
                if value.abs() > LARGEST {
                    let name = self.rows.header()[place].clone();
                    let problem = TableProblem::Implausible(name, *value);
                    return Err(problem.at(self.rows.path(), self.rows.line()));
                }
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
        if let Err((joint, jump)) = self.unwrap.take(&mut row.q) {
            let name = self.rows.header()[self.q.places[joint]].clone();
            return Err(TableProblem::Wrap(name, jump).at(self.rows.path(), row.line));
        }
        Ok(Some(row))
    }
}

impl<const N: usize> Unwrap<N> {
    /// Continues the angles `q` of a row, rad.
    ///
    /// Errors: joint and jump, where a joint with ends in its range jumps by a turn.
    fn take(&mut self, q: &mut [f64; N]) -> Result<(), (usize, f64)> {
        let last = self.last.replace(*q).unwrap_or(*q);
        for (joint, (q, last)) in q.iter_mut().zip(last).enumerate() {
            let jump = *q - last;
            if (jump.abs() - TAU).abs() < WRAP_RAD {
                if !self.continuous[joint] {
                    return Err((joint, jump));
                }
                self.offset[joint] -= TAU.copysign(jump);
                self.count[joint] += 1;
            }
            *q += self.offset[joint];
        }
        Ok(())
    }
}

/// The log has the column of the first joint.
fn is_there(rows: &Rows, names: &ColumnNames, robot: &Robot) -> bool {
    let first = names.of(0, &robot.joints[0].name);
    first.is_some_and(|first| !matches!(rows.find(&first), Ok(None)))
        || !joints_of_log(rows, names).is_empty()
}

/// Names of the joints in a log whose columns carry them.
fn joints_of_log<'a>(rows: &'a Rows, names: &ColumnNames) -> Vec<&'a str> {
    let Some((before, after)) = names.around_name() else {
        return Vec::new();
    };
    let inner = |name: &'a String| name.strip_prefix(before)?.strip_suffix(after);
    rows.header().iter().filter_map(inner).collect()
}

/// Names without what all of them begin and end with.
fn cores<'a>(names: &[&'a str]) -> Vec<&'a str> {
    let Some(first) = names.first().filter(|_| names.len() > 1) else {
        return names.to_vec();
    };
    let same =
        |pairs: &dyn Fn(&str) -> usize| names.iter().map(|name| pairs(name)).min().unwrap_or(0);
    let head = same(&|name| {
        first
            .bytes()
            .zip(name.bytes())
            .take_while(|(a, b)| a == b)
            .count()
    });
    let back = |name: &str| {
        let pairs = first.bytes().rev().zip(name.bytes().rev());
        pairs
            .take_while(|(a, b)| a == b)
            .count()
            .min(name.len() - head)
    };
    let tail = same(&back);
    let cut = |name: &&'a str| name.get(head..name.len() - tail).unwrap_or(name);
    names.iter().map(cut).collect()
}

/// Columns of one quantity for all joints, and whether they have the project's own names; `None` without a column of it.
fn joint_places<const N: usize>(
    rows: &Rows,
    (name, unit): (&str, &str),
    mapped: Option<&ColumnNames>,
    robot: &Robot,
) -> Result<Option<([usize; N], bool)>, TableError> {
    let joint_name = |joint: usize| {
        robot
            .joints
            .get(joint)
            .map_or("", |joint| joint.name.as_str())
    };
    let own = |joint: usize| Some(format!("{name}{}_{unit}", joint + 1));
    let foreign = |joint: usize| mapped?.of(joint, joint_name(joint));
    let has = |name: &dyn Fn(usize) -> Option<String>| {
        let mut names = (0..=N).filter_map(name);
        names.any(|name| !matches!(rows.find(&name), Ok(None)))
    };
    let is_own = has(&own);
    let chosen: &dyn Fn(usize) -> Option<String> = match (is_own, has(&foreign)) {
        (true, _) => &own,
        (false, true) => &foreign,
        (false, false) => return renamed(rows, mapped, robot).map(|found| Some((found?, false))),
    };
    // A seventh joint in the log of an arm with six is a log of another robot.
    if let Some(next) = chosen(N).filter(|_| mapped.is_none_or(|map| map.around_name().is_none())) {
        rows.refuse(&next, N)?;
    }
    let mut columns = [0; N];
    for (joint, column) in columns.iter_mut().enumerate() {
        *column = rows.require(&chosen(joint).unwrap_or_default())?;
    }
    Ok(Some((columns, is_own)))
}

/// Columns by names of joints that differ from those of the description in what all of them begin and end with.
fn renamed<const N: usize>(
    rows: &Rows,
    mapped: Option<&ColumnNames>,
    robot: &Robot,
) -> Result<Option<[usize; N]>, TableError> {
    let Some(mapped) = mapped else {
        return Ok(None);
    };
    let there = joints_of_log(rows, mapped);
    if there.is_empty() {
        return Ok(None);
    }
    let ours: Vec<&str> = robot
        .joints
        .iter()
        .map(|joint| joint.name.as_str())
        .collect();
    let (cores_there, cores_ours) = (cores(&there), cores(&ours));
    let mut columns = [0; N];
    for (column, core) in columns.iter_mut().zip(&cores_ours) {
        let place = cores_there.iter().position(|other| other == core);
        let Some(place) = place.filter(|_| there.len() == N) else {
            let problem = TableProblem::OtherJoints(there.join(", "), ours.join(", "));
            return Err(problem.at(rows.path(), 1));
        };
        *column = rows.require(&mapped.of(0, there[place]).unwrap_or_default())?;
    }
    Ok(Some(columns))
}

/// The error of a log without known columns: its header, and the lines of a map with what can be guessed.
fn no_columns(rows: &Rows, robot: &Robot) -> TableError {
    const SHOWN: usize = 40;
    let header = rows.header();
    let joints = robot.joint_count();
    let mut families: Vec<String> = Vec::new();
    for name in header {
        for (first, mark) in [("0", "{0}"), ("1", "{1}")] {
            for (at, _) in name.match_indices(first) {
                let pattern = format!("{}{mark}{}", &name[..at], &name[at + 1..]);
                let names = ColumnNames::Pattern(pattern.clone());
                let column = |joint| names.of(joint, "").unwrap_or_default();
                if (0..joints).all(|joint| header.contains(&column(joint))) {
                    families.push(pattern);
                }
            }
        }
    }
    let guess = |words: &[&str], but: &[&str]| {
        let fits = |family: &&String| {
            let name = family.to_lowercase();
            words.iter().any(|word| name.contains(word))
                && !but.iter().any(|word| name.contains(word))
        };
        families.iter().find(fits).map_or("…", String::as_str)
    };
    let time = |name: &&String| {
        let name = name.to_lowercase();
        name == "t" || name.contains("time") || name.contains("stamp")
    };
    let time = header.iter().find(time).map_or("…", String::as_str);
    let q = guess(
        &["q", "pos", "angle"],
        &["qd", "dq", "des", "target", "cmd", "ref"],
    );
    let tau = guess(
        &["tau", "torque", "eff", "moment"],
        &["des", "target", "cmd", "ref"],
    );
    let all = header
        .iter()
        .take(SHOWN)
        .map(String::as_str)
        .collect::<Vec<_>>()
        .join(", ");
    let more = if header.len() > SHOWN { ", …" } else { "" };
    TableProblem::NoColumns(format!(
        "  header: {all}{more}\n  write these lines into a file, mend them, and add --columns-from FILE (or {}):\n\
         t_s = \"{time}\"\nq_rad = \"{q}\"\ntau_nm = \"{tau}\"",
        LOG_SOURCES.join(", ")
    ))
    .at(rows.path(), 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_are_found_under_another_prefix() {
        assert_eq!(cores(&["fer_joint1", "fer_joint2"]), ["1", "2"]);
        assert_eq!(cores(&["a_joint", "wrist_joint"]), ["a", "wrist"]);
        assert_eq!(cores(&["aa", "aaa"]), ["", "a"]);
    }

    #[test]
    fn angles_continue_where_a_joint_is_continuous_only() {
        let mut unwrap = Unwrap::<2> {
            continuous: [true, false],
            last: None,
            offset: [0.0; 2],
            count: [0; 2],
        };
        for (wrapped, whole) in [(3.1, 3.1), (-3.1, TAU - 3.1), (3.0, 3.0)] {
            let mut q = [wrapped, 0.5];
            unwrap.take(&mut q).expect("continuous");
            assert!((q[0] - whole).abs() < 1e-12);
        }
        assert_eq!(unwrap.count, [2, 0]);
        assert!(unwrap.take(&mut [3.0, 6.5]).is_err());
    }
}
