//! A log with its lost rows put in: filters and derivatives need rows that are equally far apart.

use super::clock::{Clock, GAP_PERIODS, clock, step_times};
use super::log::{LogReader, LogRow};
use super::repeated_rows::{Held, resolution};
use crate::dynamics::PerJoint;
use crate::robot::Robot;
use crate::table::TableError;
use std::collections::VecDeque;
use std::path::Path;

/// Rows from which the period and the sources of motion are found.
pub(super) const PREVIEW: usize = 4096;
/// Most rows that are read for them, where the arm rests first.
const LONGEST_PREVIEW: usize = 16 * PREVIEW;
/// Distance from its first position at which a joint has moved, rad.
const MOVED_RAD: f64 = 0.2;

/// The error of a log of fewer than three rows.
pub(super) fn too_short(path: &Path, rows: usize) -> TableError {
    match rows {
        0 => TableError::empty(path),
        rows => TableError::at(
            path,
            None,
            format!("{rows} rows, a motion needs 3 at least"),
        ),
    }
}

/// Reads a log row by row, in constant memory. Rows that were lost by its clock are put in: torques and velocities on a
/// straight line between the neighbours, positions on the cubic through both and their velocities where the log has such.
/// Rows with an uneven clock are put on an even grid in the same way. Rows that repeat the one before are left out first, so that
/// the clock is that of the readings: rows of a slower sensor, and others of a moving arm.
///
/// Three periods of 8 ms taken for one would triple a derived velocity and add a false acceleration.
pub struct WholeLog {
    pub(super) reader: LogReader,
    pub(super) held: Held,
    /// The first rows, those put in included.
    pub(super) preview: Vec<LogRow>,
    /// Noise of the positions, standard deviation, rad.
    pub(super) noise: Vec<f64>,
    period_s: f64,
    clock: Clock,
    /// Step that 95 % of the rows do not exceed, s.
    longest_s: f64,
    last: Option<LogRow>,
    /// Time of the next row of the grid, s.
    next_s: f64,
    /// The row read last, still without a velocity.
    ahead: [Option<LogRow>; 2],
    /// Rows since a long step of an even clock: lost ones come before them, or they are late.
    late: Vec<LogRow>,
    waiting: VecDeque<LogRow>,
    /// Rows put in so far.
    pub(super) lost: usize,
    /// Remarks on columns and clock.
    pub(super) notes: Vec<String>,
}

impl WholeLog {
    /// Opens a log and reads its first rows.
    ///
    /// Errors: [`TableError`] of the header or of one of these rows; fewer than three rows.
    pub fn open(path: &Path, robot: &Robot) -> Result<Self, TableError> {
        let mut reader = LogReader::open(path, robot)?;
        let mut first: Vec<LogRow> = Vec::new();
        let (mut wanted, mut rests) = (PREVIEW, true);
        while first.len() < wanted
            && let Some(row) = reader.next_row()?
        {
            first.push(row);
            let moved = |(q, start): (&f64, &f64)| (q - start).abs() > MOVED_RAD;
            rests &= !row.q.iter().zip(first[0].q.iter()).any(moved);
            if rests && first.len() > PREVIEW / 2 {
                wanted = (first.len() + PREVIEW).min(LONGEST_PREVIEW);
            }
        }
        if first.len() < 3 {
            return Err(too_short(path, first.len()));
        }
        // Rows of an arm at rest decide on nothing.
        let last = |rows: &[LogRow]| rows.len().saturating_sub(PREVIEW)..;
        let mut held = Held::of(&first[last(&first)]);
        let first: Vec<LogRow> = first
            .into_iter()
            .flat_map(|row| held.readings(row))
            .collect();
        let moving = &first[last(&first)];
        let [shortest_s, _, longest_s] = step_times(moving);
        let (clock, period_s) = clock(moving);
        if held.times > 1 {
            reader.notes.push(format!(
                "{}: positions repeat in {times} rows: they were read at {:.0} Hz, and one row of {times} is kept",
                path.display(),
                1.0 / period_s,
                times = held.times
            ));
        }
        let mut log = Self {
            notes: reader.notes.clone(),
            reader,
            held,
            preview: Vec::new(),
            noise: Vec::new(),
            period_s,
            clock,
            longest_s,
            last: None,
            next_s: f64::NEG_INFINITY,
            ahead: [None; 2],
            late: Vec::new(),
            waiting: VecDeque::new(),
            lost: 0,
        };
        if clock == Clock::Stamps {
            log.notes.push(format!(
                "{}: rows {:.1} to {:.1} ms apart were put on a grid of {:.2} ms by their stamps",
                path.display(),
                1e3 * shortest_s,
                1e3 * longest_s,
                1e3 * log.period_s
            ));
        }
        let resolution = resolution(moving);
        for row in first {
            log.read(Some(row));
        }
        log.preview = log.waiting.iter().copied().collect();
        log.noise = noise(&log.preview[last(&log.preview)], &resolution);
        Ok(log)
    }

