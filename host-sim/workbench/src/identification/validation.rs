//! Torque errors of models on logs and rows they were not trained on: unseen logs, the 80/20 split of the paper, and growing
//! shares of the log.

use super::IdentifyError;
use super::columns::Layout;
use super::dataset::Thinned;
use super::methods::MethodName;
use super::normal::NormalEquations;
use super::normal::SampleRow;
use super::prepare::{Preparation, Prepared};
use super::problem::{Candidate, MethodResult, Problem, TrainingData};
use super::record::{LearningPoint, SplitRecord, ValidationRecord};
use super::solve::solve_all;
use super::uncertainty::{middle, resample};
use crate::dynamics::PerJoint;
use crate::metrics::{ErrorSums, even_sample, nrmse, root_mean};
use nalgebra::DMatrix;

/// Time, measured torque, and the torque that every candidate predicts, N·m.
pub(super) type TraceRow = (f64, PerJoint<f64>, Vec<PerJoint<f64>>);

/// Scores of several candidates on one log.
#[derive(Clone, Debug)]
pub(super) struct FileScores {
    /// Sums of every candidate over moving and still rows.
    moving: Vec<PerJoint<ErrorSums>>,
    still: Vec<PerJoint<ErrorSums>>,
    range: PerJoint<(f64, f64)>,
    /// Sums over the moving rows, for bounds.
    equations: NormalEquations,
    /// Numbers of blocks of `block_s`, and sums over the moving rows of each.
    blocks: Vec<(f64, Vec<PerJoint<ErrorSums>>)>,
    /// A second; longer in logs of hours.
    block_s: f64,
    /// A sample of its rows.
    pub(super) sample: Thinned<SampleRow>,
    /// Torques in some of its rows, for the plot.
    pub(super) trace: Thinned<TraceRow>,
}

/// Torques of a candidate in the rows that count, N a row, N·m, through the filter of the measurement.
fn predictions(
    layout: &Layout,
    preparation: &Preparation,
    prepared: &Prepared,
    candidate: &Candidate,
) -> Vec<f64> {
    let (joints, states) = (layout.joints(), prepared.states.iter());
    let networks: Option<Vec<PerJoint<f64>>> =
        states.map(|state| candidate.network(state)).collect();
    let mut table = networks.map_or(vec![0.0; prepared.tau.len()], |networks| {
        let torques = networks.iter().flat_map(|own| own.iter().copied());
        let mut table: Vec<f64> = torques.collect();
        preparation.smooth_torque(&mut table, joints);
        table
    });
    for row in prepared.core.clone() {
        for joint in 0..joints {
            let panel = &prepared.panel[row * layout.width..];
            table[row * joints + joint] += candidate.linear(layout, joint, panel);
        }
    }
    table
}

/// Most rows of the sample of an unseen log.
const SAMPLE: usize = 2000;
/// Most blocks of the bootstrap.
const MOST_BLOCKS: usize = 4096;
/// Most points of the trace.
const TRACE: usize = 1500;

impl FileScores {
    pub(super) fn new(layout: &Layout, candidates: usize) -> Self {
        let none = vec![no_sums(layout.joints()); candidates];
        Self {
            moving: none.clone(),
            still: none,
            range: PerJoint::repeat(layout.joints(), (f64::INFINITY, f64::NEG_INFINITY)),
            equations: NormalEquations::new(layout, 0),
            blocks: Vec::new(),
            block_s: 1.0,
            sample: Thinned::new(SAMPLE),
            trace: Thinned::new(TRACE),
        }
    }

    /// Begins a block where the row at `t_s` is not of the last one. Of too many, neighbours become one.
    fn begin_block(&mut self, t_s: f64) {
        let number = (t_s / self.block_s).floor();
        if self.blocks.last().is_some_and(|(last, _)| *last == number) {
            return;
        }
        if self.blocks.len() == MOST_BLOCKS {
            self.block_s *= 2.0;
            let mut joined: Vec<(f64, Vec<PerJoint<ErrorSums>>)> = Vec::new();
            for (number, sums) in std::mem::take(&mut self.blocks) {
                let number = (number / 2.0).floor();
                match joined.last_mut().filter(|(last, _)| *last == number) {
                    Some((_, before)) => {
                        for (before, sums) in before.iter_mut().zip(&sums) {
                            let both = |joint: usize| before[joint].with(&sums[joint]);
                            *before = PerJoint::from_fn(sums.len(), both);
                        }
                    }
                    None => joined.push((number, sums)),
                }
            }
            self.blocks = joined;
            return self.begin_block(t_s);
        }
        let none = no_sums(self.range.len());
        self.blocks.push((number, vec![none; self.moving.len()]));
    }

