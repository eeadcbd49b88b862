//! Logs as prepared rows: as a stream of stretches, or a periodic one folded into one period.

use super::clock::{GAP_PERIODS, mean_period_s};
use super::columns::Layout;
use super::filter::{Harmonics, despiked};
use super::log::{LogReader, LogRow};
use super::normal::SpeedSums;
use super::prepare::{Preparation, PrepareConfig, Prepared, states};
use super::whole_log::{FOLLOWED, WholeLog, too_short};
use super::{IdentifyError, refused};
use crate::Refusal;
use crate::parallel::{cores, in_parallel};
use crate::robot::Robot;
use crate::table::TableError;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;
use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};

/// Rows of one stretch, margins apart. Large against the margins, small enough for a few of them in memory.
const STRETCH: usize = 16_384;

/// Rows of a log, with those around them that its filters need, and the ones that count.
type Stretch = (Vec<LogRow>, Range<usize>);

/// Gaps that are noted one by one.
const GAPS: usize = 3;

/// Prepares a log stretch by stretch on all cores and passes every stretch to `take` in the order of the log, so that sums
/// are the same in every run. Memory does not grow with the log.
///
/// * `notes` receives derived columns and gaps
///
/// Errors: [`TableError`] of the first bad row, perhaps after some stretches.
pub fn for_each_prepared(
    path: &Path,
    robot: &Robot,
    layout: &Layout,
    config: &PrepareConfig,
    notes: &mut Vec<String>,
    take: &mut dyn FnMut(&Preparation, Prepared),
) -> Result<Preparation, TableError> {
    let mut log = WholeLog::open(path, robot)?;
    let preparation = Preparation::of_log(&log, config, path, notes);
    let (workers, cut) = (cores(), &preparation);
    std::thread::scope(|scope| {
        let (to_workers, stretches) = sync_channel(workers);
        let reading = scope.spawn(move || cut_into_stretches(&mut log, cut, path, &to_workers));
        loop {
            let batch: Vec<Stretch> = stretches.iter().take(workers).collect();
            if batch.is_empty() {
                break;
            }
            let prepare = |(rows, core): &Stretch| Prepared::new(rows, core, cut, layout);
            for prepared in in_parallel(workers, &batch, prepare, || ()) {
                take(cut, prepared);
            }
        }
        match reading.join() {
            Ok(outcome) => notes.extend(outcome?),
            Err(panic) => std::panic::resume_unwind(panic),
        }
        Ok::<_, TableError>(())
    })?;
    Ok(preparation)
}

/// Sends the log to the workers in stretches with margins; returns notes on gaps and lost rows.
fn cut_into_stretches(
    log: &mut WholeLog,
    preparation: &Preparation,
    path: &Path,
    to_workers: &SyncSender<Stretch>,
) -> Result<Vec<String>, TableError> {
    let (mut notes, name, mut gaps) = (Vec::new(), path.display(), 0);
    let (margin, edge) = (preparation.margin(), preparation.edge());
    // Rows not yet sent with the margin before them; `begin` is where the unsent core starts.
    let mut rows: Vec<LogRow> = Vec::new();
    let mut begin = edge;
    let send = |stretch: Stretch| {
        // The receiver is gone only when a worker has panicked, which the scope reports.
        let _ = to_workers.send(stretch);
    };
    loop {
        let row = log.next_row()?;
        let pair = row.as_ref().zip(rows.last());
        let step = pair.map_or(0.0, |(row, last)| row.t_s - last.t_s);
        let gap = step > GAP_PERIODS * preparation.period_s;
        gaps += usize::from(gap);
        if let (true, Some(row)) = (gap && gaps <= GAPS, &row) {
            notes.push(format!(
                "{name}:{}: column t_s: gap of {step:.4} s, more than four lost rows: split here",
                row.line
            ));
        }
        if gap || row.is_none() {
            let end = rows.len().saturating_sub(edge);
            let rows = std::mem::take(&mut rows);
            if begin < end {
                send((rows, begin..end));
            }
            begin = edge;
        } else if rows.len() >= begin + STRETCH + margin {
            let end = begin + STRETCH;
            let keep = end.saturating_sub(margin);
            let rest = rows[keep..].to_vec();
            send((std::mem::replace(&mut rows, rest), begin..end));
            begin = end - keep;
        }
        match row {
            Some(row) => rows.push(row),
            None => break,
        }
    }
    if gaps > GAPS {
        let more = gaps - GAPS;
        notes.push(format!(
            "{name}: {more} more gaps in its times: split there, too"
        ));
    }
    notes.extend(log.reader.wraps());
    if log.lost > 0 {
        notes.push(format!(
            "{name}: {} rows are missing according to its clock and were interpolated",
            log.lost
        ));
    }
    if log.held.left_out > 0 {
        notes.push(format!(
            "{name}: {} rows repeat the one before and were left out",
            log.held.left_out
        ));
    }
    Ok(notes)
}