    /// Time between two rows, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// The next row, `None` at the end.
    ///
    /// Errors: [`TableError`] of that row, naming line and column.
    pub fn next_row(&mut self) -> Result<Option<LogRow>, TableError> {
        while self.waiting.is_empty() {
            let Some(row) = self.reader.next_row()? else {
                self.read(None);
                break;
            };
            for row in self.held.readings(row) {
                self.read(Some(row));
            }
        }
        Ok(self.waiting.pop_front())
    }

    /// Queues what follows from the row read last, `None` at the end of the log.
    fn read(&mut self, row: Option<LogRow>) {
        if self.clock == Clock::Even {
            self.settle(row.as_ref());
            row.into_iter().for_each(|row| self.take(row));
        } else if self.clock == Clock::Arrival {
            row.into_iter().for_each(|row| self.take(row));
        } else if self.reader.has_velocity() {
            row.into_iter().for_each(|row| self.regrid(row));
        } else {
            // The cubic needs velocities: slopes of the parabola through three rows, which is one row behind.
            let [before, here] = self.ahead;
            if let Some(mut here) = here {
                here.qd = slopes(before.as_ref(), &here, row.as_ref());
                self.regrid(here);
            }
            self.ahead = [here, row];
        }
    }

    /// Queues the rows of the grid up to `row`.
    fn regrid(&mut self, row: LogRow) {
        if let Some(last) = self.last.replace(row)
            && row.t_s - last.t_s <= GAP_PERIODS * self.period_s
        {
            // A rounding error short of the row is the row.
            while self.next_s <= row.t_s + 1e-9 * self.period_s {
                let part = (self.next_s - last.t_s) / (row.t_s - last.t_s);
                let mut between = between(&last, &row, part, true);
                between.t_s = self.next_s;
                self.waiting.push_back(between);
                self.next_s += self.period_s;
            }
        } else {
            self.waiting.push_back(row);
            self.next_s = row.t_s + self.period_s;
        }
    }

    /// Ends a wait for late rows where `row` comes in time. As many rows are lost as time has passed for: the others are put
    /// on even times.
    fn settle(&mut self, row: Option<&LogRow>) {
        let Some((end, last)) = self.late.last().zip(self.last) else {
            return;
        };
        let step_s = row.map_or(f64::INFINITY, |row| row.t_s - end.t_s);
        if step_s < SOON_PERIODS * self.period_s && self.late.len() < MOST_LATE {
            return;
        }
        let time_s = end.t_s - last.t_s;
        let rows = self.late.len();
        let lost = (time_s / self.period_s).round() as usize;
        let lost = lost.saturating_sub(rows);
        for (k, mut row) in std::mem::take(&mut self.late).into_iter().enumerate() {
            row.t_s = last.t_s + time_s * (lost + k + 1) as f64 / (lost + rows) as f64;
            self.push(row, if k == 0 { lost } else { 0 });
        }
    }

    /// Queues `row` and the rows lost before it.
    fn take(&mut self, mut row: LogRow) {
        if self.clock == Clock::Arrival {
            let late_s = row.t_s - self.next_s;
            if late_s <= GAP_PERIODS * self.longest_s {
                row.t_s = self.next_s;
                // The period of the first rows is not quite that of all.
                self.next_s += FOLLOWED * late_s;
            } else {
                self.next_s = row.t_s;
            }
            self.next_s += self.period_s;
        }
        let lost = 1.5..=GAP_PERIODS;
        let long = |last: LogRow| lost.contains(&((row.t_s - last.t_s) / self.period_s));
        if self.clock == Clock::Even && (!self.late.is_empty() || self.last.is_some_and(long)) {
            self.late.push(row);
        } else {
            self.push(row, 0);
        }
    }

    /// Queues `lost` rows, then `row`.
    fn push(&mut self, row: LogRow, lost: usize) {
        if let Some(last) = self.last.replace(row) {
            let has_velocity = self.reader.has_velocity();
            for k in 1..=lost {
                let part = k as f64 / (lost + 1) as f64;
                self.waiting
                    .push_back(between(&last, &row, part, has_velocity));
            }
            self.lost += lost;
        }
        self.waiting.push_back(row);
    }
}

