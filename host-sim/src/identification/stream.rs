//! Logs as a stream: one thread reads, all cores prepare, sums and a bounded sample of rows stay.

use super::columns::Layout;
use super::log::LogRow;
use super::normal::NormalEquations;
use super::prepare::{MotionSource, Preparation, PrepareConfig, Prepared, Stretch};
use super::ripple::RippleSums;
use super::speed::SpeedSums;
use super::whole_log::{GAP_PERIODS, WholeLog};
use crate::dynamics::State;
use crate::robot::Robot;
use crate::table::TableError;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::sync::mpsc::sync_channel;

/// Rows of one stretch, margins apart. Large against the margins, small enough for a few of them in memory.
const STRETCH: usize = 16_384;
/// Rows in a period of the motion's cut-off from which derivatives of the positions are believed before logged ones.
const MOTION_ROWS: f64 = 8.0;
/// Logged velocities farther than this share of their RMS from the derivative of the positions are set-points.
const VELOCITY_TRUST: f64 = 0.01;
/// The same for accelerations, which differentiation knows less well.
const ACCELERATION_TRUST: f64 = 0.03;

/// Prepares a log stretch by stretch on all cores and hands every stretch over in the order of the log, so that sums come
/// out the same in every run. Memory does not grow with the log.
///
/// * `notes` collects what a reader should know: columns derived, gaps
///
/// Errors: [`TableError`] of the first bad row; then some stretches may have been handed over.
pub fn for_each_prepared<const N: usize>(
    path: &Path,
    robot: &Robot,
    layout: &Layout<N>,
    config: &PrepareConfig,
    notes: &mut Vec<String>,
    take: &mut dyn FnMut(&Preparation, Prepared<N>),
) -> Result<Preparation, TableError> {
    let mut log = WholeLog::<N>::open(path, robot)?;
    let preparation = choose(&log, config, path, notes);
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let (to_workers, stretches) = sync_channel::<Stretch<N>>(workers);
    let stretches = Mutex::new(stretches);
    let (finished, results) = sync_channel::<Prepared<N>>(workers);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            let finished = finished.clone();
            let (stretches, preparation) = (&stretches, &preparation);
            scope.spawn(move || {
                loop {
                    // A poisoned lock means another worker has panicked; the scope reports that.
                    let Some(stretch) = stretches.lock().ok().and_then(|queue| queue.recv().ok())
                    else {
                        return;
                    };
                    let prepared = Prepared::new(&stretch, preparation, layout);
                    if finished.send(prepared).is_err() {
                        return;
                    }
                }
            });
        }
        drop(finished);
        let cut = &preparation;
        let reading = scope.spawn(move || cut_into_stretches(&mut log, cut, path, &to_workers));
        let mut waiting = BTreeMap::new();
        let mut next = 0;
        for prepared in results {
            waiting.insert(prepared.index, prepared);
            while let Some(prepared) = waiting.remove(&next) {
                take(&preparation, prepared);
                next += 1;
            }
        }
        match reading.join() {
            Ok(outcome) => notes.extend(outcome?),
            Err(panic) => std::panic::resume_unwind(panic),
        }
        Ok(())
    })?;
    Ok(preparation)
}

