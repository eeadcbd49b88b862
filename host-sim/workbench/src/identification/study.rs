//! All methods side by side on the same logs, and their errors against known true parameters.

use super::IdentifyError;
use super::columns::FrictionTerm::Board;
use super::columns::{Layout, Parameter};
use super::consistent::consistent;
use super::dataset::Dataset;
use super::judge::description;
use super::methods::{Fit, MethodName, evidence, wls};
use super::normal::SampleRow;
use super::prepare::PrepareConfig;
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData};
use super::record::{MethodRecord, RIVALS, ValidationRecord, base_error, sum_of_errors};
use super::stream::for_each_prepared;
use super::uncertainty::{parameter_intervals, with_block_deviations};
use super::validation::{FileScores, TraceRow, learning_curve, split};
use crate::robot::Robot;
use crate::training::{Descent, LinearLayer, PhysicalConfig};
use foretorque::dynamics::FrictionColumn;
use nalgebra::DVector;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(super) type Methods = BTreeMap<String, MethodRecord>;
/// Errors by method and log.
type Errors = BTreeMap<String, BTreeMap<String, ValidationRecord>>;

/// All methods on one dataset.
pub(super) struct Study<'a> {
    pub(super) problem: Problem<'a>,
    pub(super) dataset: &'a Dataset,
    /// Weighted least squares, whose covariance is the Cramér–Rao bound.
    pub(super) bound: Fit,
    pub(super) results: Vec<MethodResult>,
    pub(super) truth: Option<Vec<Option<f64>>>,
    /// Logs that are not trained on.
    pub(super) unseen_logs: &'a [PathBuf],
    /// Rows of the logs that were not trained on, by the names of these.
    pub(super) unseen: Vec<(String, Vec<SampleRow>)>,
    pub(super) progress: Progress<'a>,
}

