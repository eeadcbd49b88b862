//! All methods side by side on the same logs.

use super::bootstrap::parameter_intervals;
use super::cogging::CoggingAmplitudes;
use super::columns::{ColumnSet, Layout};
use super::consistent::consistent;
use super::dataset::Dataset;
use super::error::IdentifyError;
use super::evidence::evidence;
use super::filter::Butterworth;
use super::fourier::folded;
use super::gains::standstill_gains;
use super::learning_curve::learning_curves;
use super::methods::{Fit, MethodName, wls};
use super::prepare::PrepareConfig;
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData};
use super::record::{GainRecord, MethodRecord, Report};
use super::solve::solve_all;
use super::split::split;
use super::stream::for_each_prepared;
use super::truth::{error_curve, truths};
use super::validation::FileScores;
use super::whole_log::WholeLog;
use crate::robot::Robot;
use foretorque::feedforward::JointNetwork;
use nalgebra::DVector;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Settings of an identification.
#[derive(Clone, Debug)]
pub struct IdentifyConfig {
    /// Methods.
    pub methods: Vec<MethodName>,
    /// Friction columns.
    pub columns: ColumnSet,
    /// Filters and standstill.
    pub prepare: PrepareConfig,
    /// Period on which training logs are folded and projected on its harmonics instead of filtered, s.
    pub fold_period_s: Option<f64>,
    /// Find the drive gains from standstill first.
    pub gains_from_standstill: bool,
    /// Seed of random starts, of the split and of resampling.
    pub seed: u64,
    /// The robot whose parameters are the truth, if it is known.
    pub truth: Option<Robot>,
}

/// Result of an identification.
#[derive(Clone, Debug)]
pub struct Outcome<const N: usize> {
    /// All figures.
    pub report: Report,
    /// Columns that the board has.
    pub bank_layout: Layout<N>,
    /// The recommended fit over them.
    pub bank_fit: Fit<N>,
    /// The recommended residual networks, if it has any.
    pub networks: Option<Box<[JointNetwork; N]>>,
    /// Their direct connections from the cogging phase, N·m.
    pub cogging: Option<CoggingAmplitudes<N>>,
    /// The description with the consistent parameters, if they were asked for.
    pub robot: Option<Robot>,
    /// Time, measured and predicted torque on the first validation log: of the recommended method.
    pub trace: Vec<(f64, [f64; N], [f64; N])>,
}

/// Time, measured torque, and the torque that every method predicts, N·m.
type Trace<const N: usize> = Vec<(f64, [f64; N], Vec<[f64; N]>)>;

/// Methods by name.
type Methods = BTreeMap<String, MethodRecord>;

