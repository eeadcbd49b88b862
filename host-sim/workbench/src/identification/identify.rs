//! From logs to a report and the parameters of a bank.

use super::columns::{ColumnSet, Layout};
use super::dataset::Dataset;
use super::judge::{Judgement, after_fit, at_rest, change};
use super::methods::{Fit, MethodName, wls};
use super::prepare::PrepareConfig;
use super::problem::{Candidate, Problem, Progress, TrainingData};
use super::record::{RIVALS, Report};
use super::solve::solve_all;
use super::stream::{folded, for_each_prepared};
use super::study::{Study, key_of, recommended, truths};
use super::{IdentifyError, joined, numbers};
use crate::Refusal;
use crate::dynamics::PerJoint;
use crate::robot::Robot;
use foretorque::arm::Arm;
use foretorque::dynamics::COGGING_COLUMNS;
use foretorque::learning::ParameterSet;
use foretorque_link::bank::{NETWORK_SEED, ParameterBank};
use std::fs::File;
use std::io::{BufReader, Read};
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
    /// Seed of random starts, of the split and of resampling.
    pub seed: u64,
    /// The robot whose parameters are the truth, if it is known.
    pub truth: Option<Robot>,
    /// Further unseen logs, by which nothing is chosen.
    pub test: Vec<PathBuf>,
}

impl IdentifyConfig {
    /// Methods on filtered logs, and nothing else.
    pub fn new(
        methods: Vec<MethodName>,
        columns: ColumnSet,
        prepare: PrepareConfig,
        seed: u64,
    ) -> Self {
        Self {
            methods,
            columns,
            prepare,
            fold_period_s: None,
            seed,
            truth: None,
            test: Vec::new(),
        }
    }
}

/// Result of an identification.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// All figures.
    pub report: Report,
    /// Columns that the board has.
    pub bank_layout: Layout,
    /// The recommended fit over them.
    pub bank_fit: Fit,
    /// The recommended model.
    pub candidate: Candidate,
    /// The description with the consistent parameters, if they were asked for.
    pub robot: Option<Robot>,
    /// Time, measured and predicted torque on the first validation log: of the recommended method.
    pub trace: Vec<(f64, PerJoint<f64>, PerJoint<f64>)>,
}