/// Rows of one search for spikes.
const CHUNK: usize = 16_384;
/// Largest distance of a row from its even place, share of the time between rows.
const UNEVEN: f64 = 0.25;
/// Most products of a number with a harmonic: minutes of work.
const MOST_PRODUCTS: f64 = 1e11;

/// Folds a log whose motion repeats every `period_s` into one period and prepares it. Memory is that of one period.
///
/// Everything between the harmonics of a periodic motion is noise: averaging and projection remove it without edges, and
/// the derivatives of the series are exact [Swevers et al. 1997]. Regressor and torque share the harmonics.
///
/// Errors: [`TableError`] of a bad row; one line when the period is no whole number of rows or too long, a row is out of
/// place, or the log is shorter than the period.
pub(super) fn folded(
    path: &Path,
    robot: &Robot,
    layout: &Layout,
    config: &PrepareConfig,
    period_s: f64,
    notes: &mut Vec<String>,
) -> Result<(Preparation, Prepared), IdentifyError> {
    let mut reader = LogReader::open(path, robot)?;
    let name = path.display();
    let mut chunk: Vec<LogRow> = Vec::with_capacity(CHUNK);
    let mut fold: Option<Fold> = None;
    loop {
        let row = reader.next_row()?;
        chunk.extend(row);
        if chunk.len() == CHUNK || row.is_none() {
            let fold = match &mut fold {
                Some(fold) => fold,
                None => fold.insert(Fold::new(&chunk, period_s, layout, config, path)?),
            };
            fold.add(&chunk, config, path)?;
            chunk.clear();
        }
        if row.is_none() {
            break;
        }
    }
    let mut fold = fold.ok_or_else(|| TableError::empty(path))?;
    notes.extend_from_slice(&reader.notes);
    notes.extend(reader.wraps());
    let run_in = if fold.leave_run_in() {
        ", the first left out"
    } else {
        ""
    };
    if !fold.is_whole() {
        let problem = format!("the log does not show a whole period of {period_s} s");
        return Err(refused(path, problem));
    }
    let phases = fold.sums.ncols();
    let Some(late_rows) = fold.late_rows() else {
        let problem = format!(
            "the positions do not repeat every {period_s} s: cut off what is not the excitation, or give its period"
        );
        return Err(refused(path, problem));
    };
    if late_rows.abs() > 0.5 {
        let found = period_s - late_rows * fold.row_s;
        let problem = format!("the positions repeat every {found:.5} s, not every {period_s} s");
        return Err(refused(path, problem));
    }
    let (of_motion, of_torque) = fold.harmonics;
    let on = of_torque.map_or("as they are".to_owned(), |count| format!("on {count}"));
    notes.push(format!(
        "{name}: {:.2} periods of {period_s} s folded into one{run_in}; motion on {of_motion} harmonics, torque and regressor {on}",
        fold.sums.row(0).sum() / phases as f64
    ));
    let mut preparation = fold.preparation(config);
    let stride = |count: usize| (phases / (2 * count + 1)).max(1);
    preparation.folded_stride = Some(of_torque.map_or(1, stride));
    let raw = fold.period(of_motion, period_s);
    let prepared = raw.filled(&preparation, layout, &|table, width| {
        if let Some(count) = of_torque {
            let harmonics = Harmonics::of(table, width, count);
            table.copy_from_slice(&harmonics.evaluate(0, period_s));
        }
    });
    Ok((preparation, prepared))
}

