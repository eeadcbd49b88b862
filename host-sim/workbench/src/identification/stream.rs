//! Logs as prepared rows: as a stream of stretches, or a periodic one folded into one period.

use super::clock::GAP_PERIODS;
use super::columns::Layout;
use super::filter::{Harmonics, despiked, median};
use super::log::{LogReader, LogRow};
use super::normal::SpeedSums;
use super::prepare::{Preparation, PrepareConfig, Prepared, Stretch, states};
use super::whole_log::WholeLog;
use super::{IdentifyError, refused};
use crate::Refusal;
use crate::parallel::{cores, in_parallel};
use crate::robot::Robot;
use crate::table::TableError;
use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};

/// Rows of one stretch, margins apart. Large against the margins, small enough for a few of them in memory.
const STRETCH: usize = 16_384;

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
        let (to_workers, stretches) = sync_channel::<Stretch>(workers);
        let reading = scope.spawn(move || cut_into_stretches(&mut log, cut, path, &to_workers));
        loop {
            let batch: Vec<Stretch> = stretches.iter().take(workers).collect();
            if batch.is_empty() {
                break;
            }
            let prepare = |stretch: &Stretch| Prepared::new(stretch, cut, layout);
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
    let (mut notes, name) = (Vec::new(), path.display());
    let (margin, edge) = (preparation.margin(), preparation.edge());
    // Rows not yet sent with the margin before them; `begin` is where the unsent core starts.
    let mut rows: Vec<LogRow> = Vec::new();
    let mut begin = edge;
    let send = |rows: Vec<LogRow>, core: std::ops::Range<usize>| {
        // The receiver is gone only when a worker has panicked, which the scope reports.
        let _ = to_workers.send(Stretch { rows, core });
    };
    loop {
        let row = log.next_row()?;
        let pair = row.as_ref().zip(rows.last());
        let step = pair.map_or(0.0, |(row, last)| row.t_s - last.t_s);
        let gap = step > GAP_PERIODS * preparation.period_s;
        if let (true, Some(row)) = (gap, &row) {
            notes.push(format!(
                "{name}:{}: column t_s: gap of {step:.4} s, more than four lost rows: split here",
                row.line
            ));
        }
        if gap || row.is_none() {
            let end = rows.len().saturating_sub(edge);
            let rows = std::mem::take(&mut rows);
            if begin < end {
                send(rows, begin..end);
            }
            begin = edge;
        } else if rows.len() >= begin + STRETCH + margin {
            let end = begin + STRETCH;
            let keep = end.saturating_sub(margin);
            let rest = rows[keep..].to_vec();
            send(std::mem::replace(&mut rows, rest), begin..end);
            begin = end - keep;
        }
        match row {
            Some(row) => rows.push(row),
            None => break,
        }
    }
    notes.extend(log.reader.wraps());
    if log.lost > 0 {
        notes.push(format!(
            "{name}: {} rows are missing according to its clock and were interpolated",
            log.lost
        ));
    }
    Ok(notes)
}

/// Rows of one search for spikes.
const CHUNK: usize = 16_384;
/// Largest distance of a row from its even place, share of the time between rows.
const UNEVEN: f64 = 0.25;

/// Folds a log whose motion repeats every `period_s` into one period and prepares it. Memory is that of one period.
///
/// Everything between the harmonics of a periodic motion is noise: averaging and projection remove it without edges, and
/// the derivatives of the series are exact [Swevers et al. 1997]. Regressor and torque share the harmonics.
///
/// Errors: [`TableError`] of a bad row; one line when the period is no whole number of rows, a row is out of place, or the
/// log is shorter than the period.
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
                None => fold.insert(Fold::new(&chunk, period_s, path)?),
            };
            fold.add(&chunk, config, path)?;
            chunk.clear();
        }
        if row.is_none() {
            break;
        }
    }
    let mut fold = fold.ok_or_else(|| TableError::empty(path))?;
    let run_in = if fold.leave_run_in() {
        ", the first left out"
    } else {
        ""
    };
    if fold.sums.count.contains(&0.0) {
        let problem = format!("the log does not show a whole period of {period_s} s");
        return Err(refused(path, problem));
    }
    let phases = fold.sums.count.len();
    let Some(late_rows) = fold.repeats.late_rows() else {
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
    let harmonics = |hz: f64| ((hz * period_s) as usize).clamp(1, (phases - 1) / 2);
    let of_motion = harmonics(config.motion_hz);
    let of_torque = harmonics(config.torque_hz.unwrap_or(f64::INFINITY));
    notes.push(format!(
        "{name}: {:.2} periods of {period_s} s folded into one{run_in}; motion on {of_motion} harmonics, torque and regressor on {of_torque}",
        fold.sums.count.iter().sum::<f64>() / phases as f64
    ));
    let mut preparation = fold.preparation(config);
    preparation.folded_stride = Some((phases / (2 * of_torque + 1)).max(1));
    let raw = fold.period(of_motion, period_s);
    let prepared = raw.filled(&preparation, layout, &|table, width| {
        let harmonics = Harmonics::of(table, width, of_torque);
        table.copy_from_slice(&harmonics.evaluate(0, period_s));
    });
    Ok((preparation, prepared))
}