/// Parameters of a robot by all methods, validated on unseen logs.
///
/// Errors: [`IdentifyError`].
pub fn identify(
    robot: &Robot,
    logs: &[PathBuf],
    validate: &[PathBuf],
    config: &IdentifyConfig,
    progress: Progress<'_>,
) -> Result<Outcome, IdentifyError> {
    for path in logs {
        config.prepare.check(path, robot)?;
    }
    let (on_board, left_out) = config.columns.on_board();
    let [layout, board] = [&config.columns, &on_board].map(|columns| Layout::new(robot, columns));
    let mut notes = Vec::new();
    let dataset = gather(robot, &layout, logs, config, &mut notes, progress)?;
    let data = TrainingData::all(&dataset);
    let problem = Problem {
        robot,
        layout: &layout,
        board: &board,
        methods: &config.methods,
        networks: true,
        seed: config.seed,
    };
    let unseen_logs = [validate, &config.test].concat();
    let mut study = Study {
        problem,
        dataset: &dataset,
        bound: wls(&data.sums.all, &layout)?,
        results: solve_all(&problem, &data, progress)?,
        truth: config.truth.as_ref().map(|truth| truths(truth, &layout)),
        unseen_logs: &unseen_logs,
        unseen: Vec::new(),
        progress,
    };
    let prepare = &config.prepare;
    let (trace, mut validation) = study.validate((validate, true), prepare, &mut notes)?;
    let mut methods = study.methods(&data)?;
    let (_, mut test) = study.validate((&config.test, false), prepare, &mut notes)?;
    for (name, method) in &mut methods {
        method.validation = validation.remove(name).unwrap_or_default();
        method.test = test.remove(name).unwrap_or_default();
    }
    let recommended = recommended(&study.results, &methods);
    let best = &study.results[recommended];
    let bank_fit = study.bank_fit(best, left_out.is_empty())?;
    if !left_out.is_empty() {
        let columns = left_out.join(", ");
        notes.push(format!(
            "the board has no column {columns}: the bank holds a fit without"
        ));
    }
    let consistent = study.results.iter().find_map(|result| result.robot.clone());
    let undescribed = layout.undescribed();
    if !undescribed.is_empty() && consistent.is_some() {
        let columns = undescribed.join(", ");
        notes.push(format!(
            "robot.toml and robot.urdf have no place for all of the friction columns {columns}: torques of that description lack it"
        ));
    }
    if let Some(hz) = prepare.torque_hz.filter(|hz| *hz > prepare.motion_hz) {
        let motion_hz = prepare.motion_hz;
        notes.push(format!(
            "torque and regressor are filtered at {hz} Hz and the motion at {motion_hz} Hz: above --motion-hz the two sides of the equation differ, give a lower --torque-hz"
        ));
    }
    let mut judgement = Judgement::default();
    let pairs = [
        ("training", logs, &*unseen_logs),
        ("validation", validate, &config.test),
    ];
    for (kind, used, unseen) in pairs {
        for path in unseen {
            if let Some(same) = used.iter().find(|log| same_content(log, path)) {
                let (path, same) = (path.display(), same.display());
                judgement.find(false, format!("{path} holds what the {kind} log {same} holds: its errors are not those of unseen motion"));
            }
        }
    }
    let fit = study.results.iter().find_map(|result| result.fit.as_ref());
    let rows = &dataset.sample.kept;
    let is_tilted = fit.is_some_and(|fit| after_fit(&mut judgement, robot, &layout, fit, rows));
    // The error of a model without the tilt changes with the pose, as that of one without a body in the hand does.
    if !is_tilted {
        if let Some((place, text)) = change(robot, &layout, rows, &best.candidate) {
            let log = logs[dataset.log_of(place)].display();
            judgement.find(false, format!("{log}: {text}"));
        }
        for (log, rows) in &study.unseen {
            if let Some((_, text)) = change(robot, &layout, rows, &best.candidate) {
                judgement.find(false, format!("{log}: {text}"));
            }
        }
    }
    let first = validate.first().map(|path| key_of(path, &unseen_logs));
    let errors = |name: &str| {
        let method = &methods[name];
        let unseen = first.as_ref().and_then(|log| method.validation.get(log));
        let held_out = &method.split_80_20.rmse_moving_nm;
        unseen
            .map_or(held_out, |record| &record.rmse_moving_nm)
            .clone()
    };
    let headline_rmse_nm = errors(&best.name.to_string());
    let [headline_description_rmse_nm, size] = RIVALS.map(errors);
    let pairs = headline_rmse_nm.iter().zip(&headline_description_rmse_nm);
    let worse = |(own, described): (f64, f64)| own > 1.05 * described;
    let lost = pairs.enumerate();
    let lost = lost.filter(|(_, (own, described))| own.zip(**described).is_some_and(worse));
    let lost = numbers(lost.map(|(joint, _)| joint));
    if !lost.is_empty() {
        judgement.find(false, format!(
            "joint {lost}: the identified parameters predict worse than the description: do the logs show enough of its motion, and are their scales right?"
        ));
    }
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
        headline_torque_rms_nm: size,
        findings: judgement.findings,
        logs: logs.iter().map(|path| key_of(path, logs)).collect(),
        notes,
        recommended: best.name.to_string(),
        methods,
        ..figures(config, &dataset, &layout)
    };
    let trace = trace.into_iter();
    Ok(Outcome {
        report,
        bank_fit,
        candidate: best.candidate.clone(),
        robot: consistent,
        trace: trace
            .map(|(t_s, tau, predicted)| (t_s, tau, predicted[recommended]))
            .collect(),
        bank_layout: board.clone(),
    })
}

/// Figures of settings and dataset.
fn figures(config: &IdentifyConfig, dataset: &Dataset, layout: &Layout) -> Report {
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
        still_share_ratio: dataset.still.iter().copied().map(share).collect(),
        spikes: dataset.spikes,
        rank: layout.parameters.len(),
        condition_number,
        condition_number_of: "raw SI regressor of the base parameters, moving rows, Craig link frames, first independent columns from left to right".to_owned(),
        condition_number_equilibrated: equilibrated,
        ..Report::default()
    }
}

