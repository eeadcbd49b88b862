//! All methods side by side on the same logs.

use super::bootstrap::parameter_intervals;
use super::columns::{ColumnSet, Layout};
use super::consistent::consistent;
use super::evidence::evidence;
use super::filter::Butterworth;
use super::fourier::folded;
use super::gains::standstill_gains;
use super::gathered::Gathered;
use super::learning_curve::learning_curves;
use super::methods::{Fit, MethodName, wls};
use super::normal::IdentificationError;
use super::prepare::PrepareConfig;
use super::record::{MethodRecord, Report};
use super::ripple::Ripple;
use super::solve::{Material, Problem, Solved, solve_all, unsolvable};
use super::split::split;
use super::stream::for_each_prepared;
use super::truth::{error_curve, truths};
use super::validation::{Candidate, FileScores};
use super::whole_log::WholeLog;
use crate::robot::Robot;
use foretorque::feedforward::JointNetwork;
use nalgebra::DVector;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

/// What is to be done.
#[derive(Clone, Debug)]
pub struct IdentifyConfig {
    /// Methods.
    pub methods: Vec<MethodName>,
    /// Friction columns.
    pub columns: ColumnSet,
    /// Filters and standstill.
    pub prepare: PrepareConfig,
    /// Training logs repeat with this period, s: fold them and project on its harmonics instead of filtering.
    pub fold_period_s: Option<f64>,
    /// Find the drive gains from standstill first.
    pub gains_from_standstill: bool,
    /// Seed of random starts, of the split and of resampling.
    pub seed: u64,
    /// The robot whose parameters are the truth, if somebody knows it.
    pub truth: Option<Robot>,
}

/// Told what goes on: stage, and the loss while a network trains.
pub type Progress<'a> = &'a dyn Fn(&str);

/// What came out.
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
    pub ripple: Option<Ripple<N>>,
    /// The description with the consistent parameters, if they were asked for.
    pub robot: Option<Robot>,
    /// Time, measured and predicted torque on the first validation log: of the recommended method.
    pub trace: Vec<(f64, [f64; N], [f64; N])>,
}

