//! Logs: the project's own columns, or foreign ones through the map of the robot description.

use super::log_search::{has, is_there, joint_places, likeness, required_column};
use super::log_search::{names_in_log, no_columns, no_times, rank};
use crate::dynamics::PerJoint;
use crate::robot::{ColumnNames, Coupling, EffortKind, LogColumns, Robot};
use crate::table::{Remedies, Rows, TableError, Topics};
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;

/// One instant of a log, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogRow {
    /// Line of the file, from 1.
    pub line: u64,
    /// Time, s.
    pub t_s: f64,
    /// Positions, rad.
    pub q: PerJoint<f64>,
    /// Velocities, rad/s; zero where the log has none.
    pub qd: PerJoint<f64>,
    /// Accelerations, rad/s²; zero where the log has none.
    pub qdd: PerJoint<f64>,
    /// Torques, N·m: logged, or drive gain × current.
    pub tau: PerJoint<f64>,
}

/// Reads a log row by row, in constant memory.
pub(super) struct LogReader {
    rows: Rows,
    time: Time,
    /// Rows read so far.
    count: u64,
    q: Columns,
    qd: Option<Columns>,
    pub(super) qdd: Option<Columns>,
    tau: Columns,
    /// Torque is drive gain × motor current.
    pub(super) has_currents: bool,
    /// The columns were found through a map.
    pub(super) is_mapped: bool,
    unwrap: Unwrap,
    /// Coupling of an arm whose log has motions, and with `true` torques, of its joints.
    coupling: Option<(Coupling, bool)>,
    /// Remarks on the columns.
    pub(super) notes: Vec<String>,
}

/// Remedy for single rows that are wrong; see [`GAP_PERIODS`](super::clock::GAP_PERIODS).
pub(super) const WITHOUT_ROWS: &str =
    "delete such rows: up to four in a row are interpolated, more cut the log";

/// Remedy for a field that is no number, in a log with times.
fn of_field(text: &str) -> &'static str {
    match text.contains(|c: char| c.is_ascii_digit()) {
        false => WITHOUT_ROWS,
        // A date.
        true if text.contains(':') => {
            "write seconds, with pandas (t - t[0]).dt.total_seconds(), or give rate_hz in --columns-from FILE"
        }
        true if text.contains(',') => "separate the columns by semicolons, or write decimal points",
        true => "",
    }
}

/// Times of the rows.
#[derive(Clone, Copy)]
enum Time {
    /// A column, and its unit, s.
    Column(usize, f64),
    /// Rows at this time from each other, s.
    Even(f64),
}

/// Columns of one quantity, and the value in SI of one unit of each.
type Columns = PerJoint<(usize, f64)>;

/// Angles that continue beyond a wrap at ±π.
struct Unwrap {
    /// The joint turns through its whole circle.
    continuous: PerJoint<bool>,
    /// Velocity limits, rad/s.
    fastest: PerJoint<f64>,
    /// Time, s, and angles of the row before.
    last: Option<(f64, PerJoint<f64>)>,
    offset: PerJoint<f64>,
    count: PerJoint<usize>,
}

/// Roughness of a signal in even steps: a position is smooth, a measured torque is not.
#[derive(Clone, Copy, Default)]
pub(super) struct Roughness {
    last: [Option<f64>; 2],
    second: f64,
    first: f64,
}

/// Finding where [`Roughness::are_swapped`].
pub(super) const SWAPPED: &str = "positions and torques are swapped: what stands for a torque is smoother than what stands for a position";
/// Rows behind a jump that are looked at for its reason.
const BEHIND: usize = 500;
/// Distance from a whole turn within which a step is a wrap, rad.
const WRAP_RAD: f64 = 1.0;
/// Magnitude in SI beyond which a number is no measurement of a joint.
const LARGEST: f64 = 1e7;
/// Range from which a joint is continuous, rad: a turn, but for rounding.
const TURN_RAD: f64 = TAU - 0.01;