/// Periods from which the first one is left out: the arm runs in.
const PERIODS: usize = 3;

/// Sums over all periods at each phase.
struct Fold {
    start_s: f64,
    row_s: f64,
    /// Rows by which the clock of the log is late.
    late: f64,
    /// Harmonics of the motion, and of torque and regressor where these have a cut-off.
    harmonics: (usize, Option<usize>),
    joints: usize,
    /// One column a phase: rows, their times, positions, torques, and torques without spikes.
    sums: DMatrix<f64>,
    /// Those of the first period, once it is over.
    first: Option<DMatrix<f64>>,
    /// Rows so far, lost ones included.
    rows: usize,
    spikes: usize,
    /// Positions of the period before, phase by phase.
    period_before: Vec<Option<f64>>,
    /// Positions of the row before.
    row_before: Vec<f64>,
    /// Σ Δq², Σ Δq dq, Σ dq² with the change Δq of a position from one period to the next, and dq from row to row: a period that
    /// is too long by δ rows makes Δq = δ dq.
    apart: [f64; 3],
    /// Rows, Σ q, Σ q², joint by joint.
    motion: Vec<[f64; 3]>,
}

/// Largest part of the motion that may differ from period to period.
const DIFFERENT: f64 = 0.01;

impl Fold {
    /// Rows by which the period is too long; `None` where the positions do not repeat.
    fn late_rows(&self) -> Option<f64> {
        let [differences, shift, steps] = self.apart;
        let variances = self
            .motion
            .iter()
            .map(|[rows, sum, square]| square - sum * sum / rows);
        if steps == 0.0 {
            // One period, or an arm at rest.
            return Some(0.0);
        }
        let rest = differences - shift * shift / steps;
        (rest <= DIFFERENT * variances.sum::<f64>()).then_some(shift / steps)
    }

    fn new(
        first: &[LogRow],
        period_s: f64,
        layout: &Layout,
        config: &PrepareConfig,
        path: &Path,
    ) -> Result<Self, IdentifyError> {
        if first.len() < 3 {
            return Err(too_short(path, first.len()).into());
        }
        let row_s = mean_period_s(first);
        let phases = (period_s / row_s).round();
        if phases < 3.0 || (phases * row_s - period_s).abs() > UNEVEN * row_s {
            let rows = format!("rows, which are {row_s:.6} s apart");
            let problem = format!("a period of {period_s} s is no whole number of {rows}");
            return Err(refused(path, problem));
        }
        let (phases, joints) = (phases as usize, first[0].q.len());
        let below = |hz: f64| ((hz * period_s) as usize).clamp(1, (phases - 1) / 2);
        let harmonics = (below(config.motion_hz), config.torque_hz.map(below));
        let numbers = harmonics.0 * joints + harmonics.1.unwrap_or(0) * layout.width;
        if phases as f64 * numbers as f64 > MOST_PRODUCTS {
            let problem = format!(
                "a period of {period_s} s has {phases} rows and {} harmonics, too many to project: give a shorter period, a lower --motion-hz and --torque-hz, or fewer rows a second",
                harmonics.0
            );
            return Err(refused(path, problem));
        }
        Ok(Self {
            start_s: first[0].t_s,
            row_s: period_s / phases as f64,
            late: 0.0,
            harmonics,
            joints,
            sums: DMatrix::zeros(2 + 3 * joints, phases),
            first: None,
            rows: 0,
            spikes: 0,
            period_before: vec![None; phases * joints],
            row_before: Vec::new(),
            apart: [0.0; 3],
            motion: vec![[0.0; 3]; joints],
        })
    }