/// Identifies, validates, reports.
///
/// Errors: of the logs ([`crate::table::TableError`]), or [`IdentificationError`].
pub fn identify<const N: usize>(
    robot: &Robot,
    logs: &[PathBuf],
    validate: &[PathBuf],
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Result<Outcome<N>, Box<dyn Error>> {
    for path in logs.iter().chain(validate) {
        show_cut_offs::<N>(path, robot, &config.prepare)?;
    }
    let mut robot = robot.clone();
    let mut drive_gains = Vec::new();
    if config.gains_from_standstill {
        progress("drive gains");
        drive_gains = standstill_gains::<N>(&robot, logs, config.prepare.still_rad_s)?;
        for (joint, record) in robot.joints.iter_mut().zip(&drive_gains) {
            joint.drive.gain = record.gain_nm_a;
        }
    }
    let robot = &robot;
    let other_size = || format!("robot '{}' has not {N} joints", robot.name);
    let layout = Layout::<N>::new(robot, &config.columns).ok_or_else(other_size)?;
    let (on_board, left_out) = config.columns.on_board();
    let board = Layout::<N>::new(robot, &on_board).ok_or_else(other_size)?;
    let mut notes = Vec::new();
    let gathered = gather(robot, &layout, logs, config, &mut notes, progress)?;
    let problem = Problem {
        robot,
        layout: &layout,
        board: &board,
        methods: &config.methods,
        seed: config.seed,
    };
    let all = Material::all(&gathered);
    let solved = solve_all(&problem, &all, progress)?;
    progress("80/20 split");
    let splits = split(&problem, &gathered)?;
    let bound = wls(&gathered.sums, &layout).ok_or_else(unsolvable)?;
    let truth = config.truth.as_ref().map(|truth| truths(truth, &layout));
    let mut methods: BTreeMap<String, MethodRecord> = BTreeMap::new();
    for (solved, split) in solved.iter().zip(splits) {
        methods.insert(
            solved.name.to_string(),
            solved.record(&layout, truth.as_deref(), split),
        );
    }
    for solved in &solved {
        let intervals = parameter_intervals(&layout, &all, solved, config.seed);
        if let (Some(intervals), Some(method)) =
            (intervals, methods.get_mut(&solved.name.to_string()))
        {
            for (parameter, interval) in method.parameters.iter_mut().zip(intervals) {
                parameter.ci95 = Some(interval);
            }
        }
    }
    if let Some(trained) = methods.get_mut("bp_physical") {
        trained.base_parameter_error_ratio_by_epoch =
            error_curve(&all, &layout, &bound, truth.as_deref(), config.seed);
    }
    let candidates: Vec<&Candidate<N>> = solved.iter().map(|solved| &solved.candidate).collect();
    let mut trace = Vec::new();
    for path in validate {
        progress(&format!("validating {}", path.display()));
        let mut scores = FileScores::new(&layout, candidates.len());
        for_each_prepared(
            path,
            robot,
            &layout,
            &config.prepare,
            &mut notes,
            &mut |preparation, prepared| {
                scores.add(&layout, preparation, &prepared, &candidates);
            },
        )?;
        let key = key_of(path, validate);
        let limit = scores.propagated(&layout, &bound.covariance);
        for (place, solved) in solved.iter().enumerate() {
            let mut record = scores.record(place);
            scores.intervals(place, config.seed, &mut record);
            record.cramer_rao_nrmse_moving_ratio = Some(limit);
            if let (Some(truth), Candidate::Linear(theta)) = (&truth, &solved.candidate)
                && truth.iter().all(Option::is_some)
            {
                let truth = DVector::from_iterator(
                    truth.len(),
                    truth.iter().map(|value| value.unwrap_or(0.0)),
                );
                record.truth_nrmse_moving_ratio =
                    Some(scores.propagated_error(&layout, &(theta - truth)));
            }
            if let Some(method) = methods.get_mut(&solved.name.to_string()) {
                method.validation.insert(key.clone(), record);
            }
        }
        if trace.is_empty() {
            progress("growing shares of the logs");
            for (name, curve) in learning_curves(&problem, &gathered, &scores.sample) {
                if let Some(method) = methods.get_mut(&name.to_string()) {
                    method.learning_curve = curve;
                }
            }
            trace = scores.trace;
        }
    }
    let recommended = recommended(&solved, &methods);
    let bank_fit = for_bank(
        &problem,
        &gathered,
        &solved[recommended],
        left_out.is_empty(),
    )?;
    if !left_out.is_empty() {
        notes.push(format!(
            "the board has no column {}: the bank holds a fit without",
            left_out.join(", ")
        ));
    }
    let (condition_number, condition_number_equilibrated) =
        gathered.sums.condition_numbers(&layout);
    let report = Report {
        robot: robot.name.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: config.seed,
        columns: config.columns.to_string(),
        drive_gains,
        logs: logs.iter().map(|path| key_of(path, logs)).collect(),
        notes,
        fold_period_s: config.fold_period_s,
        motion_cutoff_hz: config.prepare.motion_hz,
        torque_cutoff_hz: config.prepare.torque_hz,
        still_rad_s: config.prepare.still_rad_s,
        rows_read: gathered.rows_read,
        rows_used: gathered.rows,
        still_share_ratio: gathered
            .still
            .iter()
            .map(|&still| still as f64 / gathered.rows_read.max(1) as f64)
            .collect(),
        spikes: gathered.spikes,
        rank: layout.parameters.len(),
        condition_number,
        condition_number_of: "raw SI regressor of the base parameters, moving rows, Craig link frames, first independent columns from left to right".to_owned(),
        condition_number_equilibrated,
        recommended: solved[recommended].name.to_string(),
        methods,
    };
    Ok(Outcome {
        report,
        bank_layout: board.clone(),
        bank_fit,
        networks: match &solved[recommended].candidate {
            Candidate::Residual { networks, .. } => Some(networks.clone()),
            _ => None,
        },
        ripple: match &solved[recommended].candidate {
            Candidate::Residual { ripple, .. } => Some(*ripple),
            _ => None,
        },
        robot: solved.iter().find_map(|solved| solved.robot.clone()),
        trace: trace
            .into_iter()
            .map(|(t_s, tau, predicted)| (t_s, tau, predicted[recommended]))
            .collect(),
    })
}

/// Errors: the log's; its rows are too far apart for one of the filters.
fn show_cut_offs<const N: usize>(
    path: &Path,
    robot: &Robot,
    config: &PrepareConfig,
) -> Result<(), Box<dyn Error>> {
    let period_s = WholeLog::<N>::open(path, robot)?.period_s();
    let asked = [
        ("--motion-hz", Some(config.motion_hz)),
        ("--torque-hz", config.torque_hz),
    ];
    for (option, hz) in asked {
        if let Some(asked_hz) = hz.filter(|hz| Butterworth::new(*hz, period_s).is_none()) {
            return Err(Box::new(IdentificationError::CutOff {
                log: path.display().to_string(),
                option,
                asked_hz,
                rate_hz: 1.0 / period_s,
            }));
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
) -> Result<Gathered<N>, Box<dyn Error>> {
    let mut gathered = Gathered::new(layout);
    for path in logs {
        progress(&format!("reading {}", path.display()));
        if let Some(period_s) = config.fold_period_s {
            let (preparation, prepared) =
                folded(path, robot, layout, &config.prepare, period_s, notes)?;
            gathered.add(layout, &preparation, &prepared);
            continue;
        }
        for_each_prepared(
            path,
            robot,
            layout,
            &config.prepare,
            notes,
            &mut |preparation, prepared| {
                gathered.add(layout, preparation, &prepared);
            },
        )?;
    }
    if gathered.sums.count() == 0.0 {
        let names: Vec<String> = logs.iter().map(|path| path.display().to_string()).collect();
        return Err(Box::new(IdentificationError::NoMotion {
            logs: names.join(", "),
        }));
    }
    gathered.sums.check_rank(layout)?;
    if gathered.thinning > 1 {
        notes.push(format!(
            "irls, consistent, bp_black_box and bp_residual used every {}th of the rows in the sums; the other methods all of them",
            gathered.thinning
        ));
    }
    Ok(gathered)
}

/// The method with the least error on moving rows it was not trained on, of those the board can run: mean over the
/// validation logs, or without any the rows that the split held out.
fn recommended<const N: usize>(
    solved: &[Solved<N>],
    methods: &BTreeMap<String, MethodRecord>,
) -> usize {
    let error = |solved: &Solved<N>| {
        let record = methods.get(&solved.name.to_string())?;
        let logs = record.validation.len();
        let sum: f64 = record
            .validation
            .values()
            .map(|log| log.joints_nrmse_moving_ratio)
            .sum();
        Some(if logs > 0 {
            sum / logs as f64
        } else {
            let ratios = record.split_80_20.nrmse_moving_ratio.iter().flatten();
            ratios.map(|ratio| ratio * ratio).sum::<f64>()
        })
    };
    let mut best = (0, f64::INFINITY);
    for (place, solved) in solved.iter().enumerate() {
        let on_board = !matches!(solved.candidate, Candidate::BlackBox(_));
        if let Some(error) = error(solved).filter(|error| on_board && *error < best.1) {
            best = (place, error);
        }
    }
    best.0
}

/// The recommended parameters over the columns that the board has.
///
/// * `complete` the board has all columns
fn for_bank<const N: usize>(
    problem: &Problem<'_, N>,
    gathered: &Gathered<N>,
    solved: &Solved<N>,
    complete: bool,
) -> Result<Fit<N>, Box<dyn Error>> {
    if let (true, Some(fit)) = (complete, &solved.fit) {
        return Ok(fit.clone());
    }
    if let (Candidate::Residual { .. }, Some(fit)) = (&solved.candidate, &solved.fit) {
        let places = problem.layout.places_of(problem.board);
        return Ok(Fit {
            theta: fit.theta.select_rows(&places),
            covariance: fit.covariance.select_rows(&places).select_columns(&places),
            ..fit.clone()
        });
    }
    let sums = gathered.clean_sums.subset(problem.layout, problem.board);
    let free = wls(&sums, problem.board).ok_or_else(unsolvable)?;
    Ok(match solved.name {
        MethodName::Consistent => {
            let found = consistent(problem.robot, problem.board, &free);
            found.ok_or_else(unsolvable)?.fit
        }
        MethodName::Evidence => {
            let found = evidence(problem.robot, problem.board, &sums, &free.sigma);
            found.ok_or_else(unsolvable)?
        }
        _ => free,
    })
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