impl Study<'_> {
    /// Records of all methods and rivals, without unseen logs.
    pub(super) fn methods(&self, data: &TrainingData<'_>) -> Result<Methods, IdentifyError> {
        let mut methods = Methods::new();
        (self.progress)("80/20 split");
        let Problem { layout, seed, .. } = self.problem;
        let truth = self.truth.as_deref();
        let sample = &self.dataset.sample.kept;
        let mut splits = split(&self.problem, &self.results, &self.rivals(), sample)?;
        let of_rivals = splits.split_off(self.results.len());
        let described = description(self.problem.robot, layout);
        for (result, split) in self.results.iter().zip(splits) {
            let intervals = parameter_intervals(layout, data, result, seed);
            let intervals = intervals.as_deref();
            let mut record = result.record.clone();
            if let Some(fit) = &result.fit {
                record.add_parameters(fit, layout, truth, &described, intervals);
            }
            record.split_80_20 = split;
            if let Some([_, of_plain]) = &mut record.epochs_to_1_05_wls {
                let layer = data.layer(layout, &self.bound);
                (self.progress)("plain descent");
                let plain = PhysicalConfig::new(Descent::Plain, seed);
                let plain = layer.train(&plain, &mut |_, _| ());
                *of_plain = plain.epochs_to(1.05, layer.loss_of(&self.bound.theta));
                record.base_parameter_error_ratio_by_epoch =
                    error_curve(&layer, layout, truth, seed);
            }
            if let Some((_, unseen)) = self.unseen.first() {
                (self.progress)(&format!("growing shares of the logs  {}", result.name));
                record.learning_curve = learning_curve(result.name, &self.problem, sample, unseen);
            }
            methods.insert(result.name.to_string(), record);
        }
        for (name, split_80_20) in RIVALS.iter().zip(of_rivals) {
            let record = MethodRecord {
                split_80_20,
                ..MethodRecord::default()
            };
            methods.insert((*name).to_owned(), record);
        }
        Ok(methods)
    }

    /// The description's own parameters, and zero torque.
    fn rivals(&self) -> [Candidate; 2] {
        let Problem { robot, layout, .. } = self.problem;
        let theta = description(robot, layout);
        let zero = DVector::zeros(theta.len());
        [theta, zero].map(Candidate::Linear)
    }

    /// Errors on unseen logs, and the torques on the first of them.
    ///
    /// * `chooses` these logs choose: the linear part of networks competes with them, and takes their place where it is better
    pub(super) fn validate(
        &mut self,
        (logs, chooses): (&[PathBuf], bool),
        prepare: &PrepareConfig,
        notes: &mut Vec<String>,
    ) -> Result<(Vec<TraceRow>, Errors), IdentifyError> {
        let Problem { robot, layout, .. } = self.problem;
        let mut results = self.results.iter().enumerate();
        let linear = results.find_map(|(place, own)| Some((place, own.linear.clone()?)));
        let linear = linear.filter(|_| chooses);
        let linear = linear.map(|(place, fit)| (place, Candidate::Linear(fit.theta.clone()), fit));
        let rivals = self.rivals();
        let candidates = self.results.iter().map(|result| &result.candidate);
        let of_linear = linear.iter().map(|(_, candidate, _)| candidate);
        let candidates: Vec<&Candidate> = candidates.chain(&rivals).chain(of_linear).collect();
        let names = self.results.iter().map(|result| result.name.to_string());
        let names: Vec<String> = names.chain(RIVALS.map(str::to_owned)).collect();
        let (mut trace, mut unseen) = (Vec::new(), Vec::new());
        let (mut errors, mut of_linear) = (Errors::new(), BTreeMap::new());
        for path in logs {
            (self.progress)(&format!("validating {}", path.display()));
            let mut scores = FileScores::new(layout, candidates.len());
            let prepare = &prepare.lowered(path, robot, notes)?;
            for_each_prepared(path, robot, layout, prepare, notes, &mut |own, prepared| {
                scores.add(layout, own, &prepared, &candidates);
            })?;
            let limit = scores.propagated(layout, &self.bound.covariance);
            let key = key_of(path, self.unseen_logs);
            for (place, candidate) in candidates.iter().enumerate() {
                let mut record = scores.record(place, self.problem.seed);
                let name = names.get(place);
                if name.is_none_or(|name| !RIVALS.contains(&&**name)) {
                    let error = self.error(candidate);
                    let error = error.map(|error| &error * error.transpose());
                    record.cramer_rao_nrmse_moving_ratio = Some(limit);
                    record.truth_nrmse_moving_ratio =
                        error.map(|error| scores.propagated(layout, &error));
                }
                let records = match name {
                    Some(name) => errors.entry(name.clone()).or_default(),
                    None => &mut of_linear,
                };
                records.insert(key.clone(), record);
            }
            if trace.is_empty() {
                trace = scores.trace.kept;
            }
            unseen.push((path.display().to_string(), scores.sample.kept));
        }
        self.unseen.extend(unseen);
        if let Some((place, candidate, fit)) = linear {
            let (result, name) = (&mut self.results[place], &names[place]);
            let own = errors.entry(name.clone()).or_default();
            let [networks, linear] = [&*own, &of_linear].map(sum_of_errors);
            // A figure that is not a number is worse than any.
            let is_better = linear.is_some_and(|linear| !networks.is_some_and(|own| own <= linear));
            if is_better {
                notes.push(format!(
                    "{name}: on the validation logs its networks are worse than the linear part, which stands in for them"
                ));
                *own = of_linear;
                (result.candidate, result.fit) = (candidate, Some(fit));
                self.problem.networks = false;
                for (_, _, predicted) in &mut trace {
                    predicted.swap_remove(place);
                }
            }
        }
        Ok((trace, errors))
    }

    /// Parameter error of a linear model; `None` when a true parameter is unknown.
    fn error(&self, candidate: &Candidate) -> Option<DVector<f64>> {
        let Candidate::Linear(theta) = candidate else {
            return None;
        };
        let truth = self.truth.as_ref()?.iter().copied();
        Some(theta - DVector::from_vec(truth.collect::<Option<Vec<f64>>>()?))
    }

    /// The recommended parameters over the columns that the board has.
    ///
    /// * `complete` the board has all columns
    pub(super) fn bank_fit(
        &self,
        result: &MethodResult,
        complete: bool,
    ) -> Result<Fit, IdentifyError> {
        let Problem {
            robot,
            layout,
            board,
            ..
        } = self.problem;
        let sums = self.dataset.sums.clean.subset(layout, board);
        let honest = |fit: Fit| {
            with_block_deviations(fit, (&sums, board), (&self.dataset.sample.kept, layout))
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
        let free = wls(&sums, board)?;
        let fit = match result.name {
            MethodName::Consistent => {
                let found = consistent(robot, board, &free);
                found.ok_or(IdentifyError::Unsolvable)?.0
            }
            MethodName::Evidence => evidence(robot, board, &sums, &free.sigma)?,
            _ => free,
        };
        Ok(honest(fit))
    }
}