/// The map of a log's columns, the `given` one or that of a known source, and whether the log has the positions of it.
fn map_of(
    rows: &Rows,
    given: LogColumns,
    robot: &Robot,
    notes: &mut Vec<String>,
) -> Result<(LogColumns, bool), TableError> {
    let own = ["q0_rad", "q1_rad", "q2_rad", "tau1_nm", "i1_a"];
    let own = given.source.is_none() && own.iter().any(|name| has(rows, name));
    let is_named = |map: &LogColumns| map.q_rad.iter().any(|q| is_there(rows, q, robot));
    let by_map = is_named(&given) || (given.required && given.q_rad.is_some());
    if own || by_map {
        return Ok((given, by_map));
    }
    let is_wanted = |source: &str| given.source.as_ref().is_none_or(|wanted| wanted == source);
    let mut known = LogColumns::known();
    known.retain(|(source, map)| is_wanted(source) && is_named(map));
    let is_timed = |map: &LogColumns| {
        let names = [&given.t_s, &map.t_s].into_iter().flatten();
        let mut names = names.map(String::as_str).chain(["t_s"]);
        given.rate_hz.is_some() || names.any(|name| has(rows, name))
    };
    // The first one of those that fit best.
    let best = (known.iter().rev()).max_by_key(|(_, map)| (is_timed(map), rank(rows, map, robot)));
    let Some((source, map)) = best.cloned() else {
        return Err(no_columns(rows, robot));
    };
    notes.push(format!("{}: columns of {source}", rows.path.display()));
    let t_s = given.t_s.filter(|name| given.required || has(rows, name));
    let by_file = |names: Option<ColumnNames>| names.filter(|_| given.required);
    let [qd, qdd, tau, i] =
        [given.qd_rad_s, given.qdd_rad_s2, given.tau_nm, given.i_a].map(by_file);
    let map = LogColumns {
        t_s: t_s.or(map.t_s.filter(|_| given.rate_hz.is_none())),
        rate_hz: given.rate_hz,
        qd_rad_s: qd.or(map.qd_rad_s),
        qdd_rad_s2: qdd.or(map.qdd_rad_s2),
        tau_nm: tau.or(map.tau_nm.filter(|_| i.is_none())),
        i_a: i.or(map.i_a),
        effort: given.effort.or(map.effort),
        gear_ratios: given.gear_ratios,
        all_units: given.all_units,
        of_joints: given.of_joints,
        ..map
    };
    Ok((map, true))
}

