//! A log with its lost rows put in: filters and derivatives need rows that are equally far apart.

use super::filter::median;
use super::log::{LogReader, LogRow};
use crate::robot::Robot;
use crate::table::{TableError, TableProblem};
use std::collections::VecDeque;
use std::path::Path;

/// Rows from which the period and the sources of motion are found.
const PREVIEW: usize = 4096;
/// A step in time of more than this many periods cuts the log; rows lost in a shorter one are put in.
pub(super) const GAP_PERIODS: f64 = 5.0;
/// A log with steps shorter than this many periods was timed on arrival: a long step before such a short one was a delay,
/// not a loss.
const ARRIVAL_PERIODS: f64 = 0.5;

/// Reads a log row by row, in constant memory. Rows that were lost by its clock are put in: torques and velocities on a
/// straight line between the neighbours, positions on the cubic through both and their velocities where the log has such.
///
/// Three periods of 8 ms taken for one would triple a derived velocity and add a false acceleration.
pub struct WholeLog<const N: usize> {
    reader: LogReader<N>,
    preview: Vec<LogRow<N>>,
    period_s: f64,
    timed_on_arrival: bool,
    last: Option<LogRow<N>>,
    waiting: VecDeque<LogRow<N>>,
    lost: usize,
}

impl<const N: usize> WholeLog<N> {
    /// Opens a log and reads its first rows.
    ///
    /// Errors: [`TableError`] of the header or of one of these rows; fewer than three rows.
    pub fn open(path: &Path, robot: &Robot) -> Result<Self, TableError> {
        let mut reader = LogReader::<N>::open(path, robot)?;
        let mut first = Vec::new();
        while first.len() < PREVIEW
            && let Some(row) = reader.next_row()?
        {
            first.push(row);
        }
        if first.len() < 3 {
            return Err(TableProblem::Empty.at(path, None));
        }
        let mut steps: Vec<f64> = first.windows(2).map(|p| p[1].t_s - p[0].t_s).collect();
        let period_s = median(&mut steps);
        let mut log = Self {
            reader,
            preview: Vec::new(),
            period_s,
            timed_on_arrival: steps.iter().any(|&step| step < ARRIVAL_PERIODS * period_s),
            last: None,
            waiting: VecDeque::new(),
            lost: 0,
        };
        for row in first {
            log.take(row);
        }
        if log.lost > 0 {
            // The steps scatter about two lengths now, and their median lies at the edge of the shorter.
            let periods: f64 = steps.iter().map(|step| log.periods(*step)).sum();
            log.period_s = steps.iter().sum::<f64>() / periods;
        }
        log.preview = log.waiting.iter().copied().collect();
        Ok(log)
    }

    /// The columns of the log.
    pub(super) fn reader(&self) -> &LogReader<N> {
        &self.reader
    }

    /// The first rows, those put in included.
    pub(super) fn preview(&self) -> &[LogRow<N>] {
        &self.preview
    }

    /// Time between two rows, s.
    pub(super) fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Rows put in so far.
    pub(super) fn lost(&self) -> usize {
        self.lost
    }

    /// The next row, `None` at the end.
    ///
    /// Errors: [`TableError`] of that row, naming line and column.
    pub fn next_row(&mut self) -> Result<Option<LogRow<N>>, TableError> {
        if self.waiting.is_empty()
            && let Some(row) = self.reader.next_row()?
        {
            self.take(row);
        }
        Ok(self.waiting.pop_front())
    }

    /// Periods in a step of time, s; 1 where the clock shows no loss.
    fn periods(&self, step_s: f64) -> f64 {
        let periods = step_s / self.period_s;
        if self.timed_on_arrival || periods > GAP_PERIODS {
            1.0
        } else {
            periods.round().max(1.0)
        }
    }

    /// Queues `row` and the rows lost before it.
    fn take(&mut self, row: LogRow<N>) {
        if let Some(last) = self.last.replace(row) {
            let periods = self.periods(row.t_s - last.t_s) as usize;
            let has_velocity = self.reader.has_velocity();
            for k in 1..periods {
                let part = k as f64 / periods as f64;
                self.waiting
                    .push_back(between(&last, &row, part, has_velocity));
            }
            self.lost += periods - 1;
        }
        self.waiting.push_back(row);
    }
}

/// The row that is `part` of the way from `a` to `b`.
///
/// Positions with h = the step in time, s = `part` [Hermite]:
/// ```text
/// q = q_a + (q_b − q_a) s² (3 − 2s) + h s (1 − s) (qd_a (1 − s) − qd_b s)
/// ```
fn between<const N: usize>(
    a: &LogRow<N>,
    b: &LogRow<N>,
    part: f64,
    has_velocity: bool,
) -> LogRow<N> {
    let line = |a: &[f64; N], b: &[f64; N]| -> [f64; N] {
        std::array::from_fn(|joint| a[joint] + (b[joint] - a[joint]) * part)
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
            std::array::from_fn(cubic)
        } else {
            line(&a.q, &b.q)
        },
        qd: line(&a.qd, &b.qd),
        qdd: line(&a.qdd, &b.qdd),
        tau: line(&a.tau, &b.tau),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(t: f64) -> (f64, f64) {
        (
            0.3 - t + 2.0 * t * t - 0.7 * t.powi(3),
            -1.0 + 4.0 * t - 2.1 * t * t,
        )
    }

    /// Rows of a log of one joint that moves on a cubic, at these times.
    fn read(name: &str, times_s: &[f64]) -> (Vec<LogRow<1>>, WholeLog<1>) {
        let path = std::env::temp_dir().join(format!("foretorque-{name}-{}", std::process::id()));
        let mut text = "t_s,q1_rad,qd1_rad_s,tau1_nm\n".to_owned();
        for &t in times_s {
            let (q, qd) = motion(t);
            text += &format!("{t},{q},{qd},{}\n", 3.0 * t);
        }
        std::fs::write(&path, text).expect("a directory for temporary files");
        let mut robot = Robot::load("ur5").expect("built in");
        robot.joints.truncate(1);
        let mut log = WholeLog::<1>::open(&path, &robot).expect("a sound log");
        let mut rows = Vec::new();
        while let Some(row) = log.next_row().expect("sound rows") {
            rows.push(row);
        }
        std::fs::remove_file(path).expect("it was just written");
        (rows, log)
    }

    #[test]
    fn lost_rows_are_put_in_on_the_motion_and_the_torque() {
        // Two of four rows lost, with clock jitter.
        let times: Vec<f64> = (0..400)
            .filter(|k| k % 4 < 2)
            .map(|k| 8e-3 * f64::from(k) + 2e-4 * f64::from(k * 7 % 3 - 1))
            .collect();
        let (rows, log) = read("lost", &times);
        assert_eq!((rows.len(), log.lost()), (398, 198));
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
        let bunched: Vec<f64> = (0..100)
            .map(|k| 8e-3 * f64::from(k) + if k % 4 == 1 { 7.5e-3 } else { 0.0 })
            .collect();
        let mut halted = even.clone();
        halted.iter_mut().skip(50).for_each(|t| *t += 1.0);
        for (name, times) in [("even", even), ("bunched", bunched), ("halted", halted)] {
            let (rows, log) = read(name, &times);
            let read: Vec<f64> = rows.iter().map(|row| row.t_s).collect();
            assert_eq!((read, log.lost()), (times, 0), "{name}");
        }
    }
}
