//! The log of a simulated arm: sensor readings and desired motion.

use foretorque_workbench::closed_loop::TickRecord;
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::table::{TableWriter, joint_columns, state_columns};
use nalgebra::{Matrix3, SMatrix};
use std::collections::VecDeque;
use std::io;
use std::path::Path;

/// Rows of a local quadratic: 31 ms at 1 kHz, half of the board's own filter. Encoder steps of 17 bits leave noise of
/// 0.3 mrad/s and 0.07 rad/s².
const WINDOW: usize = 31;

/// Writes position and torque as measured, velocity and acceleration as slopes of the measured positions, and the desired
/// positions.
///
/// The set-point's velocities do not belong into a log that is identified from: where tracking is good they pass for
/// measured ones, and they are not (a share of a per cent that identification then finds in the parameters).
pub(super) struct MotionLog<const N: usize> {
    table: TableWriter,
    waiting: VecDeque<Row<N>>,
    /// Rows at the front of `waiting` that have been written.
    written: usize,
    /// Drive gains, N·m/A, where the log has currents.
    gains: Option<Joints<N>>,
    answered: bool,
}

struct Row<const N: usize> {
    t_s: f64,
    q: Joints<N>,
    tau: Joints<N>,
    desired: Joints<N>,
    answer: Option<Vec<f64>>,
}

impl<const N: usize> MotionLog<N> {
    /// Starts a log.
    ///
    /// * `answered` its last columns are the board's feed-forward and its flags
    /// * `beside` the log is written as MCAP too
    /// * `gains` drive gains, N·m/A, by which the log has motor currents, A, in the place of torques
    pub(super) fn create(
        path: &Path,
        beside: bool,
        gains: Option<Joints<N>>,
        answered: bool,
    ) -> io::Result<Self> {
        let mut header = vec!["t_s".to_owned()];
        header.extend(state_columns(N));
        header.extend(match gains {
            None => joint_columns("tau", "nm", N),
            Some(_) => joint_columns("i", "a", N),
        });
        header.extend(joint_columns("desired", "rad", N));
        if answered {
            header.extend(joint_columns("feed_forward", "nm", N));
            header.push("flags".to_owned());
        }
        Ok(Self {
            table: match beside {
                true => TableWriter::with_mcap(path, &header)?,
                false => TableWriter::create(path, &header)?,
            },
            waiting: VecDeque::with_capacity(WINDOW),
            written: 0,
            gains,
            answered,
        })
    }

    /// Adds what was reported of a tick; what is lost on the way is in no log. It is written when the rows after it are
    /// known.
    pub(super) fn add(&mut self, record: &TickRecord<N>) -> io::Result<()> {
        let Some(seen) = record.reported else {
            return Ok(());
        };
        if self.waiting.len() == WINDOW {
            self.waiting.pop_front();
            self.written = self.written.saturating_sub(1);
        }
        self.waiting.push_back(Row {
            t_s: record.t_s,
            q: seen.q,
            tau: match &self.gains {
                None => seen.tau,
                Some(gains) => seen.tau.component_div(gains),
            },
            desired: record.desired.q,
            answer: self.answered.then(|| {
                let torque = record.feed_forward.iter().map(|tau| f64::from(*tau));
                torque.chain([f64::from(record.flags)]).collect()
            }),
        });
        if self.waiting.len() == WINDOW {
            self.write_to(WINDOW / 2 + 1)?;
        }
        Ok(())
    }

    /// Writes what is left and gives the file its name.
    pub(super) fn finish(mut self) -> io::Result<()> {
        self.write_to(self.waiting.len())?;
        self.table.finish()
    }

    /// Writes the waiting rows before `end`.
    fn write_to(&mut self, end: usize) -> io::Result<()> {
        let slopes = Quadratic::through(&self.waiting);
        for row in self.waiting.iter().take(end).skip(self.written) {
            let (qd, qdd) = slopes.at(row.t_s);
            let joints = [&row.q, &qd, &qdd, &row.tau, &row.desired];
            let values = joints.into_iter().flat_map(|joints| joints.iter());
            let answer = row.answer.iter().flatten();
            let values = std::iter::once(&row.t_s).chain(values).chain(answer);
            self.table.row(values)?;
        }
        self.written = self.written.max(end);
        Ok(())
    }
}

