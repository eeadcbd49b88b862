//! The logs row by row, with the torques of batch least squares on the other paths; squared errors of the moving rows.

use super::record::{GATE_RAD_S, PathScores, Predictions, WorstWindow};
use crate::real_ur5::geometric_mean;
use crate::{Progress, StudyError};
use foretorque::joint::{JointMeasurement, JointVector};
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::identification::{
    IdentifyConfig, IdentifyError, Layout, MethodName, Preparation, PrepareConfig, Prepared,
    WholeLog, for_each_prepared, identify,
};
use foretorque_workbench::metrics::ErrorSums;
use foretorque_workbench::robot::Robot;
use std::path::{Path, PathBuf};

/// The friction columns of the reference.
pub(super) const RICH: &str = "coulomb-viscous+offset+stribeck+sqrt+load";

/// The friction columns of the plain reference.
const PLAIN: &str = "coulomb-viscous";
/// Columns of the reference, the first that the logs show.
const COLUMNS: [&str; 3] = [RICH, "coulomb-viscous+offset", PLAIN];

/// A path: its name, and the logs that show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplayPath {
    /// Name.
    pub name: String,
    /// Logs.
    pub files: Vec<PathBuf>,
}

/// Filters of the reference and of the figures: those published for the logs of the UR5, or of lower cut-offs where rows of
/// `logs` are too far apart or noisy.
fn filters(logs: &[&Path], robot: &Robot) -> Result<PrepareConfig, IdentifyError> {
    let found = PrepareConfig::for_logs(logs, robot)?;
    Ok(PrepareConfig {
        motion_hz: found.motion_hz.min(20.0),
        torque_hz: found.torque_hz.map(|hz| hz.min(10.0)),
        still_rad_s: GATE_RAD_S,
    })
}

pub(super) struct Row<const N: usize> {
    /// As the drives reported it, unfiltered.
    pub(super) measured: JointMeasurement<N>,
    /// Motion, filtered forwards and backwards: what the figures are taken of.
    pub(super) state: State<N>,
    /// Torque through the same filter, N·m.
    pub(super) tau: [f64; N],
    /// Torques of plain and rich batch least squares on the other paths, N·m, through the same filter.
    pub(super) batch: [[f64; N]; 2],
}

/// A stretch of a log without a gap.
pub(super) struct Stretch<const N: usize> {
    /// Which path it is of, and which of its logs.
    pub(super) path: usize,
    pub(super) file: usize,
    /// Time of the first row, s.
    start_s: f64,
    pub(super) rows: Vec<Row<N>>,
    pub(super) preparation: Preparation,
}

/// All logs in the order of their paths.
pub(super) struct Logs<const N: usize> {
    pub(super) stretches: Vec<Stretch<N>>,
    /// Time between two rows, s: that of the first log.
    pub(super) period_s: f64,
    /// Columns of the reference; none if it is the description.
    pub(super) columns: Option<&'static str>,
    pub(super) notes: Vec<String>,
}