/// A row this soon after the one before, in periods of an even clock, makes up for a delay.
const SOON_PERIODS: f64 = 0.75;
/// Most rows in a delay.
const MOST_LATE: usize = 32;

/// Velocities at `here` by the parabola through it and its neighbours; by a straight line where one is missing.
fn slopes(before: Option<&LogRow>, here: &LogRow, after: Option<&LogRow>) -> PerJoint<f64> {
    let slope = |a: &LogRow, b: &LogRow, j: usize| (b.q[j] - a.q[j]) / (b.t_s - a.t_s);
    PerJoint::from_fn(here.q.len(), |joint| match (before, after) {
        (Some(before), Some(after)) => {
            let (h0, h1) = (here.t_s - before.t_s, after.t_s - here.t_s);
            let (s0, s1) = (slope(before, here, joint), slope(here, after, joint));
            (h1 * s0 + h0 * s1) / (h0 + h1)
        }
        (Some(before), None) => slope(before, here, joint),
        (None, Some(after)) => slope(here, after, joint),
        (None, None) => 0.0,
    })
}

/// The row that is `part` of the way from `a` to `b`.
///
/// Positions with h = the step in time, s = `part` [Hermite]:
/// ```text
/// q = q_a + (q_b − q_a) s² (3 − 2s) + h s (1 − s) (qd_a (1 − s) − qd_b s)
/// ```
fn between(a: &LogRow, b: &LogRow, part: f64, has_velocity: bool) -> LogRow {
    let line = |a: &[f64], b: &[f64]| {
        PerJoint::from_fn(a.len(), |joint| a[joint] + (b[joint] - a[joint]) * part)
    };
    let step_s = b.t_s - a.t_s;
    let cubic = |joint: usize| {
        let (way, rest) = (b.q[joint] - a.q[joint], 1.0 - part);
        let bend = part * rest * step_s * (a.qd[joint] * rest - b.qd[joint] * part);
        a.q[joint] + way * part * part * (3.0 - 2.0 * part) + bend
    };
    LogRow {
        line: b.line,
        t_s: a.t_s + step_s * part,
        q: if has_velocity {
            PerJoint::from_fn(a.q.len(), cubic)
        } else {
            line(&a.q, &b.q)
        },
        qd: line(&a.qd, &b.qd),
        qdd: line(&a.qdd, &b.qdd),
        tau: line(&a.tau, &b.tau),
    }
}

/// Share of the delay of a row by which the even times follow.
pub(super) const FOLLOWED: f64 = 0.01;