    /// Adds a stretch: model and measurement through the same filter, network output included.
    pub(super) fn add(
        &mut self,
        layout: &Layout,
        preparation: &Preparation,
        prepared: &Prepared,
        candidates: &[&Candidate],
    ) {
        let candidates = candidates.iter();
        let predicted: Vec<Vec<f64>> = candidates
            .map(|candidate| predictions(layout, preparation, prepared, candidate))
            .collect();
        let stride = preparation.stride();
        let joints = layout.joints();
        for row in prepared.core.clone() {
            self.begin_block(prepared.t_s[row]);
            for joint in 0..joints {
                let place = row * joints + joint;
                let measured = prepared.tau[place];
                let add = |sums: &mut [PerJoint<ErrorSums>]| {
                    for (sums, predicted) in sums.iter_mut().zip(&predicted) {
                        sums[joint].add(measured, predicted[place]);
                    }
                };
                if prepared.states[row].qd[joint].abs() <= preparation.still_rad_s {
                    add(&mut self.still);
                    continue;
                }
                add(&mut self.moving);
                if let Some((_, block)) = self.blocks.last_mut() {
                    add(block);
                }
                let (low, high) = self.range[joint];
                self.range[joint] = (low.min(measured), high.max(measured));
            }
        }
        let rows = prepared.core.clone().filter(|row| row % stride == 0);
        let rows: Vec<usize> = rows.collect();
        let sampled = |row: &usize| prepared.sample_row(layout, preparation, *row);
        let sampled: Vec<SampleRow> = rows.iter().map(sampled).collect();
        self.equations.add(&sampled, |row, joint| {
            (row.columns(layout, joint), row.tau[joint])
        });
        for (row, sampled) in rows.into_iter().zip(sampled) {
            let of_row = |table: &Vec<f64>| PerJoint::from(&table[row * joints..][..joints]);
            let predicted = predicted.iter().map(of_row).collect();
            self.trace.push((sampled.t_s, sampled.tau, predicted));
            self.sample.push(sampled);
        }
    }

    /// Errors of one candidate, with 95 % intervals by bootstrap over seconds.
    pub(super) fn record(&self, candidate: usize, seed: u64) -> ValidationRecord {
        let (moving, still) = (&self.moving[candidate], &self.still[candidate]);
        let count = self.range.len();
        let joints =
            |value: &dyn Fn(usize) -> Option<f64>| (0..count).map(value).collect::<Vec<_>>();
        let rmse = |j: usize| moving[j].rmse();
        let draws = resample(self.blocks.len().max(1), seed, |draw| {
            let mut sums = no_sums(count);
            for &place in draw {
                let (_, block) = self.blocks.get(place)?;
                sums = PerJoint::from_fn(count, |j| sums[j].with(&block[candidate][j]));
            }
            Some(sums)
        });
        let interval = |j: usize| middle(draws.iter().filter_map(|sums| sums[j].rmse()));
        ValidationRecord {
            rmse_moving_nm: joints(&rmse),
            rmse_still_nm: joints(&|j| still[j].rmse()),
            rmse_all_nm: joints(&|j| moving[j].with(&still[j]).rmse()),
            joints_nrmse_moving_ratio: nrmse(moving),
            nrmse_moving_ratio: joints(&|j| moving[j].nrmse()),
            rmse_over_range_moving_ratio: joints(&|j| {
                Some(rmse(j)? / (self.range[j].1 - self.range[j].0))
            }),
            torque_rms_moving_nm: joints(&|j| moving[j].torque_rms()),
            joints_nrmse_moving_ratio_ci95: middle(draws.iter().filter_map(|sums| nrmse(sums))),
            rmse_moving_nm_ci95: (0..count).map(interval).collect(),
            rows_moving: moving.iter().map(|sums| sums.count as u64).collect(),
            cramer_rao_nrmse_moving_ratio: None,
            truth_nrmse_moving_ratio: None,
        }
    }