impl LogReader {
    /// Opens a log. Column names of the map win over the project's own; time, position and torque (or current) must be there.
    /// Without either, the columns of a known source are taken.
    ///
    /// Errors: [`TableError`] of the header.
    pub(super) fn open(path: &Path, robot: &Robot) -> Result<Self, TableError> {
        let is_other = |kind: fs::Metadata| !kind.is_file() && !kind.is_dir();
        if fs::metadata(path).is_ok_and(is_other) {
            let problem = "a pipe or device, and logs are read several times: write a file";
            return Err(TableError::at(path, None, problem));
        }
        let joints = robot.joint_count();
        let given = robot.log_columns.clone().unwrap_or_default();
        let (topic, q_rad) = (given.topic.clone(), given.q_rad.clone());
        let topics = Topics {
            named: topic.as_deref(),
            likeness: &|names| likeness(names, q_rad.as_ref(), robot),
        };
        let mut rows = Rows::named(path, &given.names, &topics)?;
        let mut notes = rows.notes.clone();
        let names = given.names.clone();
        // What a file names must be there.
        let by_file = given.required;
        let time_required = by_file && given.t_s.is_some();
        let required = given.quantities().map(|names| by_file && names.is_some());
        let [.., tau_required, i_required] = required;
        if tau_required && i_required {
            let problem = "tau_nm and i_a in one map of columns: keep one of them";
            return Err(TableError::at(path, None, problem));
        }
        let (map, mapped) = map_of(&rows, given, robot, &mut notes)?;
        let all_units = map.all_units.clone().unwrap_or_default();
        let [own_units, map_units] = [None, map.units.clone()]
            .map(|of_map| all_units.clone().over(of_map).scale(map.effort));
        let time = match (map.rate_hz, &map.t_s, rows.find("t_s")?) {
            (Some(_), Some(_), _) => {
                let problem = "t_s and rate_hz in one map of columns: keep one of them";
                return Err(TableError::at(path, None, problem));
            }
            (Some(hz), None, _) if hz > 0.0 && hz.is_finite() => Time::Even(1.0 / hz),
            (Some(hz), None, _) => {
                let problem = format!("rate_hz is {hz}, no number of rows a second");
                return Err(TableError::at(path, None, problem));
            }
            (None, Some(name), _) if time_required => {
                Time::Column(required_column(&rows, name)?, map_units[0])
            }
            (None, Some(name), _) if has(&rows, name) => {
                Time::Column(rows.require(name)?, map_units[0])
            }
            (None, _, Some(place)) => Time::Column(place, own_units[0]),
            (None, name, None) => return Err(no_times(&rows, name.as_deref())),
        };
        if let Time::Column(..) = time {
            rows.remedies = Remedies {
                of_field,
                same: "rows that are written twice: keep one of each; coarse stamps of even rows: leave t_s out and give rate_hz in --columns-from FILE",
                back: "sort the rows by time, or cut the log here",
            };
        }
        let in_log = names_in_log(&rows, &map, robot)?;
        let quantity = |kind: usize, name| {
            let names = (map.quantities()[kind], required[kind]);
            let found = joint_places(&rows, name, names, in_log[kind / 3].as_deref(), robot)?;
            Ok::<_, TableError>(found.map(|(places, own)| -> Columns {
                let units = if own { own_units } else { map_units };
                places.map(|place| (place, units[kind + 1]))
            }))
        };
        let q = quantity(0, ("q", "rad"))?.ok_or_else(|| match by_file {
            true => rows.missing("q1_rad"),
            false => no_columns(&rows, robot),
        })?;
        let mut qd = quantity(1, ("qd", "rad_s"))?;
        let mut qdd = quantity(2, ("qdd", "rad_s2"))?;
        let empty = Rows::named(path, &names, &topics)?.empty_columns()?;
        if qd.is_some() || qdd.is_some() {
            for (columns, kind) in [(&mut qd, "velocities"), (&mut qdd, "accelerations")] {
                let is_empty =
                    |columns: &mut Columns| columns.iter().any(|&(place, _)| empty[place]);
                if columns.take_if(is_empty).is_some() {
                    let name = path.display();
                    notes.push(format!(
                        "{name}: its {kind} are no numbers and are not used"
                    ));
                }
            }
        }
        let torque = match i_required {
            true => None,
            false => quantity(3, ("tau", "nm"))?,
        };
        let effort = match torque {
            Some(_) => map.effort.unwrap_or_default(),
            None => EffortKind::Current,
        };
        let mut tau = match torque {
            Some(tau) => tau,
            None => quantity(4, ("i", "a"))?.ok_or_else(|| rows.missing("tau1_nm"))?,
        };
        if let Some((place, _)) = tau.iter().find(|(place, _)| empty[*place]) {
            let name = &rows.header[*place];
            let problem = format!(
                "column {name} has no numbers in its first rows: record what the driver reports, torques or currents"
            );
            return Err(TableError::at(path, None, problem));
        }
        if map.effort.unwrap_or(effort) != effort {
            let name = &rows.header[tau[0].0];
            let problem = format!(
                "column {name} is a motor current: leave out --effort, or effort in the map of columns"
            );
            return Err(TableError::at(path, None, problem));
        }
        if all_units.has_currents() && effort != EffortKind::Current {
            notes.push(format!(
                "{}: the unit of i is not used: it has torques (for currents in their columns, --effort current)",
                path.display()
            ));
        }
        if !map.gear_ratios.is_empty() && effort != EffortKind::Motor {
            notes.push(format!(
                "{}: gear_ratios are not used: its torques are not of motors (else effort = \"motor\", or --effort motor)",
                path.display()
            ));
        }
        for (joint, (_, scale)) in tau.iter_mut().enumerate() {
            *scale *= match effort {
                EffortKind::Torque => 1.0,
                EffortKind::Current => robot.joints[joint].drive.gain.ok_or_else(|| {
                    let way = "give --drive-gains, or --gains standstill where gravity loads it";
                    let problem = format!(
                        "currents, and the gain of joint {} is not known: {way}",
                        joint + 1
                    );
                    TableError::at(path, None, problem)
                })?,
                EffortKind::Motor => *map.gear_ratios.get(joint).ok_or_else(|| {
                    let problem =
                        "torques of motors need gear_ratios, one a joint, in --columns-from FILE";
                    TableError::at(path, None, problem)
                })?,
            };
        }
        let by_name = map.q_rad.as_ref();
        let by_name = by_name.filter(|names| mapped && names.around_name().is_some());
        let first = by_name.and_then(|names| names.of(0, &robot.joints[0].name));
        if first.is_some_and(|first| rows.find(&first).ok().flatten() != Some(q[0].0)) {
            notes.push(format!(
                "{}: joint {} of the description is {} there, and so on",
                path.display(),
                robot.joints[0].name,
                rows.header[q[0].0]
            ));
        }
        if let [Some(motion), Some(torque)] = &in_log
            && motion != torque
        {
            let [q, tau] = [q, tau].map(|columns| &rows.header[columns[0].0]);
            let name = path.display();
            notes.push(format!(
                "{name}: positions are of {q}, torques of {tau}, and so on"
            ));
        }
        if effort == EffortKind::Current {
            let name = path.display();
            notes.push(format!("{name}: torque is drive gain × motor current"));
        }
        Ok(Self {
            time,
            count: 0,
            q,
            qd,
            qdd,
            tau,
            has_currents: effort == EffortKind::Current,
            is_mapped: mapped,
            coupling: (robot.coupling.clone().filter(|_| map.of_joints))
                .map(|coupling| (coupling, effort == EffortKind::Torque)),
            unwrap: Unwrap {
                continuous: PerJoint::from_fn(joints, |joint| {
                    let (low, high) = robot.joints[joint].limits.position;
                    high - low >= TURN_RAD
                }),
                fastest: PerJoint::from_fn(joints, |joint| robot.joints[joint].limits.velocity),
                last: None,
                offset: PerJoint::repeat(joints, 0.0),
                count: PerJoint::repeat(joints, 0),
            },
            notes,
            rows,
        })
    }