/// Noise of the positions, standard deviation, rad: that of rounding to their `resolution`, or more where fourth differences
/// show more, for example where drives answer late. White noise gives its deviation times √70 to fourth differences, where
/// motion hardly shows; nine of ten are below 1.645 deviations.
fn noise(rows: &[LogRow], resolution: &[f64]) -> Vec<f64> {
    let seen = |joint: usize| {
        let fourth = rows.windows(5).map(|rows| {
            let [a, b, c, d, e] = std::array::from_fn(|k| rows[k].q[joint]);
            (a - 4.0 * b + 6.0 * c - 4.0 * d + e).abs()
        });
        let mut fourth: Vec<f64> = fourth.collect();
        fourth.sort_by(f64::total_cmp);
        let most = fourth.get(fourth.len() * 9 / 10).copied();
        most.unwrap_or(0.0) / (1.645 * 70_f64.sqrt())
    };
    let joints = resolution.iter().enumerate();
    let deviation = |(joint, step): (usize, &f64)| (step / 12_f64.sqrt()).max(seen(joint));
    joints.map(deviation).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::log_tests::{first_joints, log_of};
    use super::*;
    use std::f64::consts::TAU;

    pub(in crate::identification) fn motion(t: f64) -> (f64, f64) {
        (
            0.3 - t + 2.0 * t * t - 0.7 * t.powi(3),
            -1.0 + 4.0 * t - 2.1 * t * t,
        )
    }

    /// Rows of a log of one joint that moves on a cubic, its positions read at these times, its torques at these stamps, with
    /// velocities that are wrong by up to `error`, rad/s, or without velocities.
    pub(in crate::identification) fn written(
        times_s: &[f64],
        stamps_s: &[f64],
        error: Option<f64>,
    ) -> (Vec<LogRow>, WholeLog) {
        let rows = times_s.iter().zip(stamps_s).map(|(&t, &stamp)| {
            let (q, qd) = motion(t);
            let qd = error.map(|error| qd + error * (7e4 * t).sin());
            let before = [stamp, q, 3.0 * stamp].into_iter();
            before.chain(qd).collect::<Vec<f64>>()
        });
        let velocity = if error.is_some() { ",qd1_rad_s" } else { "" };
        let (_here, path) = log_of(&format!("t_s,q1_rad,tau1_nm{velocity}"), rows);
        let mut log = WholeLog::open(&path, &first_joints(1)).expect("a sound log");
        let rows = std::iter::from_fn(|| log.next_row().expect("sound rows"));
        (rows.collect(), log)
    }

    #[test]
    fn noise_of_positions_is_that_of_rounding_and_of_late_reports() {
        let noise_at = |read: &dyn Fn(usize) -> f64| {
            let (rows, _) = written(&[0.0, 5e-3, 1e-2], &[0.0, 5e-3, 1e-2], Some(0.0));
            let rows: Vec<LogRow> = (0..4000)
                .map(|k| LogRow {
                    q: PerJoint::from_fn(1, |_| read(k)),
                    ..rows[0]
                })
                .collect();
            noise(&rows, &resolution(&rows))[0]
        };
        let path = |t_s: f64| 0.5 * (TAU * 0.5 * t_s).sin();
        let t_s = |k: usize| 5e-3 * k as f64;
        // A smooth motion has next to none, rounding to a step that over √12.
        assert!(noise_at(&|k| path(t_s(k))) < 2e-5);
        let rounded = noise_at(&|k| (path(t_s(k)) / 1e-3).round() * 1e-3) * 12_f64.sqrt();
        assert!((1e-3..1.3e-3).contains(&rounded), "{rounded:e}");
        // A sensor read every 4.6 ms is up to that late: 4.6 ms over √12 times 1.11 rad/s RMS. A few jumps do not count.
        let late = |k: usize| path((t_s(k) / 4.6e-3).floor() * 4.6e-3);
        let seen = noise_at(&|k| late(k) + if k % 500 == 0 { 0.3 } else { 0.0 });
        assert!((1e-3..2.2e-3).contains(&seen), "{seen:e}");
    }

    #[test]
    fn lost_rows_are_put_in_on_the_motion_and_the_torque() {
        // Two of four rows lost, with clock jitter.
        let times: Vec<f64> = (0..400)
            .filter(|k| k % 4 < 2)
            .map(|k| 8e-3 * f64::from(k) + 2e-4 * f64::from(k * 7 % 3 - 1))
            .collect();
        let (rows, log) = written(&times, &times, Some(0.0));
        assert_eq!((rows.len(), log.lost), (398, 198));
        assert!((log.period_s() - 8e-3).abs() < 1e-5, "{}", log.period_s());
        for row in &rows {
            let (q, _) = motion(row.t_s);
            assert!((row.q[0] - q).abs() < 1e-9, "{} at {}", row.q[0], row.t_s);
            assert!((row.tau[0] - 3.0 * row.t_s).abs() < 1e-9);
        }
        for pair in rows.windows(2) {
            let step = pair[1].t_s - pair[0].t_s;
            assert!((step - 8e-3).abs() < 5e-4, "{step}");
        }
    }

    #[test]
    fn a_log_without_losses_is_unchanged() {
        let even: Vec<f64> = (0..100).map(|k| 2e-3 * f64::from(k)).collect();
        // Timed on arrival: the second of every two came late, together with the next.
        let sent: Vec<f64> = (0..100).map(|k| 8e-3 * f64::from(k)).collect();
        let late = sent.iter().enumerate();
        let bunched = late.map(|(k, t)| t + if k % 4 == 1 { 7.5e-3 } else { 0.0 });
        let bunched: Vec<f64> = bunched.collect();
        let mut halted = even.clone();
        halted.iter_mut().skip(50).for_each(|t| *t += 1.0);
        for (name, times, stamps) in [
            ("even", even.clone(), even),
            ("bunched", sent, bunched),
            ("halted", halted.clone(), halted),
        ] {
            let (rows, log) = written(&times, &stamps, Some(0.0));
            assert_eq!((rows.len(), log.lost), (times.len(), 0), "{name}");
            for (row, t) in rows.iter().zip(times) {
                // Even, and behind by the mean delay of 1.9 ms.
                assert!((row.t_s - t).abs() < 2e-3, "{name}: {} at {t}", row.t_s);
            }
        }
    }
}