/// Parameters of a robot by all methods, validated on unseen logs.
///
/// Errors: [`IdentifyError`].
pub fn identify<const N: usize>(
    robot: &Robot,
    logs: &[PathBuf],
    validate: &[PathBuf],
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Result<Outcome<N>, IdentifyError> {
    for path in logs.iter().chain(validate) {
        check_cut_offs::<N>(path, robot, &config.prepare)?;
    }
    let (robot, drive_gains) = with_gains::<N>(robot, logs, config, progress)?;
    let other_size = || IdentifyError::Joints {
        robot: robot.name.clone(),
        joints: N,
    };
    let layout = Layout::<N>::new(&robot, &config.columns).ok_or_else(other_size)?;
    let (on_board, left_out) = config.columns.on_board();
    let board = Layout::<N>::new(&robot, &on_board).ok_or_else(other_size)?;
    let mut notes = Vec::new();
    let dataset = gather(&robot, &layout, logs, config, &mut notes, progress)?;
    let problem = Problem {
        robot: &robot,
        layout: &layout,
        board: &board,
        methods: &config.methods,
        seed: config.seed,
    };
    let data = TrainingData::all(&dataset);
    let truth = config.truth.as_ref().map(|truth| truths(truth, &layout));
    let study = Study {
        problem,
        dataset: &dataset,
        bound: wls(&data.sums, &layout).ok_or(IdentifyError::Unsolvable)?,
        results: solve_all(&problem, &data, progress)?,
        truth: truth.as_deref(),
        progress,
    };
    let mut methods = study.records(&data)?;
    let trace = study.validate(validate, &config.prepare, &mut methods, &mut notes)?;
    let recommended = study.recommended(&methods);
    let best = &study.results[recommended];
    let bank_fit = study.bank_fit(best, left_out.is_empty())?;
    if !left_out.is_empty() {
        notes.push(format!(
            "the board has no column {}: the bank holds a fit without",
            left_out.join(", ")
        ));
    }
    let report = Report {
        robot: robot.name.clone(),
        logs: logs.iter().map(|path| key_of(path, logs)).collect(),
        notes,
        drive_gains,
        recommended: best.name.to_string(),
        methods,
        ..report(config, &dataset, &layout)
    };
    let (networks, cogging) = match &best.candidate {
        Candidate::Residual {
            networks, cogging, ..
        } => (Some(networks.clone()), Some(*cogging)),
        _ => (None, None),
    };
    let robot = study.results.iter().find_map(|result| result.robot.clone());
    let trace = trace.into_iter();
    Ok(Outcome {
        report,
        bank_fit,
        networks,
        cogging,
        robot,
        trace: trace
            .map(|(t_s, tau, predicted)| (t_s, tau, predicted[recommended]))
            .collect(),
        bank_layout: board,
    })
}

/// The figures of settings and dataset.
fn report<const N: usize>(
    config: &IdentifyConfig,
    dataset: &Dataset<N>,
    layout: &Layout<N>,
) -> Report {
    let (condition_number, condition_number_equilibrated) = dataset.sums.condition_numbers(layout);
    let still = dataset.still.iter();
    Report {
        robot: String::new(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        columns: config.columns.to_string(),
        drive_gains: Vec::new(),
        logs: Vec::new(),
        notes: Vec::new(),
        fold_period_s: config.fold_period_s,
        motion_cutoff_hz: config.prepare.motion_hz,
        torque_cutoff_hz: config.prepare.torque_hz,
        still_rad_s: config.prepare.still_rad_s,
        rows_read: dataset.rows_read,
        rows_used: dataset.rows,
        still_share_ratio: still
            .map(|&still| still as f64 / dataset.rows_read.max(1) as f64)
            .collect(),
        spikes: dataset.spikes,
        rank: layout.parameters.len(),
        condition_number,
        condition_number_of: "raw SI regressor of the base parameters, moving rows, Craig link frames, first independent columns from left to right".to_owned(),
        condition_number_equilibrated,
        recommended: String::new(),
        methods: BTreeMap::new(),
    }
}

/// All methods on one dataset.
struct Study<'a, const N: usize> {
    problem: Problem<'a, N>,
    dataset: &'a Dataset<N>,
    /// Weighted least squares, whose covariance is the Cramér–Rao bound.
    bound: Fit<N>,
    results: Vec<MethodResult<N>>,
    truth: Option<&'a [Option<f64>]>,
    progress: Progress<'a>,
}

impl<const N: usize> Study<'_, N> {
    /// The records of all methods, without validation logs.
    fn records(&self, data: &TrainingData<'_, N>) -> Result<Methods, IdentifyError> {
        (self.progress)("80/20 split");
        let (layout, seed) = (self.problem.layout, self.problem.seed);
        let splits = split(&self.problem, self.dataset)?;
        let mut methods = Methods::new();
        for (result, split) in self.results.iter().zip(splits) {
            let mut record = MethodRecord::of(result, layout, self.truth, split);
            let intervals = parameter_intervals(layout, data, result, seed);
            let intervals = intervals.into_iter().flatten();
            for (parameter, interval) in record.parameters.iter_mut().zip(intervals) {
                parameter.ci95 = Some(interval);
            }
            if result.name == MethodName::BpPhysical {
                record.base_parameter_error_ratio_by_epoch =
                    error_curve(data, layout, &self.bound, self.truth, seed);
            }
            methods.insert(result.name.to_string(), record);
        }
        Ok(methods)
    }

    /// Puts the errors on unseen logs into `methods`; returns the torques on the first of them.
    fn validate(
        &self,
        logs: &[PathBuf],
        prepare: &PrepareConfig,
        methods: &mut Methods,
        notes: &mut Vec<String>,
    ) -> Result<Trace<N>, IdentifyError> {
        let Problem { robot, layout, .. } = self.problem;
        let candidates: Vec<&Candidate<N>> = self
            .results
            .iter()
            .map(|result| &result.candidate)
            .collect();
        let mut trace = Vec::new();
        for path in logs {
            (self.progress)(&format!("validating {}", path.display()));
            let mut scores = FileScores::new(layout, candidates.len());
            for_each_prepared(path, robot, layout, prepare, notes, &mut |own, prepared| {
                scores.add(layout, own, &prepared, &candidates);
            })?;
            let limit = scores.propagated(layout, &self.bound.covariance);
            for (place, result) in self.results.iter().enumerate() {
                let mut record = scores.record(place);
                scores.intervals(place, self.problem.seed, &mut record);
                record.cramer_rao_nrmse_moving_ratio = Some(limit);
                record.truth_nrmse_moving_ratio = self.error_of(result, &scores);
                if let Some(method) = methods.get_mut(&result.name.to_string()) {
                    method.validation.insert(key_of(path, logs), record);
                }
            }
            if trace.is_empty() {
                (self.progress)("growing shares of the logs");
                for (name, curve) in learning_curves(&self.problem, self.dataset, &scores.sample) {
                    if let Some(method) = methods.get_mut(&name.to_string()) {
                        method.learning_curve = curve;
                    }
                }
                trace = scores.trace;
            }
        }
        Ok(trace)
    }

    /// Error of a linear model against the noise-free torque of the truth, if all of that is known.
    fn error_of(&self, result: &MethodResult<N>, scores: &FileScores<N>) -> Option<f64> {
        let Candidate::Linear(theta) = &result.candidate else {
            return None;
        };
        let truth: Vec<f64> = self.truth?.iter().copied().collect::<Option<_>>()?;
        let error = theta - DVector::from_vec(truth);
        Some(scores.propagated_error(self.problem.layout, &error))
    }

    /// The method with the least error on moving rows it was not trained on, of those the board can run: mean over the
    /// validation logs, or without any the rows that the split held out.
    fn recommended(&self, methods: &Methods) -> usize {
        let error = |result: &MethodResult<N>| {
            let record = methods.get(&result.name.to_string())?;
            let logs = record.validation.values();
            let ratios = logs.map(|log| log.joints_nrmse_moving_ratio);
            Some(match record.validation.len() {
                0 => {
                    let ratios = record.split_80_20.nrmse_moving_ratio.iter().flatten();
                    ratios.map(|ratio| ratio * ratio).sum::<f64>()
                }
                logs => ratios.sum::<f64>() / logs as f64,
            })
        };
        let mut best = (0, f64::INFINITY);
        for (place, result) in self.results.iter().enumerate() {
            let on_board = !matches!(result.candidate, Candidate::BlackBox(_));
            if let Some(error) = error(result).filter(|error| on_board && *error < best.1) {
                best = (place, error);
            }
        }
        best.0
    }

    /// The recommended parameters over the columns that the board has.
    ///
    /// * `complete` the board has all columns
    fn bank_fit(&self, result: &MethodResult<N>, complete: bool) -> Result<Fit<N>, IdentifyError> {
        let Problem {
            robot,
            layout,
            board,
            ..
        } = self.problem;
        if let (true, Some(fit)) = (complete, &result.fit) {
            return Ok(fit.clone());
        }
        if let (Candidate::Residual { .. }, Some(fit)) = (&result.candidate, &result.fit) {
            let places = layout.places_of(board);
            return Ok(Fit {
                theta: fit.theta.select_rows(&places),
                covariance: fit.covariance.select_rows(&places).select_columns(&places),
                ..fit.clone()
            });
        }
        let sums = self.dataset.clean_sums.subset(layout, board);
        let free = wls(&sums, board).ok_or(IdentifyError::Unsolvable)?;
        let fit = match result.name {
            MethodName::Consistent => consistent(robot, board, &free).map(|found| found.fit),
            MethodName::Evidence => evidence(robot, board, &sums, &free.sigma),
            _ => Some(free),
        };
        fit.ok_or(IdentifyError::Unsolvable)
    }
}