/// Periods from which the first one is left out: the arm runs in.
const PERIODS: usize = 3;

/// Sums at each phase.
struct PhaseSums {
    count: Vec<f64>,
    t_s: Vec<f64>,
    /// Positions, torques, and torques without spikes.
    tables: [Vec<f64>; 3],
}

impl PhaseSums {
    fn zeros(phases: usize, joints: usize) -> Self {
        Self {
            count: vec![0.0; phases],
            t_s: vec![0.0; phases],
            tables: [(); 3].map(|()| vec![0.0; phases * joints]),
        }
    }

    /// All sums.
    fn each(&mut self) -> impl Iterator<Item = &mut f64> {
        let tables = self.tables.iter_mut().flatten();
        self.count.iter_mut().chain(&mut self.t_s).chain(tables)
    }
}

/// Sums over all periods at each phase.
struct Fold {
    start_s: f64,
    row_s: f64,
    joints: usize,
    sums: PhaseSums,
    /// Those of the first period, once it is over.
    first: Option<PhaseSums>,
    /// Rows so far, lost ones included.
    rows: usize,
    spikes: usize,
    /// Positions of the period before, phase by phase.
    period_before: Vec<Option<f64>>,
    /// Positions of the row before.
    row_before: Vec<f64>,
    repeats: Repeats,
}

/// Sums over the change Δq of a position from one period to the next, and its change dq from row to row: a period that is
/// too long by δ rows makes Δq = δ dq.
#[derive(Default)]
struct Repeats {
    /// Σ Δq², Σ Δq dq, Σ dq².
    apart: [f64; 3],
    /// Rows, Σ q, Σ q², joint by joint.
    motion: Vec<[f64; 3]>,
}

/// Largest part of the motion that may differ from period to period.
const DIFFERENT: f64 = 0.01;

impl Repeats {
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
}