    pub(super) fn has_velocity(&self) -> bool {
        self.qd.is_some()
    }

    /// The angle of the joint has been un-wrapped so far, or that of a joint of its drive.
    pub(super) fn has_wrapped(&self, joint: usize) -> bool {
        let counts = self.unwrap.count.iter().enumerate();
        let is_own = |other: usize| other == joint || self.coupling.is_some();
        counts
            .filter(|(other, _)| is_own(*other))
            .any(|(_, count)| *count > 0)
    }

    /// Remark on the joints whose angles were wrapped so far.
    pub(super) fn wraps(&self) -> Option<String> {
        let joints = self.unwrap.count.iter().enumerate();
        let wrapped: Vec<String> = joints
            .filter(|(_, count)| **count > 0)
            .map(|(joint, count)| format!("joint {} {count} times", joint + 1))
            .collect();
        let name = self.rows.path.display();
        (!wrapped.is_empty()).then(|| format!("{name}: angles un-wrapped: {}", wrapped.join(", ")))
    }

    /// The next row, `None` at the end.
    ///
    /// Errors: [`TableError`] of that row, naming line and column.
    pub(super) fn next_row(&mut self) -> Result<Option<LogRow>, TableError> {
        if !self.rows.advance()? {
            return Ok(None);
        }
        let t_s = match self.time {
            Time::Column(place, unit_s) => self.rows.time(place)? * unit_s,
            Time::Even(step_s) => self.count as f64 * step_s,
        };
        self.count += 1;
        let numbers = |columns: &Option<Columns>| {
            let mut values = PerJoint::repeat(self.q.len(), 0.0);
            let columns = columns.iter().flat_map(|columns| columns.iter());
            for (value, &(place, scale)) in values.iter_mut().zip(columns) {
                *value = self.rows.number(place)? * scale;
                if value.abs() > LARGEST {
                    let name = &self.rows.header[place];
                    return Err(self.rows.row_error(format!(
                        "column {name}: {value:e} is no measurement of a joint"
                    )));
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
        if let Err((joint, jump)) = self.unwrap.take(t_s, &mut row.q) {
            let swapped = self.is_swapped();
            let name = &self.rows.header[self.q[joint].0];
            let problem = match swapped {
                true => SWAPPED.to_owned(),
                // A jump that a joint with ends in its range cannot make, rad.
                false => format!(
                    "column {name}: a jump of {jump:.3} rad, a wrap that this joint with ends in its range cannot make: \
                     angles from 0 to 360° (take a turn off those beyond half a turn, in all logs), a torque in the place of the position, or other units (--units)?"
                ),
            };
            return Err(TableError::at(&self.rows.path, row.line, problem));
        }
        if let Some((coupling, torques)) = &self.coupling {
            for motion in [&mut row.q, &mut row.qd, &mut row.qdd] {
                coupling.to_drives(motion);
            }
            if *torques {
                coupling.to_drive_torques(&mut row.tau);
            }
        }
        Ok(Some(row))
    }

    /// Torques stand for the positions in the next rows.
    fn is_swapped(&mut self) -> bool {
        let mut rough = vec![[Roughness::default(); 2]; self.q.len()];
        for _ in 0..BEHIND {
            if !matches!(self.rows.advance(), Ok(true)) {
                break;
            }
            for (joint, rough) in rough.iter_mut().enumerate() {
                for (columns, rough) in [self.q, self.tau].iter().zip(rough) {
                    let value = self.rows.number(columns[joint].0);
                    rough.add(value.unwrap_or_default());
                }
            }
        }
        // Noise alone has 3, a motion far less.
        let noisy = rough.iter().filter(|[q, _]| q.ratio() > 0.5).count();
        noisy * 2 > rough.len() && Roughness::are_swapped(rough)
    }
}

impl Roughness {
    /// Adds a value: the square of the second difference that it ends.
    pub(super) fn add(&mut self, value: f64) -> f64 {
        let [before, last] = self.last;
        self.last = [last, Some(value)];
        let Some((before, last)) = before.zip(last) else {
            return 0.0;
        };
        let square = (value - 2.0 * last + before).powi(2);
        self.second += square;
        self.first += (value - last).powi(2);
        square
    }

    /// The next value does not follow the last one.
    pub(super) fn pause(&mut self) {
        self.last = [None; 2];
    }

    fn ratio(&self) -> f64 {
        self.second / f64::max(self.first, f64::MIN_POSITIVE)
    }

    /// At most joints, of which `joints` gives positions and torques, the torque is far smoother.
    pub(super) fn are_swapped(joints: impl IntoIterator<Item = [Self; 2]>) -> bool {
        let far = |[q, tau]: [Self; 2]| tau.first > 0.0 && q.ratio() > 10.0 * tau.ratio();
        let votes: Vec<bool> = joints.into_iter().map(far).collect();
        votes.iter().filter(|vote| **vote).count() * 2 > votes.len()
    }
}

impl Unwrap {
    /// Continues the angles `q` of the row at `t_s`, rad.
    ///
    /// Errors: joint and jump, where a joint with ends in its range jumps by a turn, faster than it can move.
    fn take(&mut self, t_s: f64, q: &mut PerJoint<f64>) -> Result<(), (usize, f64)> {
        let (last_s, last) = self.last.replace((t_s, *q)).unwrap_or((t_s, *q));
        for (joint, (q, last)) in q.iter_mut().zip(last.iter()).enumerate() {
            let jump = *q - last;
            if (jump.abs() - TAU).abs() < WRAP_RAD {
                if self.continuous[joint] {
                    self.offset[joint] -= TAU.copysign(jump);
                    self.count[joint] += 1;
                } else if jump.abs() > self.fastest[joint] * (t_s - last_s) {
                    return Err((joint, jump));
                }
            }
            *q += self.offset[joint];
        }
        Ok(())
    }
}