    fn add(
        &mut self,
        rows: &[LogRow],
        config: &PrepareConfig,
        path: &Path,
    ) -> Result<(), IdentifyError> {
        let joints = self.joints;
        let tau: Vec<f64> = rows.iter().flat_map(|row| row.tau.to_vec()).collect();
        let reach = self.preparation(config).spike_reach();
        let (clean, spikes) = despiked(&tau, joints, reach);
        self.spikes += spikes;
        for (row, clean) in rows.iter().zip(clean.chunks_exact(joints)) {
            let place = (row.t_s - self.start_s) / self.row_s;
            let off = place - self.late - (place - self.late).round();
            // The clocks of log and motion are not quite the same.
            self.late += FOLLOWED * off;
            if off.abs() > UNEVEN {
                let (name, line, t_s) = (path.display(), row.line, row.t_s);
                return Err(IdentifyError::Refused(Refusal(format!(
                    "{name}:{line}: column t_s: {t_s} is off the even spacing of {:.6} s that folding needs",
                    self.row_s
                ))));
            }
            let (place, phases) = (place.round() as usize, self.sums.ncols());
            self.rows = place + 1;
            if place >= phases && self.first.is_none() {
                self.first = Some(self.sums.clone());
                self.sums.fill(0.0);
            }
            let phase = place % phases;
            let values = [&[1.0, row.t_s], &row.q[..], &row.tau, clean].concat();
            let mut sums = self.sums.column_mut(phase);
            sums += DVector::from_vec(values);
            for (joint, &q) in row.q.iter().enumerate() {
                let last = self.period_before[phase * joints + joint].replace(q);
                if let (Some(last), Some(row)) = (last, self.row_before.get(joint)) {
                    let (apart, step) = (q - last, q - row);
                    let products = [apart * apart, apart * step, step * step];
                    let sums = self.apart.iter_mut().zip(products);
                    sums.for_each(|(sum, product)| *sum += product);
                }
                let sums = self.motion[joint].iter_mut().zip([1.0, q, q * q]);
                sums.for_each(|(sum, value)| *sum += value);
            }
            self.row_before = row.q.to_vec();
        }
        Ok(())
    }

    /// Leaves the first period out where enough others are there, which show all of it.
    fn leave_run_in(&mut self) -> bool {
        let leaves = self.rows >= PERIODS * self.sums.ncols() && self.is_whole();
        if let Some(first) = self.first.take().filter(|_| !leaves) {
            self.sums += first;
        }
        leaves
    }

    /// There is a row at every phase.
    fn is_whole(&self) -> bool {
        self.sums.row(0).iter().all(|count| *count > 0.0)
    }

    fn preparation(&self, config: &PrepareConfig) -> Preparation {
        Preparation::new(config, self.start_s, self.row_s, [false; 2])
    }

