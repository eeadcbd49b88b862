//! All methods side by side on the same logs.

use super::blocks::with_block_deviations;
use super::bootstrap::parameter_intervals;
use super::cogging::CoggingAmplitudes;
use super::columns::{ColumnSet, Layout};
use super::consistent::consistent;
use super::dataset::Dataset;
use super::dataset::SampleRow;
use super::error::IdentifyError;
use super::evidence::evidence;
use super::fourier::folded;
use super::gains::with_gains;
use super::holdout::{errors, learning_curves, split};
use super::judge::{Judgement, after_fit, description};
use super::methods::{Fit, MethodName, wls};
use super::prepare::PrepareConfig;
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData};
use super::record::{MethodRecord, RIVALS, Report, ValidationRecord};
use super::solve::solve_all;
use super::stream::for_each_prepared;
use super::truth::{error_curve, truths};
use super::validation::{FileScores, Trace};
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
    /// Further unseen logs, by which nothing is chosen.
    pub test: Vec<PathBuf>,
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
    for path in logs.iter().chain(validate).chain(&config.test) {
        config.prepare.check::<N>(path, robot)?;
    }
    let (robot, drive_gains) = if config.gains_from_standstill {
        progress("drive gains");
        with_gains::<N>(robot, logs, config.prepare.still_rad_s)?
    } else {
        (robot.clone(), Vec::new())
    };
    let (on_board, left_out) = config.columns.on_board();
    let layout = |columns| Layout::<N>::new(&robot, columns);
    let layouts = layout(&config.columns).zip(layout(&on_board));
    let (layout, board) = layouts.ok_or_else(|| IdentifyError::Joints(robot.name.clone(), N))?;
    let mut notes = Vec::new();
    let dataset = gather(&robot, &layout, logs, config, &mut notes, progress)?;
    let data = TrainingData::all(&dataset);
    let problem = Problem {
        robot: &robot,
        layout: &layout,
        board: &board,
        methods: &config.methods,
        seed: config.seed,
    };
    let mut study = Study {
        problem,
        dataset: &dataset,
        bound: wls(&data.sums.all, &layout).ok_or(IdentifyError::Unsolvable)?,
        results: solve_all(&problem, &data, progress)?,
        truth: config.truth.as_ref().map(|truth| truths(truth, &layout)),
        progress,
    };
    let mut methods = study.records(&data)?;
    let prepare = &config.prepare;
    let trace = study.validate(
        (validate, Unseen::Validation),
        prepare,
        &mut methods,
        &mut notes,
    )?;
    study.validate(
        (&config.test, Unseen::Test),
        prepare,
        &mut methods,
        &mut notes,
    )?;
    let recommended = recommended(&study.results, &methods);
    let best = &study.results[recommended];
    let bank_fit = study.bank_fit(best, left_out.is_empty())?;
    if !left_out.is_empty() {
        let columns = left_out.join(", ");
        notes.push(format!(
            "the board has no column {columns}: the bank holds a fit without"
        ));
    }
    let mut judgement = Judgement::default();
    for path in validate.iter().chain(&config.test) {
        if let Some(same) = logs.iter().find(|log| same_content(log, path)) {
            let (path, same) = (path.display(), same.display());
            judgement.find(false, format!("{path} holds what the training log {same} holds: its errors are not those of unseen motion"));
        }
    }
    if let Some(fit) = study.results.iter().find_map(|result| result.fit.as_ref()) {
        after_fit(
            &mut judgement,
            &robot,
            &layout,
            if fit.theta.len() == layout.parameters.len() {
                fit
            } else {
                &study.bound
            },
        );
    }
    let errors = |name: &str| {
        let method = &methods[name];
        let unseen = method.validation.get(
            &validate
                .first()
                .map_or(String::new(), |path| key_of(path, validate)),
        );
        unseen
            .map_or(&method.split_80_20.rmse_moving_nm, |record| {
                &record.rmse_moving_nm
            })
            .clone()
    };
    let headline_rmse_nm = errors(&best.name.to_string());
    let headline_description_rmse_nm = errors(RIVALS[0]);
    let size = errors(RIVALS[1]);
    for (rival, limit) in RIVALS.iter().zip([1.05, 1.0]) {
        let worse = over(&headline_rmse_nm, &errors(rival), &size);
        if worse > limit {
            let torque = if *rival == "zero" { " torque" } else { "" };
            judgement.find(true, format!("the identified parameters predict worse than {rival}{torque}: {worse:.2} times its torque error"));
        }
    }
    let report = Report {
        robot: robot.name.clone(),
        headline_rmse_nm,
        headline_description_rmse_nm,
        findings: judgement.findings,
        drive_gains,
        logs: logs.iter().map(|path| key_of(path, logs)).collect(),
        notes,
        recommended: best.name.to_string(),
        methods,
        ..figures(config, &dataset, &layout)
    };
    let (networks, cogging) = match &best.candidate {
        Candidate::Residual {
            networks, cogging, ..
        } => (Some(networks.clone()), Some(*cogging)),
        _ => (None, None),
    };
    let consistent = study.results.iter().find_map(|result| result.robot.clone());
    let trace = trace.into_iter();
    Ok(Outcome {
        report,
        bank_fit,
        networks,
        cogging,
        robot: consistent,
        trace: trace
            .map(|(t_s, tau, predicted)| (t_s, tau, predicted[recommended]))
            .collect(),
        bank_layout: board.clone(),
    })
}