    /// RMS over the joints of (RMS torque of a parameter error / RMS torque), a ratio.
    ///
    /// * `covariance` of the parameter error: that of a fit for the share of the training noise, or `e eᵀ` of a known error
    pub(super) fn propagated(&self, layout: &Layout, covariance: &DMatrix<f64>) -> f64 {
        let joints = self.equations.joints.iter().zip(&layout.active);
        let moving = joints.filter(|(sums, _)| sums.power > 0.0);
        root_mean(moving.map(|(sums, active)| {
            let mut trace = 0.0;
            for (a, &row) in active.iter().enumerate() {
                for (b, &column) in active.iter().enumerate() {
                    trace += sums.gram[(a, b)] * covariance[(row, column)];
                }
            }
            trace / sums.power
        }))
    }
}

/// Stretches of the log that are held out in turn: the paper trains on 80 %, and validates on 20 %.
const STRETCHES: usize = 5;
/// Rows of the whole log that are shared out for the learning curves.
const ROWS: usize = 4000;
/// Shares from the start of the log.
const SHARES: [f64; 5] = [0.0625, 0.125, 0.25, 0.5, 1.0];

/// Errors of every method on each fifth of the log, trained on the other four, and then of `rivals`.
///
/// A fifth is a stretch of time: rows drawn at random lie between training rows, and their errors are hardly larger than
/// those of the fit. A fifth that alone shows a parameter stays in the training rows, and one in which no joint moves has no
/// error; where all do, the errors are those of `results`, which are trained on every row.
pub(super) fn split(
    problem: &Problem<'_>,
    results: &[MethodResult],
    rivals: &[Candidate],
    sample: &[SampleRow],
) -> Result<Vec<SplitRecord>, IdentifyError> {
    let layout = problem.layout;
    let mut sums = vec![Vec::new(); results.len() + rivals.len()];
    let mut add = |results: &[MethodResult], rows: &[SampleRow]| {
        let trained = results.iter().map(|result| &result.candidate);
        for (sums, candidate) in sums.iter_mut().zip(trained.chain(rivals)) {
            sums.push(error_sums(layout, candidate, rows));
        }
    };
    let mut held_out = false;
    for stretch in 0..STRETCHES {
        let [from, to] = [stretch, stretch + 1].map(|k| k * sample.len() / STRETCHES);
        let own = &sample[from..to];
        let rest = sample[..from].iter().chain(&sample[to..]);
        let data = TrainingData::of(layout, rest.collect());
        let moves = own.iter().any(|row| row.moving.contains(&true));
        if moves && data.sums.all.check_rank(layout).is_ok() {
            match solve_all(problem, &data, &|_| ()) {
                Ok(results) => add(&results, own),
                // It shows a parameter all but alone.
                Err(IdentifyError::Unsolvable) => continue,
                Err(other) => return Err(other),
            }
            held_out = true;
        }
    }
    if !held_out {
        add(results, sample);
    }
    let joints = layout.joints();
    let records = sums.iter().map(|sums| SplitRecord::of(joints, sums));
    Ok(records.collect())
}

/// Errors on rows of an unseen log of a method trained on growing shares of the log.
pub(super) fn learning_curve(
    name: MethodName,
    problem: &Problem<'_>,
    sample: &[SampleRow],
    unseen: &[SampleRow],
) -> Vec<LearningPoint> {
    let rows: Vec<&SampleRow> = even_sample(sample, ROWS).collect();
    let one = Problem {
        methods: &[name],
        ..*problem
    };
    let points = SHARES.iter().filter_map(|&share_ratio| {
        let count = (share_ratio * rows.len() as f64) as usize;
        let data = TrainingData::of(problem.layout, rows[..count].to_vec());
        // A share that does not show every parameter has no point.
        data.sums.all.check_rank(problem.layout).ok()?;
        let result = solve_all(&one, &data, &|_| ()).ok()?.pop()?;
        let sums = error_sums(problem.layout, &result.candidate, unseen);
        Some(LearningPoint {
            share_ratio,
            rows: count,
            seconds: result.record.seconds,
            joints_nrmse_moving_ratio: nrmse(&sums)?,
        })
    });
    points.collect()
}