/// Period and sources of motion of a log, from its first rows.
fn choose<const N: usize>(
    log: &WholeLog<N>,
    config: &PrepareConfig,
    path: &Path,
    notes: &mut Vec<String>,
) -> Preparation {
    let (preview, reader, period_s) = (log.preview(), log.reader(), log.period_s());
    let name = path.display();
    if reader.from_current() {
        notes.push(format!("{name}: torque is drive gain × motor current"));
    }
    // Up to the first gap: derivatives across it would be wrong.
    let whole = preview
        .windows(2)
        .position(|pair| pair[1].t_s - pair[0].t_s > GAP_PERIODS * period_s);
    let preview = &preview[..whole.map_or(preview.len(), |row| row + 1)];
    let start_s = preview.first().map_or(0.0, |row| row.t_s);
    let at = |velocity, acceleration| {
        Preparation::new(config, start_s, period_s, velocity, acceleration)
    };
    let derived = at(MotionSource::Derived, MotionSource::Derived);
    let distance =
        |a: &[State<N>], b: &[State<N>], of: fn(&State<N>) -> &nalgebra::SVector<f64, N>| {
            let edge = derived.edge().min(a.len() / 3);
            let inner = edge..a.len() - edge;
            let (mut error, mut size) = (0.0, 0.0);
            for row in inner {
                error += (of(&a[row]) - of(&b[row])).norm_squared();
                size += of(&b[row]).norm_squared();
            }
            (error / f64::max(size, f64::MIN_POSITIVE)).sqrt()
        };
    let from_positions = derived.motion(preview);
    let mut source = |there: bool,
                      what: &str,
                      trust: f64,
                      logged: Preparation,
                      base: &[State<N>],
                      of: fn(&State<N>) -> &nalgebra::SVector<f64, N>| {
        if !there {
            notes.push(format!(
                "{name}: no {what}, derived by central differences of the filtered motion"
            ));
            return MotionSource::Derived;
        }
        // Columns somebody mapped are measurements; the project's own may be set-points beside measured positions, and went
        // through a filter that nobody knows: where positions come often enough, what is derived from them is nearer to
        // the torque, whose filter is known.
        if !reader.is_mapped() && MOTION_ROWS * config.motion_hz * period_s <= 1.0 {
            notes.push(format!(
                "{name}: {what} derived from the positions, which come every {:.1} ms; the log's own have another filter",
                1e3 * period_s
            ));
            return MotionSource::Derived;
        }
        let apart = distance(&logged.motion(preview), base, of);
        if reader.is_mapped() || apart <= trust {
            return MotionSource::Logged;
        }
        notes.push(format!(
            "{name}: logged {what} are {:.1} % of their RMS off the derivative of the positions, taken for set-points; derived instead",
            100.0 * apart
        ));
        MotionSource::Derived
    };
    let velocity = source(
        reader.has_velocity(),
        "velocities",
        VELOCITY_TRUST,
        at(MotionSource::Logged, MotionSource::Derived),
        &from_positions,
        |state| &state.qd,
    );
    let from_velocities = at(velocity, MotionSource::Derived).motion(preview);
    let acceleration = source(
        reader.has_acceleration(),
        "accelerations",
        ACCELERATION_TRUST,
        at(velocity, MotionSource::Logged),
        &from_velocities,
        |state| &state.qdd,
    );
    at(velocity, acceleration)
}

/// Reads the log to its end and sends it on in stretches with margins; returns what is to be said about gaps.
fn cut_into_stretches<const N: usize>(
    log: &mut WholeLog<N>,
    preparation: &Preparation,
    path: &Path,
    to_workers: &std::sync::mpsc::SyncSender<Stretch<N>>,
) -> Result<Vec<String>, TableError> {
    let mut notes = Vec::new();
    let (margin, edge) = (preparation.margin(), preparation.edge());
    // Rows not yet sent with the margin before them; `begin` is where the unsent core starts.
    let mut rows: Vec<LogRow<N>> = Vec::new();
    let mut begin = edge;
    let mut index = 0;
    let mut send = |rows: Vec<LogRow<N>>, core: std::ops::Range<usize>| {
        let stretch = Stretch { index, rows, core };
        index += 1;
        // The receiver is gone only when a worker has panicked, which the scope reports.
        let _ = to_workers.send(stretch);
    };
    loop {
        let row = log.next_row()?;
        let gap = match (&row, rows.last()) {
            (Some(row), Some(last)) => {
                let step = row.t_s - last.t_s;
                let gap = step > GAP_PERIODS * preparation.period_s;
                if gap {
                    notes.push(format!(
                        "{}:{}: column t_s: gap of {step:.4} s, more than {GAP_PERIODS} periods: split here",
                        path.display(),
                        row.line
                    ));
                }
                gap
            }
            _ => false,
        };
        if gap || row.is_none() {
            let end = rows.len().saturating_sub(edge);
            if begin < end {
                send(std::mem::take(&mut rows), begin..end);
            }
            rows.clear();
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
            None => {
                if log.lost() > 0 {
                    notes.push(format!(
                        "{}: {} rows were lost on the way to the log, as its clock says: put in between their neighbours",
                        path.display(),
                        log.lost()
                    ));
                }
                return Ok(notes);
            }
        }
    }
}

/// One row of the bounded sample.
#[derive(Clone, Debug)]
pub struct SampleRow<const N: usize> {
    /// Motion.
    pub state: State<N>,
    /// Filtered torque, N·m.
    pub tau: [f64; N],
    /// Filtered torque without spikes, N·m.
    pub clean: [f64; N],
    /// Which joints move.
    pub moving: [bool; N],
    /// Active columns of all joints.
    pub panel: Box<[f64]>,
    /// Sine and cosine of every joint's cogging phase, filtered as the columns are.
    pub waves: [[f64; 2]; N],
}