/// Figures of settings and dataset.
fn figures<const N: usize>(
    config: &IdentifyConfig,
    dataset: &Dataset<N>,
    layout: &Layout<N>,
) -> Report {
    let (condition_number, equilibrated) = dataset.sums.all.condition_numbers(layout);
    let share = |still: usize| still as f64 / dataset.rows_read.max(1) as f64;
    Report {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        columns: config.columns.to_string(),
        fold_period_s: config.fold_period_s,
        motion_cutoff_hz: config.prepare.motion_hz,
        torque_cutoff_hz: config.prepare.torque_hz,
        still_rad_s: config.prepare.still_rad_s,
        rows_read: dataset.rows_read,
        rows_used: dataset.sums.rows,
        still_share_ratio: dataset.still.map(share).to_vec(),
        spikes: dataset.spikes,
        rank: layout.parameters.len(),
        condition_number,
        condition_number_of: "raw SI regressor of the base parameters, moving rows, Craig link frames, first independent columns from left to right".to_owned(),
        condition_number_equilibrated: equilibrated,
        ..Report::default()
    }
}

/// Dataset of the training logs, in one pass.
fn gather<const N: usize>(
    robot: &Robot,
    layout: &Layout<N>,
    logs: &[PathBuf],
    config: &IdentifyConfig,
    notes: &mut Vec<String>,
    progress: Progress<'_>,
) -> Result<Dataset<N>, IdentifyError> {
    let (mut dataset, prepare) = (Dataset::new(layout), &config.prepare);
    for path in logs {
        progress(&format!("reading {}", path.display()));
        if let Some(period_s) = config.fold_period_s {
            let (own, prepared) = folded(path, robot, layout, prepare, period_s, notes)?;
            dataset.add(layout, &own, &prepared);
        } else {
            for_each_prepared(path, robot, layout, prepare, notes, &mut |own, prepared| {
                dataset.add(layout, own, &prepared);
            })?;
        }
    }
    if dataset.sums.all.count() == 0.0 {
        let names: Vec<String> = logs.iter().map(|path| path.display().to_string()).collect();
        return Err(IdentifyError::NoMotion(names.join(", ")));
    }
    dataset.sums.all.check_rank(layout)?;
    if dataset.thinning > 1 {
        notes.push(format!(
            "irls, consistent, bp_black_box and bp_residual used every {}th of the rows in the sums; the other methods all of them",
            dataset.thinning
        ));
    }
    Ok(dataset)
}

/// Share of the RMS torque that every error has added, so that none is decided by noise or by rounding.
const INDIFFERENT: f64 = 0.03;

/// Geometric mean over the joints of one error over another; `size` is the RMS torque.
fn over(own: &[Option<f64>], other: &[Option<f64>], size: &[Option<f64>]) -> f64 {
    let joints = own.iter().zip(other).zip(size);
    let ratios = joints.filter_map(|((own, other), size)| {
        let least = INDIFFERENT * (*size)?;
        Some((*own)?.hypot(least) / (*other)?.hypot(least))
    });
    let logs: Vec<f64> = ratios.filter(|ratio| *ratio > 0.0).map(f64::ln).collect();
    (logs.iter().sum::<f64>() / logs.len().max(1) as f64).exp()
}

/// Two files with the same bytes.
fn same_content(one: &Path, other: &Path) -> bool {
    let length = |path: &Path| std::fs::metadata(path).map(|file| file.len()).ok();
    let bytes = |path: &Path| std::fs::read(path).ok();
    length(one) == length(other) && bytes(one).is_some() && bytes(one) == bytes(other)
}

/// Unseen logs that choose the method, and those that choose nothing.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Unseen {
    Validation,
    Test,
}