/// Errors of every joint over its moving rows.
fn error_sums(layout: &Layout, candidate: &Candidate, rows: &[SampleRow]) -> PerJoint<ErrorSums> {
    let mut sums = no_sums(layout.joints());
    for row in rows {
        let predicted = candidate.torque(layout, row);
        for joint in (0..layout.joints()).filter(|&joint| row.moving[joint]) {
            sums[joint].add(row.tau[joint], predicted[joint]);
        }
    }
    sums
}

fn no_sums(joints: usize) -> PerJoint<ErrorSums> {
    PerJoint::repeat(joints, ErrorSums::default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::RigidBodies;
    use crate::identification::dataset::random_rows;
    use crate::identification::{ColumnSet, fit_rows};
    use crate::robot::Robot;

    #[test]
    fn a_log_of_hours_has_a_bounded_number_of_blocks() {
        let robot = Robot::load("ur5").expect("built in");
        let mut scores = FileScores::new(&Layout::new(&robot, &ColumnSet::plain()), 2);
        let pause = |t: u32| t + 1000 * (t / 5000);
        for t in 0..20_000 {
            scores.begin_block(f64::from(pause(t)) + 0.5);
            let (_, block) = scores.blocks.last_mut().expect("begun");
            block[1][5].add(1.0, 0.0);
        }
        assert!((1000..=MOST_BLOCKS).contains(&scores.blocks.len()));
        let rows = scores.blocks.iter().map(|(_, block)| block[1][5].count);
        assert_eq!(rows.sum::<f64>(), 20e3);
    }

    /// Errors of weighted least squares and of zero torque on 2000 rows of a UR5 after `change` of each.
    fn split_of(change: &dyn Fn(usize, &mut SampleRow)) -> [Vec<f64>; 2] {
        let robot = Robot::load("ur5").expect("built in");
        let layout = Layout::new(&robot, &ColumnSet::plain());
        let model = RigidBodies::new(&robot);
        let torque = |row: &SampleRow, j: usize| model.inverse_dynamics(&row.state)[j];
        let mut rows = random_rows(&layout, 2000, 1, [2.0, 1.0, 3.0], 1e-3, torque);
        let places = rows.iter_mut().enumerate();
        places.for_each(|(place, row)| change(place, row));
        let methods = &[MethodName::Wls];
        let all: Vec<&SampleRow> = rows.iter().collect();
        let results = fit_rows(&robot, (&layout, &layout), methods, &all, 1).expect("well shown");
        let problem = Problem {
            robot: &robot,
            layout: &layout,
            board: &layout,
            methods,
            networks: true,
            seed: 1,
        };
        let zero = Candidate::Linear(nalgebra::DVector::zeros(layout.parameters.len()));
        let records = split(&problem, &results, &[zero], &rows).expect("solved");
        let ratios = |place: usize| records[place].stretches_nrmse_moving_ratio.clone();
        [0, 1].map(ratios)
    }

    #[test]
    fn a_held_out_stretch_is_not_in_its_own_training_rows() {
        // The arm of the last fifth has half of the torques.
        let [errors, zero] = split_of(&|place, row| {
            if place >= 1600 {
                row.tau.iter_mut().for_each(|tau| *tau *= 0.5);
            }
        });
        assert_eq!((errors.len(), zero.len()), (5, 5));
        assert!((errors[4] - 1.0).abs() < 0.05, "{errors:?}");
        assert!(zero.iter().all(|ratio| (ratio - 1.0).abs() < 1e-12));
    }

    #[test]
    fn a_stretch_at_rest_has_no_error() {
        let [errors, zero] = split_of(&|place, row| {
            if place < 400 {
                row.moving = PerJoint::repeat(6, false);
            }
        });
        assert_eq!((errors.len(), zero.len()), (4, 4));
        assert!(errors.iter().all(|ratio| *ratio > 0.0), "{errors:?}");
    }

    #[test]
    fn a_log_whose_stretches_are_all_needed_is_judged_by_its_training_rows() {
        // Each of the first five joints moves in one fifth alone.
        let [errors, zero] = split_of(&|place, row| {
            for joint in 0..5 {
                row.moving[joint] = joint == place / 400;
            }
        });
        assert_eq!((errors.len(), zero.len()), (1, 1));
        assert!(errors[0] < 0.1, "{errors:?}");
    }
}