impl Fold {
    fn new(first: &[LogRow], period_s: f64, path: &Path) -> Result<Self, IdentifyError> {
        let mut steps: Vec<f64> = first.windows(2).map(|p| p[1].t_s - p[0].t_s).collect();
        let row_s = median(&mut steps);
        if first.len() < 3 {
            return Err(TableError::empty(path).into());
        }
        let phases = (period_s / row_s).round();
        if phases < 3.0 || (phases * row_s - period_s).abs() > 1e-6 * period_s {
            let rows = format!("rows, which are {row_s:.6} s apart");
            let problem = format!("a period of {period_s} s is no whole number of {rows}");
            return Err(refused(path, problem));
        }
        let (phases, joints) = (phases as usize, first[0].q.len());
        Ok(Self {
            start_s: first[0].t_s,
            row_s,
            joints,
            sums: PhaseSums::zeros(phases, joints),
            first: None,
            rows: 0,
            spikes: 0,
            period_before: vec![None; phases * joints],
            row_before: Vec::new(),
            repeats: Repeats {
                motion: vec![[0.0; 3]; joints],
                ..Repeats::default()
            },
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
            if (place - place.round()).abs() > UNEVEN {
                let (name, line, t_s) = (path.display(), row.line, row.t_s);
                return Err(IdentifyError::Refused(Refusal(format!(
                    "{name}:{line}: column t_s: {t_s} is off the even spacing of {:.6} s that folding needs",
                    self.row_s
                ))));
            }
            let (place, phases) = (place.round() as usize, self.sums.count.len());
            self.rows = place + 1;
            if place >= phases && self.first.is_none() {
                let others = PhaseSums::zeros(phases, joints);
                self.first = Some(std::mem::replace(&mut self.sums, others));
            }
            let phase = place % phases;
            self.sums.count[phase] += 1.0;
            self.sums.t_s[phase] += row.t_s;
            for (joint, &q) in row.q.iter().enumerate() {
                let last = self.period_before[phase * joints + joint].replace(q);
                if let (Some(last), Some(row)) = (last, self.row_before.get(joint)) {
                    let (apart, step) = (q - last, q - row);
                    let products = [apart * apart, apart * step, step * step];
                    let sums = self.repeats.apart.iter_mut().zip(products);
                    sums.for_each(|(sum, product)| *sum += product);
                }
                let sums = self.repeats.motion[joint].iter_mut().zip([1.0, q, q * q]);
                sums.for_each(|(sum, value)| *sum += value);
            }
            self.row_before = row.q.to_vec();
            let tables = self.sums.tables.iter_mut();
            for (table, values) in tables.zip([&row.q[..], &row.tau, clean]) {
                let sums = &mut table[phase * joints..][..joints];
                sums.iter_mut()
                    .zip(values)
                    .for_each(|(sum, value)| *sum += value);
            }
        }
        Ok(())
    }

    /// Leaves the first period out where enough others are there, which show all of it.
    fn leave_run_in(&mut self) -> bool {
        let leaves =
            self.rows >= PERIODS * self.sums.count.len() && !self.sums.count.contains(&0.0);
        if let Some(mut first) = self.first.take().filter(|_| !leaves) {
            let sums = self.sums.each().zip(first.each());
            sums.for_each(|(sum, first)| *sum += *first);
        }
        leaves
    }

    fn preparation(&self, config: &PrepareConfig) -> Preparation {
        Preparation::new(config, self.start_s, self.row_s, [false; 2])
    }

    /// The mean period, its motion on harmonics.
    fn period(self, harmonics: usize, period_s: f64) -> Prepared {
        let (joints, mut folded) = (self.joints, self.sums);
        for (phase, count) in folded.count.iter().enumerate() {
            folded.t_s[phase] /= count;
            for table in &mut folded.tables {
                let sums = &mut table[phase * joints..][..joints];
                sums.iter_mut().for_each(|sum| *sum /= count);
            }
        }
        let [q, tau, clean] = folded.tables;
        let series = Harmonics::of(&q, joints, harmonics);
        let [q, qd, qdd] = [0, 1, 2].map(|order| series.evaluate(order, period_s));
        Prepared {
            states: states(joints, [&q, &qd, &qdd]),
            panel: Vec::new(),
            cogging_basis: Vec::new(),
            speeds: SpeedSums::new(joints),
            tau,
            clean,
            spikes: self.spikes,
            core: 0..folded.count.len(),
            t_s: folded.t_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::columns::ColumnSet;
    use super::*;
    use std::f64::consts::TAU;
    use std::fmt::Write;

    #[test]
    fn the_first_of_three_periods_is_left_out() {
        let here = tempfile::tempdir().expect("creates");
        let mut robot = Robot::load("ur5").expect("built in");
        robot.joints.truncate(1);
        let columns = ColumnSet::default();
        let layout = Layout::new(&robot, &columns);
        let config = PrepareConfig {
            motion_hz: 10.0,
            torque_hz: None,
            still_rad_s: PrepareConfig::STILL_RAD_S,
        };
        // The torque settles in the first second; rows are lost from `lost` on.
        let torques = |periods: u32, lost: std::ops::Range<u32>| {
            let path = here.path().join("log.csv");
            let mut text = "t_s,q1_rad,tau1_nm\n".to_owned();
            for k in (0..200 * periods).filter(|k| !lost.contains(k)) {
                let t_s = 0.02 * f64::from(k);
                let (q, run_in) = ((TAU * t_s / 4.0).sin(), 5.0 * (-4.0 * t_s).exp());
                writeln!(text, "{t_s},{q},{}", 2.0 * q + run_in).expect("a string");
            }
            std::fs::write(&path, text).expect("writes");
            let mut notes = Vec::new();
            let (_, prepared) =
                folded(&path, &robot, &layout, &config, 4.0, &mut notes).expect("a log");
            let rows = prepared.tau.iter().zip(&prepared.states);
            let apart = rows.map(|(tau, state)| (tau - 2.0 * state.q[0]).abs());
            (apart.fold(0.0, f64::max), notes.concat())
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