/// Dataset of the training logs, in one pass.
fn gather(
    robot: &Robot,
    layout: &Layout,
    logs: &[PathBuf],
    config: &IdentifyConfig,
    notes: &mut Vec<String>,
    progress: Progress<'_>,
) -> Result<Dataset, IdentifyError> {
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
        dataset.end_log();
    }
    if dataset.sums.all.count() == 0.0 {
        return Err(Refusal::of(joined(logs), at_rest(prepare)).into());
    }
    dataset.sums.all.check_rank(layout)?;
    if dataset.sample.stride > 1 {
        notes.push(format!(
            "irls, consistent, bp_black_box and bp_residual used one of {} rows in the sums; the other methods all of them",
            dataset.sample.stride
        ));
    }
    Ok(dataset)
}

/// Share of the RMS torque that every error has added, so that none is decided by noise or by rounding.
const LEAST_SHARE: f64 = 0.03;

/// Geometric mean over the joints of one error over another; `size` is the RMS torque.
fn over(own: &[Option<f64>], other: &[Option<f64>], size: &[Option<f64>]) -> f64 {
    let joints = own.iter().zip(other).zip(size);
    let ratios = joints.filter_map(|((own, other), size)| {
        let least = LEAST_SHARE * size.filter(|size| *size > 0.0)?;
        Some((*own)?.hypot(least) / (*other)?.hypot(least))
    });
    let logs: Vec<f64> = ratios.filter(|ratio| *ratio > 0.0).map(f64::ln).collect();
    (logs.iter().sum::<f64>() / logs.len().max(1) as f64).exp()
}

/// Two files with the same bytes.
pub fn same_content(one: &Path, other: &Path) -> bool {
    let open = |path: &Path| {
        let kind = std::fs::metadata(path).ok().filter(|kind| kind.is_file())?;
        Some((kind.len(), BufReader::new(File::open(path).ok()?)))
    };
    let (Some((size, one)), Some((other_size, other))) = (open(one), open(other)) else {
        return false;
    };
    let mut pairs = one.bytes().zip(other.bytes());
    size == other_size && pairs.all(|pair| matches!(pair, (Ok(a), Ok(b)) if a == b))
}

/// The bank of the recommended parameters; `None` when their layout is not that of `A`.
///
/// Columns without a fit are zero and keep the deviation of an unidentified bank. Direct connections of networks from the
/// cogging phase go to the board's cogging columns.
pub fn bank_of_fit<A: Arm<N, P>, const N: usize, const P: usize>(
    robot: &Robot,
    outcome: &Outcome,
) -> Option<ParameterBank> {
    let (layout, fit) = (&outcome.bank_layout, &outcome.bank_fit);
    if layout.base != A::index().count {
        return None;
    }
    let mut set = ParameterSet::<N, P>::nominal::<A>(NETWORK_SEED);
    let mut connections: &[[f64; 2]] = &[];
    if let Candidate::Residual {
        networks, cogging, ..
    } = &outcome.candidate
    {
        set.network = networks.as_slice().try_into().ok()?;
        connections = cogging;
    }
    let mut bank = ParameterBank::from_set::<A, N, P>(&set);
    let deviations = fit.deviations();
    let names: Vec<String> = bank.columns.iter().map(|own| own.id.to_string()).collect();
    let place_of = |name: &String| names.iter().position(|own| own == name);
    for (place, parameter) in layout.parameters.iter().enumerate() {
        let column = &mut bank.columns[place_of(&parameter.name)?];
        column.value = fit.theta[place] as f32;
        column.deviation = deviations[place] as f32;
    }
    for (joint, amplitudes) in connections.iter().enumerate() {
        for (column, amplitude) in COGGING_COLUMNS.into_iter().zip(amplitudes) {
            let name = format!("{}{}", column.properties().symbol, joint + 1);
            // An arm without cogging has no such column and no amplitude either.
            match place_of(&name) {
                Some(place) => bank.columns[place].value += *amplitude as f32,
                None if *amplitude == 0.0 => (),
                None => return None,
            }
        }
    }
    for (gain, joint) in bank.drive_gains_nm_a.iter_mut().zip(&robot.joints) {
        // 0: not known.
        *gain = joint.drive.gain.unwrap_or_default() as f32;
    }
    Some(bank)
}