/// All logs, with batch least squares on the other paths, or on the path itself where there is no other. Where these do not
/// show the arm's parameters, those of its description stand in, without friction.
///
/// Errors: a log is missing or damaged; an identification fails; logs of different rates.
pub(super) fn read<const N: usize>(
    paths: &[ReplayPath],
    robot: &Robot,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Logs<N>, StudyError> {
    let mut notes = Vec::new();
    let files: Vec<&Path> = paths
        .iter()
        .flat_map(|path| &path.files)
        .map(PathBuf::as_path)
        .collect();
    let mut period_s = None;
    for &file in &files {
        let own = WholeLog::open(file, robot)?.period_s();
        let first = *period_s.get_or_insert(own);
        if (own / first - 1.0).abs() > 0.05 {
            return Err(StudyError::from(format!(
                "{}: rows {:.2} ms apart, those of the first log {:.2} ms: replay them one by one",
                file.display(),
                1e3 * own,
                1e3 * first
            )));
        }
    }
    let period_s = period_s.ok_or_else(|| StudyError::from("no log".to_owned()))?;
    let prepare = filters(&files, robot)?;
    let (columns_found, references) = references(paths, robot, (prepare, seed), progress)?;
    let missing = COLUMNS.iter();
    let missing = missing.take_while(|text| Some(**text) != columns_found);
    notes.extend(missing.map(|text| format!("the logs do not show all columns of {text}")));
    let mut stretches = Vec::new();
    for (number, path) in paths.iter().enumerate() {
        for (place, file) in path.files.iter().enumerate() {
            let mut found: [Vec<Vec<[f64; N]>>; 2] = Default::default();
            let (mut prepared, mut own) = (Vec::new(), Vec::new());
            for ((text, thetas), found) in references.iter().zip(&mut found) {
                let layout = Layout::new(robot, &text.parse()?);
                prepared.clear();
                let mut take = |preparation: &Preparation, mut stretch: Prepared| {
                    found.push(predictions(&layout, &thetas[number], &stretch));
                    // A panel takes more memory than all the rest.
                    stretch.panel = Vec::new();
                    prepared.push((preparation.clone(), stretch));
                };
                for_each_prepared(file, robot, &layout, &prepare, &mut own, &mut take)?;
            }
            for note in own {
                if !notes.contains(&note) {
                    notes.push(note);
                }
            }
            let raw = raw_rows(file, robot)?;
            for (k, (preparation, stretch)) in prepared.into_iter().enumerate() {
                let rows = stretch.core.clone().filter_map(|row| {
                    let t_s = stretch.t_s[row];
                    let place = raw.partition_point(|(raw_s, _)| *raw_s < t_s);
                    let measured = raw.get(place)?.1;
                    Some(Row {
                        measured,
                        state: stretch.states[row].into(),
                        tau: std::array::from_fn(|joint| stretch.tau[row * N + joint]),
                        batch: [found[0][k][row], found[1][k][row]],
                    })
                });
                stretches.push(Stretch {
                    path: number,
                    file: place,
                    start_s: stretch.t_s[stretch.core.start],
                    rows: rows.collect(),
                    preparation,
                });
            }
        }
    }
    Ok(Logs {
        stretches,
        period_s,
        columns: columns_found,
        notes,
    })
}

/// Friction columns, and their parameters for every path.
type Reference = (&'static str, Vec<Vec<f64>>);

/// The plain and the rich reference, and the columns of the latter; none if both are the description.
fn references(
    paths: &[ReplayPath],
    robot: &Robot,
    (prepare, seed): (PrepareConfig, u64),
    progress: Progress<'_>,
) -> Result<(Option<&'static str>, [Reference; 2]), StudyError> {
    let fit = |text: &str, number: usize| {
        progress("path held out", number, paths.len());
        let others = paths.iter().enumerate();
        let others = others.filter(|(other, _)| *other != number || paths.len() == 1);
        let training: Vec<PathBuf> = others.flat_map(|(_, path)| path.files.clone()).collect();
        let logs = (&training[..], &paths[number].files[..1]);
        batch(robot, logs, text, prepare, seed)
    };
    let deficient =
        |error: &StudyError| matches!(error.downcast_ref(), Some(IdentifyError::RankDeficient(..)));
    // None if the logs do not show the parameters.
    let fits = |text: &str| -> Result<Option<Vec<Vec<f64>>>, StudyError> {
        match (0..paths.len()).map(|number| fit(text, number)).collect() {
            Err(error) if deficient(&error) => Ok(None),
            fitted => fitted.map(Some),
        }
    };
    for text in COLUMNS {
        if let Some(rich) = fits(text)? {
            let plain = if text == PLAIN { None } else { fits(PLAIN)? };
            let plain = plain.unwrap_or_else(|| rich.clone());
            return Ok((Some(text), [(PLAIN, plain), (text, rich)]));
        }
    }
    let mut described = robot.base_parameters();
    described.resize(Layout::new(robot, &PLAIN.parse()?).parameters.len(), 0.0);
    let described = (PLAIN, vec![described; paths.len()]);
    Ok((None, [described.clone(), described]))
}

/// Weighted least squares over the training logs: one value a parameter.
fn batch(
    robot: &Robot,
    (training, held_out): (&[PathBuf], &[PathBuf]),
    text: &str,
    prepare: PrepareConfig,
    seed: u64,
) -> Result<Vec<f64>, StudyError> {
    let config = IdentifyConfig::new(vec![MethodName::Wls], text.parse()?, prepare, seed);
    let outcome = identify(robot, training, held_out, &config, &|_| ())?;
    let record = outcome.report.methods.get(&MethodName::Wls.to_string());
    let parameters = record.ok_or(IdentifyError::Unsolvable)?.parameters.iter();
    Ok(parameters.map(|parameter| parameter.value).collect())
}

/// Torques of `theta` in every row of a stretch, N·m; the columns are filtered already.
fn predictions<const N: usize>(
    layout: &Layout,
    theta: &[f64],
    stretch: &Prepared,
) -> Vec<[f64; N]> {
    let rows = stretch.panel.chunks_exact(layout.width);
    rows.map(|row| {
        std::array::from_fn(|joint| {
            let columns = row[layout.offset[joint]..].iter();
            let terms = columns.zip(&layout.active[joint]);
            terms.map(|(x, &place)| x * theta[place]).sum()
        })
    })
    .collect()
}

/// Time and measurement of every row.
fn raw_rows<const N: usize>(
    file: &Path,
    robot: &Robot,
) -> Result<Vec<(f64, JointMeasurement<N>)>, StudyError> {
    let mut log = WholeLog::open(file, robot)?;
    let joints = |values: &[f64]| JointVector::from_fn(|joint, _| values[joint] as f32);
    let mut rows = Vec::new();
    while let Some(row) = log.next_row()? {
        let measured = JointMeasurement {
            q: joints(&row.q),
            tau: joints(&row.tau),
        };
        rows.push((row.t_s, measured));
    }
    Ok(rows)
}

/// Errors of one kind of prediction, a sum a joint.
#[derive(Clone, Copy, Debug)]
pub(super) struct Errors<const N: usize>([ErrorSums; N]);

impl<const N: usize> Default for Errors<N> {
    fn default() -> Self {
        Self([ErrorSums::default(); N])
    }
}

impl<const N: usize> Errors<N> {
    /// RMS error of every joint that has moved, N·m.
    fn rms(&self) -> Vec<Option<f64>> {
        self.0.iter().map(ErrorSums::rmse).collect()
    }

    pub(super) fn over(&self, other: &Self) -> Vec<Option<f64>> {
        let pairs = self.0.iter().zip(&other.0);
        let ratios = pairs.map(|(own, other)| Some(own.rmse()? / other.rmse()?));
        ratios.collect()
    }
}

/// Errors on one path. Those called aged leave out the rows for which there are no old parameters yet.
#[derive(Clone, Debug, Default)]
pub(super) struct Scores<const N: usize> {
    pub(super) newest: Errors<N>,
    pub(super) aged: Errors<N>,
    pub(super) frozen: Errors<N>,
    pub(super) plain: Errors<N>,
    pub(super) rich: Errors<N>,
    pub(super) plain_aged: Errors<N>,
    pub(super) rich_aged: Errors<N>,
    pub(super) worst_window: Option<WorstWindow>,
}

impl<const N: usize> Scores<N> {
    /// Adds a stretch; its first `skipped` rows have no old parameters.
    pub(super) fn add(&mut self, stretch: &Stretch<N>, predicted: &Predictions, skipped: usize) {
        for (k, row) in stretch.rows.iter().enumerate() {
            for joint in moving(row) {
                let add = |errors: &mut Errors<N>, predicted: f64| {
                    errors.0[joint].add(row.tau[joint], predicted);
                };
                let [plain, rich] = row.batch.map(|batch| batch[joint]);
                add(&mut self.newest, predicted.newest[k * N + joint]);
                add(&mut self.frozen, predicted.frozen[k * N + joint]);
                add(&mut self.plain, plain);
                add(&mut self.rich, rich);
                if k >= skipped {
                    add(&mut self.aged, predicted.aged[k * N + joint]);
                    add(&mut self.plain_aged, plain);
                    add(&mut self.rich_aged, rich);
                }
            }
        }
    }

    /// Compares the newest parameters with the start in every window of `rows` rows with motion of a log; errors are shares of
    /// `limits`, N·m, so that a joint without load does not decide.
    pub(super) fn watch(
        &mut self,
        log: &[(&Stretch<N>, Predictions)],
        rows: usize,
        limits: &[f64; N],
    ) {
        // Sums of the rows so far, and how many of them are not finite.
        let (mut sums, mut lost) = (vec![[[0.0; N]; 2]], vec![0]);
        let mut times = Vec::new();
        for (stretch, predicted) in log {
            let rows = stretch.rows.iter().enumerate();
            for (k, row) in rows.filter(|(_, row)| moving(row).next().is_some()) {
                let (mut sum, mut finite) = (sums[sums.len() - 1], true);
                for joint in moving(row) {
                    let torques = [&predicted.newest, &predicted.frozen];
                    for (sum, torques) in sum.iter_mut().zip(torques) {
                        let error = (torques[k * N + joint] - row.tau[joint]) / limits[joint];
                        finite &= error.is_finite();
                        sum[joint] += if error.is_finite() {
                            error * error
                        } else {
                            0.0
                        };
                    }
                }
                sums.push(sum);
                lost.push(lost[lost.len() - 1] + usize::from(!finite));
                times.push(stretch.start_s + k as f64 * stretch.preparation.period_s);
            }
        }
        for (begin, (first, last)) in sums.iter().zip(sums.iter().skip(rows)).enumerate() {
            let of = |set: usize| Joints::<N>::from_fn(|j, _| last[set][j] - first[set][j]);
            let [newest, start] = [0, 1].map(of);
            let ratio = match (newest.sum(), start.sum()) {
                _ if lost[begin + rows] > lost[begin] => f64::INFINITY,
                (newest, start) if newest + start > 0.0 => (newest / start).sqrt(),
                _ => continue,
            };
            if self.worst_window.is_none_or(|worst| ratio > worst.ratio) {
                self.worst_window = Some(WorstWindow {
                    ratio,
                    from_s: times[begin],
                    joint: (newest - start).imax() + 1,
                });
            }
        }
    }

    pub(super) fn record(&self, name: &str, within_1_1_after_s: Option<f64>) -> PathScores {
        PathScores {
            path: name.to_owned(),
            batch_rmse_moving_nm: self.rich.rms(),
            newest_ratio: self.newest.over(&self.rich),
            aged_ratio: self.aged.over(&self.rich_aged),
            frozen_ratio: self.frozen.over(&self.rich),
            within_1_1_after_s,
            worst_window_over_start_ratio: self.worst_window.map(|worst| worst.ratio),
            worst_window: self.worst_window,
        }
    }
}

/// The joints that move in a row.
pub(super) fn moving<const N: usize>(row: &Row<N>) -> impl Iterator<Item = usize> {
    (0..N).filter(|&joint| row.state.qd[joint].abs() > GATE_RAD_S)
}

/// Rows with motion until the error over the last `window` of them is within `close` times that of rich batch least
/// squares, geometric mean of the joints that move in it; `path` has stretches with the torques of the newest parameters.
pub(super) fn motion_until_close<const N: usize>(
    path: &[(&Stretch<N>, Vec<f64>)],
    window: f64,
    close: f64,
) -> Option<usize> {
    let rows = path.iter().flat_map(|(stretch, newest)| {
        let rows = stretch.rows.iter().zip(newest.chunks_exact(N));
        rows.filter(|(row, _)| moving(row).next().is_some())
    });
    let in_motion: Vec<(&Row<N>, &[f64])> = rows.collect();
    let window = window as usize;
    // The window must end after the learner has had the time: what counts is motion before the window begins.
    (0..in_motion.len().saturating_sub(window)).find(|&begin| {
        let (mut own, mut rich) = (Errors::<N>::default(), Errors::default());
        for (row, newest) in &in_motion[begin..begin + window] {
            for joint in moving(row) {
                own.0[joint].add(row.tau[joint], newest[joint]);
                rich.0[joint].add(row.tau[joint], row.batch[1][joint]);
            }
        }
        let ratios: Vec<f64> = own.over(&rich).into_iter().flatten().collect();
        !ratios.is_empty() && geometric_mean(&ratios) <= close
    })
}