/// Place of the method for the bank, of those the board can run: the one with the least mean error on the validation logs.
///
/// Without such logs, or motion in them, the stretches of the training logs that were held out decide. Differences within the
/// standard error of the least mean error do not count: of these methods the most constrained one is taken, the physically
/// consistent parameters first [Hastie, Tibshirani, Friedman 2009, §7.10].
pub(super) fn recommended(results: &[MethodResult], methods: &Methods) -> usize {
    let record = |place: usize| &methods[&results[place].name.to_string()];
    let on_board = |place: &usize| !matches!(results[*place].candidate, Candidate::BlackBox(_));
    let places = || (0..results.len()).filter(on_board);
    let least = |error: &dyn Fn(usize) -> f64| {
        places()
            .min_by(|&a, &b| error(a).total_cmp(&error(b)))
            .unwrap_or(0)
    };
    let unseen = |place: usize| sum_of_errors(&record(place).validation);
    if places().any(|place| unseen(place).is_some()) {
        return least(&|place| unseen(place).unwrap_or(f64::INFINITY));
    }
    let mean = |place: usize| record(place).split_80_20.mean().0;
    let best = least(&mean);
    let bound = mean(best) + record(best).split_80_20.mean().1;
    let constrained = [MethodName::Consistent, MethodName::Evidence];
    let mut constrained = constrained
        .iter()
        .filter_map(|name| places().find(|&place| results[place].name == *name));
    // Fewer than two stretches give no standard error; then the most constrained method is taken.
    constrained
        .find(|&place| bound.is_nan() || mean(place) <= bound)
        .unwrap_or(best)
}

/// The file's name, or its path where two files share a name.
pub(super) fn key_of(path: &Path, all: &[PathBuf]) -> String {
    let name = path.file_name();
    let others = all.iter().filter(|other| other.file_name() == name);
    let name = name.filter(|_| others.count() <= 1);
    name.map_or_else(
        || path.display().to_string(),
        |name| name.to_string_lossy().into_owned(),
    )
}

/// True parameters of the layout; `None` for a column that takes up friction of another kind.
pub(super) fn truths(robot: &Robot, layout: &Layout) -> Vec<Option<f64>> {
    use FrictionColumn::{CoggingSine, Coulomb, ShearThinning, Stribeck, Viscous};
    let truth = |parameter: &Parameter| {
        let (term, joint) = parameter.friction?;
        let friction = &robot.joints[joint].friction;
        let has_peak = friction.stribeck_ratio != 0.0;
        match term {
            Board(CoggingSine) => Some(friction.cogging),
            Board(Viscous | Coulomb | Stribeck | ShearThinning) if has_peak => None,
            _ => parameter.plain_friction(robot).or(Some(0.0)),
        }
    };
    let base = robot.base_parameters().into_iter().map(Some);
    let friction = layout.parameters.iter().skip(layout.base);
    base.chain(friction.map(truth)).collect()
}