    /// The mean period, its motion on harmonics.
    fn period(self, harmonics: usize, period_s: f64) -> Prepared {
        let (joints, mut means) = (self.joints, self.sums);
        for mut phase in means.column_iter_mut() {
            phase /= phase[0];
        }
        let table = |first: usize| means.rows(first, joints).iter().copied().collect();
        let [q, tau, clean]: [Vec<f64>; 3] = [0, 1, 2].map(|k| table(2 + k * joints));
        let series = Harmonics::of(&q, joints, harmonics);
        let [q, qd, qdd] = [0, 1, 2].map(|order| series.evaluate(order, period_s));
        Prepared {
            states: states(joints, [&q, &qd, &qdd]),
            panel: Vec::new(),
            speeds: SpeedSums::new(joints),
            tau,
            clean,
            spikes: self.spikes,
            core: 0..means.ncols(),
            t_s: means.row(1).iter().copied().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::columns::ColumnSet;
    use super::super::log_tests::{first_joints, log_of};
    use super::*;
    use std::f64::consts::TAU;

    const CONFIG: PrepareConfig = PrepareConfig {
        motion_hz: 10.0,
        torque_hz: None,
        still_rad_s: PrepareConfig::STILL_RAD_S,
    };

    /// Periods of 4 s folded from rows of time, position and torque of a UR5's first joint.
    fn fold_of(
        rows: impl Iterator<Item = [f64; 3]>,
        config: &PrepareConfig,
        period_s: f64,
    ) -> Result<(Prepared, String), String> {
        let (_here, path) = log_of("t_s,q1_rad,tau1_nm", rows);
        let (robot, mut notes) = (first_joints(1), Vec::new());
        let layout = Layout::new(&robot, &ColumnSet::default());
        let found = folded(&path, &robot, &layout, config, period_s, &mut notes);
        let (_, prepared) = found.map_err(|error| error.to_string())?;
        Ok((prepared, notes.join("\n")))
    }

    /// The first joint swings once in 4 s; its torque is twice its position.
    fn swing(t_s: f64) -> [f64; 3] {
        let q = (TAU * t_s / 4.0).sin();
        [t_s, q, 2.0 * q]
    }

    #[test]
    fn large_times_and_clocks_that_are_not_quite_right_fold() {
        for (start_s, rate) in [
            (0.0, 1.0),
            (1.7e9, 1.0),
            (0.0, 1.0 + 1e-5),
            (1.7e9, 1.0 - 1e-5),
        ] {
            let rows = (0..40_000).map(|k| {
                let t_s = 1e-3 * f64::from(k);
                let [_, q, tau] = swing(t_s);
                [start_s + rate * t_s, q, tau]
            });
            let (prepared, notes) = fold_of(rows, &CONFIG, 4.0).expect("a sound log");
            assert!(notes.contains("9.00 periods of 4 s folded"), "{notes}");
            let rows = prepared.tau.iter().zip(&prepared.states);
            let apart = rows.map(|(tau, state)| (tau - 2.0 * state.q[0]).abs());
            assert!(apart.fold(0.0, f64::max) < 1e-3);
        }
        let rows = (0..400).map(|k| swing(0.0201 * f64::from(k)));
        let refused = fold_of(rows, &CONFIG, 4.03).expect_err("200.5 rows");
        assert!(refused.contains("is no whole number of rows"), "{refused}");
    }

    #[test]
    fn torques_without_a_cut_off_stay_and_endless_projections_are_refused() {
        let noisy = |k: u32| {
            let [t_s, q, _] = swing(0.02 * f64::from(k));
            [t_s, q, f64::from(k * 7919 % 101)]
        };
        let rows: Vec<[f64; 3]> = (0..200).map(noisy).collect();
        let (prepared, notes) = fold_of(rows.iter().copied(), &CONFIG, 4.0).expect("a log");
        let tau: Vec<f64> = rows.iter().map(|row| row[2]).collect();
        assert_eq!(prepared.tau, tau);
        assert!(
            notes.contains("torque and regressor as they are"),
            "{notes}"
        );
        let fast = PrepareConfig {
            motion_hz: 400.0,
            torque_hz: Some(400.0),
            ..CONFIG
        };
        let rows = (0..3).map(|k| swing(1e-3 * f64::from(k)));
        let refused = fold_of(rows, &fast, 1e4).expect_err("4e13 products");
        assert!(
            refused.contains("too many to project: give a shorter"),
            "{refused}"
        );
    }

    #[test]
    fn folding_keeps_the_remarks_of_the_reader_and_counts_its_rows() {
        let rows = (0..400).map(|k| {
            let [t_s, q, tau] = swing(0.02 * f64::from(k));
            // The joint swings about half a turn, and its angle wraps.
            let turns = if q > 0.0 { -0.5 } else { 0.5 };
            [t_s, q + turns * TAU, tau]
        });
        let (_, notes) = fold_of(rows, &CONFIG, 4.0).expect("a log");
        assert!(
            notes.contains("angles un-wrapped: joint 1 4 times"),
            "{notes}"
        );
        for (rows, wanted) in [
            (0, ": no rows"),
            (1, ": 1 rows, a mo"),
            (2, ": 2 rows, a mo"),
        ] {
            let rows = (0..rows).map(|k| swing(0.02 * f64::from(k)));
            let refused = fold_of(rows, &CONFIG, 4.0).expect_err("too short");
            assert!(refused.contains(wanted), "{refused}");
        }
    }

    /// Preparation and notes of a log of these rows of time, position, velocity and torque.
    fn prepared(rows: impl Iterator<Item = [f64; 4]>) -> (Preparation, Vec<String>) {
        let (_here, path) = log_of("t_s,q1_rad,qd1_rad_s,tau1_nm", rows);
        let (robot, mut notes) = (first_joints(1), Vec::new());
        let layout = Layout::new(&robot, &ColumnSet::default());
        let (config, take) = (&CONFIG, &mut |_: &Preparation, _| ());
        let found = for_each_prepared(&path, &robot, &layout, config, &mut notes, take);
        (found.expect("a log"), notes)
    }

    #[test]
    fn velocities_are_judged_where_the_log_has_no_gap_and_moves() {
        let moving = |t_s: f64| {
            let w = TAU / 4.0;
            [t_s, -(w * t_s).cos(), w * (w * t_s).sin(), 0.0]
        };
        let times = |rows: u32| (0..rows).map(|k| 0.02 * f64::from(k));
        let stray = std::iter::once(moving(-5.0)).chain(times(800).map(moving));
        let resting = times(800).map(|t_s| [t_s, 0.5, 0.0, 0.0]);
        let late = times(6000).map(|t_s| match t_s < 100.0 {
            true => [t_s, -1.0, 0.0, 0.0],
            false => moving(t_s),
        });
        for (name, rows) in [
            ("stray", stray.collect::<Vec<_>>()),
            ("resting", resting.collect()),
            ("late", late.collect()),
        ] {
            let (preparation, notes) = prepared(rows.into_iter());
            assert!(preparation.logged[0], "{name}: {notes:?}");
        }
        let wrong = times(800).map(|t_s| [t_s, 0.5, 0.1, 0.0]);
        let (preparation, notes) = prepared(wrong);
        assert!(!preparation.logged[0] && notes.concat().contains("velocities are not zero"));
        assert!(notes.iter().all(|note| note.len() < 250), "{notes:?}");
    }

    #[test]
    fn many_gaps_are_few_notes() {
        let rows = (0..30_000).map(|k| {
            let t_s = 0.02 * f64::from(k) + 5.0 * f64::from(k / 30);
            [t_s, t_s.sin(), t_s.cos(), 0.0]
        });
        let (_, notes) = prepared(rows);
        let gaps = notes.iter().filter(|note| note.contains("gap"));
        let gaps: Vec<&String> = gaps.collect();
        assert_eq!(gaps.len(), GAPS + 1, "{gaps:?}");
        assert!(gaps[GAPS].contains(": 996 more gaps"), "{gaps:?}");
    }

    #[test]
    fn the_first_of_three_periods_is_left_out() {
        // The torque settles in the first second; rows are lost from `lost` on.
        let torques = |periods: u32, lost: std::ops::Range<u32>| {
            let rows = (0..200 * periods).filter(|k| !lost.contains(k)).map(|k| {
                let [t_s, q, tau] = swing(0.02 * f64::from(k));
                [t_s, q, tau + 5.0 * (-4.0 * t_s).exp()]
            });
            let (prepared, notes) = fold_of(rows, &CONFIG, 4.0).expect("a log");
            let rows = prepared.tau.iter().zip(&prepared.states);
            let apart = rows.map(|(tau, state)| (tau - 2.0 * state.q[0]).abs());
            (apart.fold(0.0, f64::max), notes)
        };
        let (apart, notes) = torques(3, 0..0);
        assert!(apart < 1e-3, "{apart}");
        assert!(notes.contains("2.00 periods of 4 s folded into one, the first left out"));
        // Two periods, and four of which the first alone shows everything.
        for (periods, lost, folded) in [(2, 0..0, "2.00"), (4, 250..700, "1.75")] {
            let (apart, notes) = torques(periods, lost);
            assert!(apart > 0.5, "{apart}");
            assert!(notes.contains(&format!("{folded} periods of 4 s folded into one;")));
        }
    }
}