/// Records by name of the method.
type Methods = BTreeMap<String, MethodRecord>;

/// All methods on one dataset.
struct Study<'a, const N: usize> {
    problem: Problem<'a, N>,
    dataset: &'a Dataset<N>,
    /// Weighted least squares, whose covariance is the Cramér–Rao bound.
    bound: Fit<N>,
    results: Vec<MethodResult<N>>,
    truth: Option<Vec<Option<f64>>>,
    progress: Progress<'a>,
}

impl<const N: usize> Study<'_, N> {
    /// Records of all methods, without validation logs.
    fn records(&self, data: &TrainingData<'_, N>) -> Result<Methods, IdentifyError> {
        (self.progress)("80/20 split");
        let (layout, seed, truth) = (
            self.problem.layout,
            self.problem.seed,
            self.truth.as_deref(),
        );
        let splits = split(&self.problem, &self.dataset.sample)?;
        let described = description(self.problem.robot, layout);
        let mut methods = Methods::new();
        for (result, split) in self.results.iter().zip(splits) {
            let mut record = MethodRecord::of(result, layout, truth, split);
            for parameter in &mut record.parameters {
                let names = layout.parameters.iter().map(|own| &own.name);
                let place = names.into_iter().position(|name| *name == parameter.name);
                parameter.description = place.map(|place| described[place]);
            }
            let intervals = parameter_intervals(layout, data, result, seed);
            let intervals = intervals.into_iter().flatten();
            for (parameter, interval) in record.parameters.iter_mut().zip(intervals) {
                parameter.ci95 = Some(interval);
            }
            if result.name == MethodName::BpPhysical {
                record.base_parameter_error_ratio_by_epoch =
                    error_curve(data, layout, &self.bound, truth, seed);
            }
            methods.insert(result.name.to_string(), record);
        }
        let sample: Vec<&SampleRow<N>> = self.dataset.sample.iter().collect();
        for (name, candidate) in RIVALS.iter().zip(self.rivals()) {
            let record = MethodRecord {
                split_80_20: errors(layout, &candidate, &sample),
                ..MethodRecord::default()
            };
            methods.insert((*name).to_owned(), record);
        }
        Ok(methods)
    }

    /// The description's own parameters, and zero torque.
    fn rivals(&self) -> [Candidate<N>; 2] {
        let Problem { robot, layout, .. } = self.problem;
        let theta = description(robot, layout);
        let zero = DVector::zeros(theta.len());
        [theta, zero].map(Candidate::Linear)
    }

    /// Adds the errors on unseen logs to `methods`; returns the torques on the first of them.
    fn validate(
        &mut self,
        (logs, kind): (&[PathBuf], Unseen),
        prepare: &PrepareConfig,
        methods: &mut Methods,
        notes: &mut Vec<String>,
    ) -> Result<Trace<N>, IdentifyError> {
        let Problem { robot, layout, .. } = self.problem;
        // The linear part of networks competes with them, and takes their place where it is better on unseen rows.
        let fallback = self
            .results
            .iter()
            .position(|result| result.linear.is_some())
            .filter(|_| kind == Unseen::Validation);
        let linear = fallback.and_then(|place| self.results[place].linear.clone());
        let linear = linear.map(|fit| (Candidate::Linear(fit.theta.clone()), fit));
        let rivals = self.rivals();
        let results = self.results.iter().map(|result| &result.candidate);
        let last = linear.iter().map(|(candidate, _)| candidate);
        let candidates: Vec<&Candidate<N>> = results.chain(&rivals).chain(last).collect();
        let mut of_linear = BTreeMap::new();
        let mut trace = Vec::new();
        for path in logs {
            (self.progress)(&format!("validating {}", path.display()));
            let mut scores = FileScores::new(layout, candidates.len());
            for_each_prepared(path, robot, layout, prepare, notes, &mut |own, prepared| {
                scores.add(layout, own, &prepared, &candidates);
            })?;
            let limit = scores.propagated(layout, &self.bound.covariance);
            if linear.is_some() {
                let record = scores.record(candidates.len() - 1, self.problem.seed);
                of_linear.insert(key_of(path, logs), record);
            }
            for (place, result) in self.results.iter().enumerate() {
                let mut record = scores.record(place, self.problem.seed);
                record.cramer_rao_nrmse_moving_ratio = Some(limit);
                record.truth_nrmse_moving_ratio = self
                    .error(result)
                    .map(|error| scores.propagated(layout, &(&error * error.transpose())));
                if let Some(method) = methods.get_mut(&result.name.to_string()) {
                    method
                        .unseen(kind == Unseen::Test)
                        .insert(key_of(path, logs), record);
                }
            }
            for (place, name) in (self.results.len()..).zip(RIVALS) {
                if let Some(method) = methods.get_mut(name) {
                    let record = scores.record(place, self.problem.seed);
                    method
                        .unseen(kind == Unseen::Test)
                        .insert(key_of(path, logs), record);
                }
            }
            if trace.is_empty() && kind == Unseen::Validation {
                (self.progress)("growing shares of the logs");
                let sample = &self.dataset.sample;
                for (name, curve) in learning_curves(&self.problem, sample, &scores.sample) {
                    if let Some(method) = methods.get_mut(&name.to_string()) {
                        method.learning_curve = curve;
                    }
                }
                trace = scores.trace;
            }
        }
        if let (Some(place), Some((candidate, fit))) = (fallback, linear) {
            let result = &mut self.results[place];
            let Some(method) = methods.get_mut(&result.name.to_string()) else {
                return Ok(trace);
            };
            let error = |records: &BTreeMap<String, ValidationRecord>| {
                let errors = records.values().map(|log| log.joints_nrmse_moving_ratio);
                errors.sum::<f64>()
            };
            // A figure that is not a number is worse than any.
            let better = error(&method.validation) <= error(&of_linear);
            if !of_linear.is_empty() && !better {
                notes.push(format!(
                    "{}: on the validation logs its networks are worse than the linear part, which stands in for them",
                    result.name
                ));
                method.validation = of_linear;
                (result.candidate, result.fit) = (candidate, Some(fit));
                for (_, _, predicted) in &mut trace {
                    if let Some(linear) = predicted.last().copied() {
                        predicted[place] = linear;
                    }
                }
            }
            for (_, _, predicted) in &mut trace {
                predicted.pop();
            }
        }
        Ok(trace)
    }

    /// Parameter error of a linear model; `None` when a true parameter is unknown.
    fn error(&self, result: &MethodResult<N>) -> Option<DVector<f64>> {
        let Candidate::Linear(theta) = &result.candidate else {
            return None;
        };
        let truth = self.truth.as_ref()?.iter().copied();
        Some(theta - DVector::from_vec(truth.collect::<Option<Vec<f64>>>()?))
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
        let sums = self.dataset.sums.clean.subset(layout, board);
        let honest = |fit: Fit<N>| {
            with_block_deviations(fit, (&sums, board), (&self.dataset.sample, layout))
        };
        if let (true, Some(fit)) = (complete, &result.fit) {
            return Ok(honest(fit.clone()));
        }
        if let (Candidate::Residual { .. }, Some(fit)) = (&result.candidate, &result.fit) {
            let places = layout.places_of(board);
            return Ok(honest(Fit {
                theta: fit.theta.select_rows(&places),
                covariance: fit.covariance.select_rows(&places).select_columns(&places),
                ..*fit
            }));
        }
        let free = wls(&sums, board).ok_or(IdentifyError::Unsolvable)?;
        let fit = match result.name {
            MethodName::Consistent => consistent(robot, board, &free).map(|found| found.fit),
            MethodName::Evidence => evidence(robot, board, &sums, &free.sigma),
            _ => Some(free),
        };
        fit.map(honest).ok_or(IdentifyError::Unsolvable)
    }
}

/// Place of the method with the least error on moving rows it was not trained on, of those the board can run: mean over
/// the validation logs, or without any the rows that the split held out.
fn recommended<const N: usize>(results: &[MethodResult<N>], methods: &Methods) -> usize {
    let error = |result: &MethodResult<N>| {
        let record = &methods[&result.name.to_string()];
        let logs = record.validation.values();
        let errors = logs.map(|log| log.joints_nrmse_moving_ratio);
        let split = record.split_80_20.nrmse_moving_ratio.iter().flatten();
        match record.validation.len() {
            0 => split.map(|ratio| ratio * ratio).sum::<f64>(),
            logs => errors.sum::<f64>() / logs as f64,
        }
    };
    let mut best = (0, f64::INFINITY);
    for (place, result) in results.iter().enumerate() {
        let on_board = !matches!(result.candidate, Candidate::BlackBox(_));
        if on_board && error(result) < best.1 {
            best = (place, error(result));
        }
    }
    best.0
}

/// The file's name, or its path where two files share a name.
fn key_of(path: &Path, all: &[PathBuf]) -> String {
    let name = path.file_name();
    let others = all.iter().filter(|other| other.file_name() == name);
    let name = name.filter(|_| others.count() <= 1);
    name.map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    )
}
