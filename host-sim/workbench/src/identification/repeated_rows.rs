//! Rows that repeat the one before: those of a slower sensor, of lost readings, or of a resting arm.

use super::log::LogRow;
use foretorque::learning::MAX_BRIDGED;

/// Resolution of the positions, rad: the least change from a row to the next; 0 at rest.
pub(super) fn resolution(rows: &[LogRow]) -> Vec<f64> {
    let joints = rows.first().map_or(0, |row| row.q.len());
    let least = |joint: usize| {
        let pairs = rows.windows(2);
        let steps = pairs.map(|pair| (pair[1].q[joint] - pair[0].q[joint]).abs());
        let least = steps.filter(|step| *step > 0.0).reduce(f64::min);
        least.unwrap_or_default()
    };
    (0..joints).map(least).collect()
}

/// Rows that hold the readings of a slower sensor.
pub(super) struct Held {
    /// Rows of one reading of the sensor.
    pub(super) times: usize,
    /// The torques of these rows repeat, too.
    torques: bool,
    /// Most rows in turn that repeat a row of a moving arm, where each row should be a reading.
    copies: usize,
    last: Option<LogRow>,
    /// Rows that repeat the last one so far.
    count: usize,
    /// Those of them that are left out unless more follow: then the arm rests.
    waiting: Vec<LogRow>,
    /// Rows of a moving arm that were left out so far.
    pub(super) left_out: usize,
}

impl Held {
    /// Runs of equal rows of a moving arm from which sensors count as slower than the log.
    const RUNS: usize = 20;
    /// Share of the runs that has neighbouring lengths: those of values that come back by chance scatter.
    const ALIKE: f64 = 0.8;

    pub(super) fn of(rows: &[LogRow]) -> Self {
        let with_torques = |a: &LogRow, b: &LogRow| (a.q, a.tau) == (b.q, b.tau);
        let alone = |a: &LogRow, b: &LogRow| a.q == b.q;
        let held = Self::are_held(rows);
        let positions = Self::times(rows, alone).filter(|_| held);
        // Torques may be read more often.
        let times = positions.or_else(|| Self::times(rows, with_torques));
        Self {
            times: times.unwrap_or(1),
            torques: positions.is_none(),
            copies: if held { MAX_BRIDGED } else { 0 },
            last: None,
            count: 0,
            waiting: Vec::new(),
            left_out: 0,
        }
    }

    /// Rows of one reading, where most runs of `same` rows are alike.
    fn times(rows: &[LogRow], same: impl Fn(&LogRow, &LogRow) -> bool) -> Option<usize> {
        let mut runs: Vec<usize> = rows.chunk_by(same).map(<[LogRow]>::len).collect();
        runs.sort_unstable();
        let median = runs.get(runs.len() / 2).copied().unwrap_or(1);
        let spread = 1 + median / 10;
        let alike = |least: usize| {
            let lengths = least..=least + spread;
            let alike = runs.iter().filter(|run| lengths.contains(run));
            alike.count() as f64 >= Self::ALIKE * runs.len() as f64
        };
        let slower = runs.len() >= Self::RUNS && (median - spread.min(median)..=median).any(alike);
        (slower && median > 1).then_some(median)
    }

    /// Positions that do not change were not read: where they change, most changes are of more than one step of the encoder.
    fn are_held(rows: &[LogRow]) -> bool {
        let steps = resolution(rows);
        let (mut changes, mut wide) = (0.0, 0.0);
        for pair in rows.windows(2).filter(|pair| pair[0].q != pair[1].q) {
            let apart = pair[1].q.iter().zip(pair[0].q.iter());
            let mut apart = apart
                .zip(&steps)
                .map(|((to, from), step)| (to - from).abs() / step);
            changes += 1.0;
            wide += f64::from(apart.any(|steps| steps > 1.5));
        }
        changes > 0.0 && wide >= Self::ALIKE * changes
    }