/// Adds `powers[i] * factors[j]` to row `i` of column `j`.
fn add_products<const C: usize>(sums: &mut [[f64; 3]; C], powers: [f64; 3], factors: [f64; C]) {
    for (column, factor) in sums.iter_mut().zip(factors) {
        for (sum, power) in column.iter_mut().zip(powers) {
            *sum += power * factor;
        }
    }
}

/// `q(t) = c0 + c1 t + c2 t²` by least squares around a middle               [Savitzky and Golay 1964, for uneven rows]
struct Quadratic<const N: usize> {
    middle_s: f64,
    /// Rows: c1, rad/s, and 2 c2, rad/s², of every joint.
    slopes: [Joints<N>; 2],
}

impl<const N: usize> Quadratic<N> {
    /// Fewer than three rows are at rest.
    fn through(rows: &VecDeque<Row<N>>) -> Self {
        let ends = [rows.front(), rows.back()].map(|row| row.map_or(0.0, |row| row.t_s));
        let middle_s = 0.5 * (ends[0] + ends[1]);
        let half_s = (0.5 * (ends[1] - ends[0])).max(f64::MIN_POSITIVE);
        let (mut gram, mut moment) = ([[0.0; 3]; 3], [[0.0; 3]; N]);
        let first = rows.front().map_or(Joints::zeros(), |row| row.q);
        for row in rows {
            let k = (row.t_s - middle_s) / half_s;
            let powers = [1.0, k, k * k];
            add_products(&mut gram, powers, powers);
            // Differences from the first row: positions lose no digits to their size.
            add_products(&mut moment, powers, (row.q - first).into());
        }
        let still = SMatrix::zeros();
        let fit = Matrix3::from(gram)
            .cholesky()
            .map_or(still, |gram| gram.solve(&SMatrix::from(moment)));
        let few = rows.len() < 3;
        let slope = |power: usize, scale: f64| {
            let row = fit.row(power).transpose() * scale;
            if few { Joints::zeros() } else { row }
        };
        Self {
            middle_s,
            slopes: [slope(1, 1.0 / half_s), slope(2, 2.0 / (half_s * half_s))],
        }
    }

    /// Velocity and acceleration at a time, rad/s and rad/s².
    fn at(&self, t_s: f64) -> (Joints<N>, Joints<N>) {
        let [velocity, acceleration] = &self.slopes;
        let moved = acceleration * (t_s - self.middle_s);
        (velocity + moved, *acceleration)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::PERIOD_S;
    use foretorque::joint::JointVector;
    use foretorque_workbench::dynamics::State;
    use foretorque_workbench::plant::Measurement;
    use foretorque_workbench::table::read_states;

    fn record(tick: usize) -> TickRecord<1> {
        let t_s = tick as f64 * PERIOD_S;
        let q = Joints::<1>::repeat(1.0 + (3.0 * t_s).sin());
        let tau = Joints::repeat(7.0);
        let reported = Measurement { q, tau };
        TickRecord {
            t_s,
            desired: State::rest(Joints::repeat(9.0)),
            q,
            measured: Measurement { q: tau, tau: q },
            reported: Some(reported),
            tau: Joints::zeros(),
            feed_forward: JointVector::zeros(),
            shares: None,
            flags: 0,
            stage: None,
        }
    }

    #[test]
    fn every_tick_is_written_once_with_the_slopes_of_the_measured_positions() {
        let here = tempfile::tempdir().expect("creates");
        let path = here.path().join("motion.csv");
        for ticks in [1, 2, 5, 30, 31, 32, 200] {
            let mut log = MotionLog::<1>::create(&path, false, None, true).expect("creates");
            for tick in 0..ticks {
                log.add(&record(tick)).expect("writes");
            }
            let mut lost = record(ticks);
            lost.reported = None;
            log.add(&lost).expect("writes");
            log.finish().expect("finishes");
            let rows = read_states::<1>(&path).expect("reads");
            assert_eq!(rows.len(), ticks);
            for (tick, (row_s, motion)) in rows.into_iter().enumerate() {
                let t_s = tick as f64 * PERIOD_S;
                assert_eq!(row_s, t_s);
                assert_eq!(motion.q[0], 1.0 + (3.0 * t_s).sin());
                if ticks >= 5 {
                    // A quadratic over 31 ms of 3 rad/s: the third derivative shows at the ends only.
                    assert!((motion.qd[0] - 3.0 * (3.0 * t_s).cos()).abs() < 5e-3);
                    assert!((motion.qdd[0] + 9.0 * (3.0 * t_s).sin()).abs() < 0.5);
                }
            }
        }
    }
}