impl<const N: usize> SampleRow<N> {
    /// One row of a prepared stretch.
    pub(super) fn of(
        layout: &Layout<N>,
        preparation: &Preparation,
        prepared: &Prepared<N>,
        row: usize,
    ) -> Self {
        let state = prepared.states[row];
        let values = |table: &[f64]| std::array::from_fn(|joint| table[row * N + joint]);
        Self {
            state,
            tau: values(&prepared.tau),
            clean: values(&prepared.clean),
            moving: std::array::from_fn(|joint| state.qd[joint].abs() > preparation.still_rad_s),
            panel: prepared.panel[row * layout.width..(row + 1) * layout.width].into(),
            waves: std::array::from_fn(|joint| {
                let place = 2 * (row * N + joint);
                [prepared.waves[place], prepared.waves[place + 1]]
            }),
        }
    }
}

/// Most rows of the sample.
pub(super) const SAMPLE: usize = 60_000;

/// What one pass over the training logs leaves: the sums of all rows, and an evenly thinned sample for methods that
/// iterate over rows.
#[derive(Clone, Debug)]
pub struct Gathered<const N: usize> {
    /// Sums over all moving rows.
    pub sums: NormalEquations<N>,
    /// The same over rows without spikes.
    pub clean_sums: NormalEquations<N>,
    /// What borders them by the waves of cogging.
    pub ripple: RippleSums<N>,
    /// Every `thinning`-th of the rows that went into the sums.
    pub sample: Vec<SampleRow<N>>,
    /// See `sample`.
    pub thinning: usize,
    /// Rows that went into the sums.
    pub rows: usize,
    /// What every joint's raw torque says at each speed.
    pub speeds: SpeedSums<N>,
    /// Rows read, edges left out.
    pub rows_read: usize,
    /// Of these, those in which each joint stands still.
    pub still: [usize; N],
    /// Spikes found.
    pub spikes: usize,
}

impl<const N: usize> Gathered<N> {
    /// Nothing yet.
    pub fn new(layout: &Layout<N>) -> Self {
        Self {
            sums: NormalEquations::new(layout),
            clean_sums: NormalEquations::new(layout),
            ripple: RippleSums::new(layout),
            sample: Vec::new(),
            thinning: 1,
            rows: 0,
            speeds: SpeedSums::new(layout),
            rows_read: 0,
            still: [0; N],
            spikes: 0,
        }
    }

    /// Adds a stretch.
    pub fn add(&mut self, layout: &Layout<N>, preparation: &Preparation, prepared: &Prepared<N>) {
        let stride = preparation.stride();
        self.spikes += prepared.spikes;
        self.speeds.merge(&prepared.speeds);
        self.rows_read += prepared.core.len();
        for row in prepared.core.clone() {
            for (still, qd) in self.still.iter_mut().zip(prepared.states[row].qd.iter()) {
                *still += usize::from(qd.abs() <= preparation.still_rad_s);
            }
        }
        let rows: Vec<usize> = prepared.core.clone().step_by(stride).collect();
        for (joint, active) in layout.active.iter().enumerate() {
            let (mut x, mut tau, mut clean) = (Vec::new(), Vec::new(), Vec::new());
            let mut waves = Vec::new();
            for &row in &rows {
                if prepared.states[row].qd[joint].abs() > preparation.still_rad_s {
                    let start = row * layout.width + layout.offset[joint];
                    x.extend_from_slice(&prepared.panel[start..start + active.len()]);
                    tau.push(prepared.tau[row * N + joint]);
                    clean.push(prepared.clean[row * N + joint]);
                    waves.extend_from_slice(&prepared.waves[2 * (row * N + joint)..][..2]);
                }
            }
            self.sums.joints[joint].add(&x, &tau);
            self.clean_sums.joints[joint].add(&x, &clean);
            self.ripple.add(joint, &x, &waves, &clean);
        }
        for &row in &rows {
            if self.rows.is_multiple_of(self.thinning) {
                self.sample
                    .push(SampleRow::of(layout, preparation, prepared, row));
            }
            self.rows += 1;
            if self.sample.len() > SAMPLE {
                // Even thinning: the rows that stay are those a doubled stride would have taken.
                let mut position = 0;
                self.sample.retain(|_| {
                    position += 1;
                    position % 2 == 1
                });
                self.thinning *= 2;
            }
        }
    }
}