/// Error of the base parameters by epoch of the accelerated layer; empty without a truth.
fn error_curve(
    layer: &LinearLayer,
    layout: &Layout,
    truth: Option<&[Option<f64>]>,
    seed: u64,
) -> Vec<(usize, f64)> {
    let Some(truth) = truth else {
        return Vec::new();
    };
    let mut curve = Vec::new();
    for max_epochs in [1, 2, 5, 10, 20, 30, 50, 75, 100, 150, 200, 300, 500, 1000] {
        let config = PhysicalConfig {
            max_epochs,
            starts: 1,
            ..PhysicalConfig::new(Descent::Accelerated, seed)
        };
        let trained = layer.train(&config, &mut |_, _| ());
        if let Some(error) = base_error(&trained.theta, truth, layout.base) {
            curve.push((max_epochs, error));
        }
    }
    curve
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::{Motion, PerJoint, RigidBodies};
    use crate::identification::ColumnSet;
    use crate::identification::dataset::{RowSums, random_rows};
    use crate::identification::log_tests::log_of;
    use crate::identification::record::SplitRecord;
    use crate::table::{joint_columns, state_columns};
    use tempfile::TempDir;

    /// A log of the torques of `model`, 200 rows a second.
    fn log_of_model(model: &RigidBodies) -> (TempDir, PathBuf) {
        let rows = (0..1500).map(|k| {
            let t_s = 0.005 * f64::from(k);
            let rates = PerJoint::from_fn(6, |joint| 1.5 + 0.3 * joint as f64);
            let [q, qd, qdd] = [0, 1, 2].map(|order| {
                let phase = f64::from(order) * std::f64::consts::FRAC_PI_2;
                rates.map(|rate| rate.powi(order) * (rate * t_s + rate + phase).sin())
            });
            let tau = model.inverse_dynamics(&Motion { q, qd, qdd });
            [&[t_s][..], &q, &qd, &qdd, &tau].concat()
        });
        let header = [
            vec!["t_s".to_owned()],
            state_columns(6),
            joint_columns("tau", "nm", 6),
        ];
        log_of(&header.concat().join(","), rows)
    }

    #[test]
    fn the_record_of_networks_that_lose_is_that_of_their_linear_part() {
        let robot = Robot::load("ur5").expect("built in");
        let layout = Layout::new(&robot, &ColumnSet::plain());
        let model = RigidBodies::new(&robot);
        let torque = |row: &SampleRow, j: usize| model.inverse_dynamics(&row.state)[j];
        let mut dataset = Dataset::new(&layout);
        let rows = random_rows(&layout, 1500, 1, [2.0, 1.0, 3.0], 1e-3, torque);
        dataset.sums = RowSums::of(&layout, &rows);
        dataset.sample.kept = rows;
        let data = TrainingData::all(&dataset);
        let fit = wls(&data.sums.all, &layout).expect("well shown");
        // In the place of networks: twice the torque.
        let wrong = Fit {
            theta: 2.0 * &fit.theta,
            sigma: fit.sigma.map(|sigma| 9.0 * sigma),
            ..fit.clone()
        };
        let name = MethodName::BpResidual;
        let candidate = Candidate::Linear(wrong.theta.clone());
        let result = MethodResult {
            fit: Some(wrong),
            linear: Some(fit.clone()),
            ..MethodResult::plain(name, candidate, (1500, 0))
        };
        let mut truth = robot.base_parameters();
        truth.resize(layout.parameters.len(), 0.0);
        let (_here, log) = log_of_model(&model);
        let logs = [log];
        let mut study = Study {
            problem: Problem {
                robot: &robot,
                layout: &layout,
                board: &layout,
                methods: &[name],
                networks: true,
                seed: 1,
            },
            dataset: &dataset,
            bound: fit.clone(),
            results: vec![result],
            truth: Some(truth.into_iter().map(Some).collect()),
            unseen_logs: &logs,
            unseen: Vec::new(),
            progress: &|_| (),
        };
        let prepare = PrepareConfig {
            motion_hz: 40.0,
            torque_hz: Some(20.0),
            still_rad_s: PrepareConfig::STILL_RAD_S,
        };
        let mut notes = Vec::new();
        let validated = study.validate((&logs, true), &prepare, &mut notes);
        let (trace, errors) = validated.expect("a log");
        let methods = study.methods(&data).expect("solved");
        let (_, tau, predicted) = &trace[trace.len() / 2];
        assert!((predicted[0][1] - tau[1]).abs() < 0.1);
        assert!(notes.concat().contains("stands in for them"), "{notes:?}");
        let record = &methods["bp_residual"];
        assert_eq!(record.noise_nm, fit.sigma.to_vec());
        let values = record.parameters.iter().map(|parameter| parameter.value);
        assert_eq!(values.collect::<Vec<_>>(), fit.theta.as_slice());
        let unseen = &errors["bp_residual"]["log.csv"];
        let split = record.split_80_20.mean().0;
        for error in [unseen.joints_nrmse_moving_ratio, Some(split)] {
            assert!(error.expect("known") < 0.02, "{error:?}");
        }
        assert!(unseen.truth_nrmse_moving_ratio.is_some());
        assert!(unseen.cramer_rao_nrmse_moving_ratio.is_some());
        assert!(!record.learning_curve.is_empty());
        assert!(methods["zero"].split_80_20.mean().0 > 0.9);
    }

    /// Method for the bank by the errors on held-out stretches, and on an unseen log.
    fn chosen(errors: &[(MethodName, [f64; 5], Option<f64>)]) -> MethodName {
        let mut methods = Methods::new();
        let results = errors.iter().map(|&(name, stretches, unseen)| {
            let mut record = MethodRecord {
                split_80_20: SplitRecord {
                    stretches_nrmse_moving_ratio: stretches.to_vec(),
                    ..SplitRecord::default()
                },
                ..MethodRecord::default()
            };
            let unseen = unseen.map(|error| ValidationRecord {
                joints_nrmse_moving_ratio: Some(error).filter(|error| *error > 0.0),
                ..ValidationRecord::default()
            });
            let logs = unseen.map(|unseen| ("log".to_owned(), unseen));
            record.validation = logs.into_iter().collect();
            methods.insert(name.to_string(), record);
            MethodResult::plain(name, Candidate::Linear(DVector::zeros(1)), (1, 0))
        });
        let results: Vec<_> = results.collect();
        results[recommended(&results, &methods)].name
    }

    #[test]
    fn constrained_parameters_are_taken_unless_they_are_clearly_worse_on_held_out_stretches() {
        use MethodName::{Consistent, Evidence, Ols, Wls};
        // Errors that scatter by more than the methods differ.
        let ols = [0.95, 1.07, 0.77, 0.75, 1.76];
        let consistent = [1.17, 1.38, 1.14, 1.01, 1.45];
        assert_eq!(
            chosen(&[(Ols, ols, None), (Consistent, consistent, None)]),
            Consistent
        );
        // Consistent parameters that are clearly worse.
        let (wls, evidence) = (
            [0.59, 0.32, 0.36, 0.33, 0.44],
            [0.61, 0.33, 0.38, 0.36, 0.43],
        );
        let all = [
            (Wls, wls, None),
            (Consistent, [0.9; 5], None),
            (Evidence, evidence, None),
        ];
        assert_eq!(chosen(&all), Evidence);
        // An unseen log decides alone.
        let unseen = [
            (Wls, wls, Some(0.2)),
            (Consistent, wls, Some(0.3)),
            (Evidence, wls, Some(0.4)),
        ];
        assert_eq!(chosen(&unseen), Wls);
        // One at rest has no error, and decides nothing.
        let at_rest = all.map(|(name, stretches, _)| (name, stretches, Some(0.0)));
        assert_eq!(chosen(&at_rest), Evidence);
    }
}