/// The robot with the drive gains to use, and their records if they were found from standstill.
fn with_gains<const N: usize>(
    robot: &Robot,
    logs: &[PathBuf],
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Result<(Robot, Vec<GainRecord>), IdentifyError> {
    let mut robot = robot.clone();
    if !config.gains_from_standstill {
        return Ok((robot, Vec::new()));
    }
    progress("drive gains");
    let gains = standstill_gains::<N>(&robot, logs, config.prepare.still_rad_s)?;
    for (joint, record) in robot.joints.iter_mut().zip(&gains) {
        joint.drive.gain = record.gain_nm_a;
    }
    Ok((robot, gains))
}

/// Errors: the log's; its rows are too far apart for one of the filters.
fn check_cut_offs<const N: usize>(
    path: &Path,
    robot: &Robot,
    config: &PrepareConfig,
) -> Result<(), IdentifyError> {
    let period_s = WholeLog::<N>::open(path, robot)?.period_s();
    let asked = [
        ("--motion-hz", Some(config.motion_hz)),
        ("--torque-hz", config.torque_hz),
    ];
    for (option, hz) in asked {
        if let Some(asked_hz) = hz.filter(|hz| Butterworth::new(*hz, period_s).is_none()) {
            return Err(IdentifyError::CutOff {
                log: path.display().to_string(),
                option,
                asked_hz,
                rate_hz: 1.0 / period_s,
            });
        }
    }
    Ok(())
}

/// One pass over the training logs.
fn gather<const N: usize>(
    robot: &Robot,
    layout: &Layout<N>,
    logs: &[PathBuf],
    config: &IdentifyConfig,
    notes: &mut Vec<String>,
    progress: Progress<'_>,
) -> Result<Dataset<N>, IdentifyError> {
    let mut dataset = Dataset::new(layout);
    for path in logs {
        progress(&format!("reading {}", path.display()));
        if let Some(period_s) = config.fold_period_s {
            let (preparation, prepared) =
                folded(path, robot, layout, &config.prepare, period_s, notes)?;
            dataset.add(layout, &preparation, &prepared);
            continue;
        }
        for_each_prepared(
            path,
            robot,
            layout,
            &config.prepare,
            notes,
            &mut |preparation, prepared| {
                dataset.add(layout, preparation, &prepared);
            },
        )?;
    }
    if dataset.sums.count() == 0.0 {
        let names: Vec<String> = logs.iter().map(|path| path.display().to_string()).collect();
        return Err(IdentifyError::NoMotion {
            logs: names.join(", "),
        });
    }
    dataset.sums.check_rank(layout)?;
    if dataset.thinning > 1 {
        notes.push(format!(
            "irls, consistent, bp_black_box and bp_residual used every {}th of the rows in the sums; the other methods all of them",
            dataset.thinning
        ));
    }
    Ok(dataset)
}

/// The file's name, or its path where two files share a name.
fn key_of(path: &Path, all: &[PathBuf]) -> String {
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    let twins = all
        .iter()
        .filter(|other| other.file_name() == path.file_name())
        .count();
    name.filter(|_| twins <= 1)
        .unwrap_or_else(|| path.display().to_string())
}