    /// Rows that are readings of their own, now that `row` follows. Values that stay for two readings, or for more rows than a log
    /// may lose, are those of a resting arm.
    pub(super) fn readings(&mut self, row: LogRow) -> Vec<LogRow> {
        let same = |last: &LogRow| last.q == row.q && (!self.torques || last.tau == row.tau);
        if !self.last.as_ref().is_some_and(same) {
            self.waiting.clear();
            (self.last, self.count) = (Some(row), 0);
            return vec![row];
        }
        self.count += 1;
        if self.times > 1 {
            let rests = self.count >= 2 * self.times && self.count.is_multiple_of(self.times);
            return if rests { vec![row] } else { Vec::new() };
        }
        self.waiting.push(row);
        self.left_out += 1;
        if self.count <= self.copies {
            return Vec::new();
        }
        self.left_out -= self.waiting.len();
        std::mem::take(&mut self.waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::super::log_tests::{first_joints, log_of};
    use super::super::whole_log::WholeLog;
    use super::super::whole_log::tests::{motion, written};
    use super::*;
    use crate::dynamics::PerJoint;

    /// Whole log of a joint in rows of 10 ms, without velocities, each of which has the reading of this instant, s.
    fn repeating(instant_s: impl Fn(u32) -> f64) -> (Vec<LogRow>, WholeLog) {
        let rows = (0..150).map(|k| {
            let t_s = instant_s(k);
            vec![1e-2 * f64::from(k), motion(t_s).0, 3.0 * t_s]
        });
        let (_here, path) = log_of("t_s,q1_rad,tau1_nm", rows);
        let mut log = WholeLog::open(&path, &first_joints(1)).expect("a sound log");
        let rows = std::iter::from_fn(|| log.next_row().expect("sound rows"));
        (rows.collect(), log)
    }

    #[test]
    fn rows_that_repeat_now_and_then_are_lost_or_those_of_a_slower_sensor() {
        // Every fourth reading is lost, then every fourth row has no reading yet, then the arm rests.
        let lost = |k: u32| 1e-2 * f64::from(if k % 4 == 3 { k - 1 } else { k });
        let slower = |k: u32| 1.31e-2 * (f64::from(k) / 1.31).floor();
        let rests = |k: u32| 1e-2 * f64::from(k.min(70));
        let (rows, log) = repeating(lost);
        assert_eq!((rows.len(), log.lost, log.held.left_out), (150, 37, 37));
        // Of a straight line over 20 ms at 4 rad/s².
        for row in rows {
            assert!((row.q[0] - motion(row.t_s).0).abs() < 2.1e-4, "{row:?}");
        }
        let (rows, log) = repeating(slower);
        assert_eq!((rows.len(), log.lost), (114, 0));
        assert!(
            (log.period_s() - 1.31e-2).abs() < 1e-4,
            "{}",
            log.period_s()
        );
        for (k, row) in (0..).zip(rows) {
            assert!(
                (row.q[0] - motion(1.31e-2 * f64::from(k)).0).abs() < 1e-9,
                "{row:?}"
            );
        }
        let (rows, log) = repeating(rests);
        assert_eq!((rows.len(), log.lost, log.held.left_out), (150, 0, 0));
        assert!((log.period_s() - 1e-2).abs() < 1e-9);
    }

    #[test]
    fn of_rows_that_repeat_their_positions_one_is_kept() {
        let stamps: Vec<f64> = (0..400).map(|k| 2.5e-3 * f64::from(k)).collect();
        let kept = |read: &dyn Fn(i32) -> i32| {
            let times: Vec<f64> = (0..400).map(|k| 2.5e-3 * f64::from(read(k))).collect();
            let (rows, log) = written(&times, &stamps, Some(0.0));
            let notes = log.notes.concat();
            let note = notes.split_once("positions repeat in ");
            let note = note.map(|(_, note)| note.to_owned());
            (rows, log.period_s(), note)
        };
        let (rows, period_s, note) = kept(&|k| k / 4 * 4);
        let expected = "4 rows: they were read at 100 Hz, and one row of 4 is kept";
        assert_eq!(note.as_deref(), Some(expected));
        assert!((period_s - 0.01).abs() < 1e-9, "{period_s}");
        assert_eq!(rows.len(), 100);
        for row in rows {
            assert!((row.q[0] - motion(row.t_s).0).abs() < 1e-9, "{}", row.t_s);
        }
        // 160 Hz in 400 rows a second, every reading in two or three rows.
        let (rows, period_s, _) = kept(&|k| k * 2 / 5 * 5 / 2);
        assert!((period_s - 6.25e-3).abs() < 1e-4, "{period_s}");
        assert_eq!(rows.len(), 160);
        // 42 Hz in rows that are late by chance: every reading in 9 to 11 rows.
        let starts: Vec<i32> = (0..40)
            .map(|k| 10 * k - [0, 1, 0, -1][k as usize % 4])
            .collect();
        let begun = |k: i32| starts.iter().rev().find(|start| **start <= k);
        let (rows, period_s, _) = kept(&|k| *begun(k).unwrap_or(&0));
        assert_eq!(rows.len(), 40);
        assert!((period_s - 25e-3).abs() < 1e-3, "{period_s}");
        // Every row is read, the arm rests first, and values that come back by chance.
        let chance = |k: i32| k - [0, 1, 2, 3, 0, 1, 0, 0, 1, 2, 0][k as usize % 11];
        for read in [&(|k| k) as &dyn Fn(i32) -> i32, &|k| k.max(200), &chance] {
            let (rows, _, note) = kept(read);
            assert_eq!((rows.len(), note), (400, None));
        }
        // Torques that are read twice as often.
        let row = |k: i32| LogRow {
            line: 0,
            t_s: stamps[k as usize],
            q: PerJoint::repeat(1, motion(2.5e-3 * f64::from(k / 8 * 8)).0),
            qd: PerJoint::repeat(1, 0.0),
            qdd: PerJoint::repeat(1, 0.0),
            tau: PerJoint::repeat(1, f64::from(k / 4)),
        };
        assert_eq!(Held::of(&(0..400).map(row).collect::<Vec<_>>()).times, 8);
        // Encoders whose steps are as long as the way in two rows.
        let coarse = (0..400).map(|k: u32| {
            let position = 1.5e-3 * f64::from(k * 10 / 19);
            [2.5e-3 * f64::from(k), position, 0.01 * f64::from(k % 7)]
        });
        let (_here, path) = log_of("t_s,q1_rad,tau1_nm", coarse);
        let log = WholeLog::open(&path, &first_joints(1)).expect("a sound log");
        assert_eq!(log.preview.len(), 400);
    }
}
