//! All methods side by side on the same logs, and their errors against known true parameters.

use super::IdentifyError;
use super::columns::{FrictionTerm, Layout};
use super::consistent::consistent;
use super::dataset::{Dataset, SampleRow};
use super::judge::description;
use super::methods::{Fit, MethodName, evidence, wls};
use super::prepare::PrepareConfig;
use super::problem::{Candidate, MethodResult, Problem, Progress, TrainingData};
use super::record::{MethodRecord, RIVALS, Unseen, ValidationRecord, base_error};
use super::stream::for_each_prepared;
use super::uncertainty::{parameter_intervals, with_block_deviations};
use super::validation::{FileScores, Trace, learning_curves, split};
use crate::robot::Robot;
use crate::training::{Descent, PhysicalConfig};
use foretorque::dynamics::FrictionColumn;
use nalgebra::DVector;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the linear part of networks, while it competes with them.
const LINEAR_PART: &str = "linear part";

pub(super) type Methods = BTreeMap<String, MethodRecord>;

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
    /// Records of all methods, without validation logs.
    pub(super) fn records(&self, data: &TrainingData<'_>) -> Result<Methods, IdentifyError> {
        (self.progress)("80/20 split");
        let Problem { layout, seed, .. } = self.problem;
        let truth = self.truth.as_deref();
        let mut splits = split(
            &self.problem,
            &self.results,
            &self.rivals(),
            &self.dataset.sample.kept,
        )?;
        let of_rivals = splits.split_off(self.results.len());
        let described = description(self.problem.robot, layout);
        let mut methods = Methods::new();
        for (result, split) in self.results.iter().zip(splits) {
            let intervals = parameter_intervals(layout, data, result, seed);
            let intervals = intervals.as_deref();
            let mut record = MethodRecord::of(result, layout, truth, &described, intervals);
            record.split_80_20 = split;
            if result.name == MethodName::BpPhysical {
                record.base_parameter_error_ratio_by_epoch =
                    error_curve(data, layout, &self.bound, truth, seed);
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

    /// Adds the errors on unseen logs to `methods`; returns the torques on the first of them.
    pub(super) fn validate(
        &mut self,
        (logs, kind): (&[PathBuf], Unseen),
        prepare: &PrepareConfig,
        methods: &mut Methods,
        notes: &mut Vec<String>,
    ) -> Result<Trace, IdentifyError> {
        let Problem { robot, layout, .. } = self.problem;
        // The linear part of networks competes with them, and takes their place where it is better on unseen rows.
        let has_linear = |result: &MethodResult| result.linear.is_some();
        let fallback = self.results.iter().position(has_linear);
        let fallback = fallback.filter(|_| kind == Unseen::Validation);
        let linear = fallback.and_then(|place| self.results[place].linear.clone());
        let linear = linear.map(|fit| (Candidate::Linear(fit.theta.clone()), fit));
        let rivals = self.rivals();
        let results = self.results.iter();
        let results = results.map(|result| (result.name.to_string(), &result.candidate));
        let rivals = RIVALS.iter().zip(&rivals);
        let rivals = rivals.map(|(name, rival)| ((*name).to_owned(), rival));
        let last = linear.iter();
        let last = last.map(|(candidate, _)| (LINEAR_PART.to_owned(), candidate));
        let (names, candidates): (Vec<String>, Vec<&Candidate>) =
            results.chain(rivals).chain(last).unzip();
        let mut trace = Vec::new();
        for path in logs {
            (self.progress)(&format!("validating {}", path.display()));
            let mut scores = FileScores::new(layout, candidates.len());
            for_each_prepared(path, robot, layout, prepare, notes, &mut |own, prepared| {
                scores.add(layout, own, &prepared, &candidates);
            })?;
            let limit = scores.propagated(layout, &self.bound.covariance);
            for (place, name) in names.iter().enumerate() {
                let mut record = scores.record(place, self.problem.seed);
                if let Some(result) = self.results.get(place) {
                    let error = self.error(result);
                    let error = error.map(|error| &error * error.transpose());
                    record.cramer_rao_nrmse_moving_ratio = Some(limit);
                    record.truth_nrmse_moving_ratio =
                        error.map(|error| scores.propagated(layout, &error));
                }
                let method = methods.entry(name.clone()).or_default();
                method
                    .unseen(kind)
                    .insert(key_of(path, self.unseen_logs), record);
            }
            if trace.is_empty() && kind == Unseen::Validation {
                (self.progress)("growing shares of the logs");
                let sample = &self.dataset.sample.kept;
                for (name, curve) in learning_curves(&self.problem, sample, &scores.sample) {
                    if let Some(method) = methods.get_mut(&name.to_string()) {
                        method.learning_curve = curve;
                    }
                }
                trace = scores.trace;
            }
            self.unseen
                .push((path.display().to_string(), scores.sample));
        }
        let of_linear = methods.remove(LINEAR_PART).unwrap_or_default().validation;
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
    fn error(&self, result: &MethodResult) -> Option<DVector<f64>> {
        let Candidate::Linear(theta) = &result.candidate else {
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
                found.ok_or(IdentifyError::Unsolvable)?.fit
            }
            MethodName::Evidence => evidence(robot, board, &sums, &free.sigma)?,
            _ => free,
        };
        Ok(honest(fit))
    }
}

/// Place of the method for the bank, of those the board can run: the one with the least mean error on the validation logs.
///
/// Without such logs, the stretches of the training logs that were held out decide. Differences within the standard error
/// of the least mean error do not count: of these methods the most constrained one is taken, the physically consistent
/// parameters first [Hastie, Tibshirani, Friedman 2009, §7.10].
pub(super) fn recommended(results: &[MethodResult], methods: &Methods) -> usize {
    let record = |place: usize| &methods[&results[place].name.to_string()];
    let on_board = |place: &usize| !matches!(results[*place].candidate, Candidate::BlackBox(_));
    let places = || (0..results.len()).filter(on_board);
    let least = |error: &dyn Fn(usize) -> f64| {
        places()
            .min_by(|&a, &b| error(a).total_cmp(&error(b)))
            .unwrap_or(0)
    };
    if places().any(|place| !record(place).validation.is_empty()) {
        return least(&|place| {
            let logs = record(place).validation.values();
            logs.map(|log| log.joints_nrmse_moving_ratio).sum()
        });
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
    let base = robot.base_parameters();
    let mut out: Vec<Option<f64>> = base.into_iter().map(Some).collect();
    for parameter in layout.parameters.iter().skip(layout.base) {
        out.push(parameter.friction.and_then(|(term, joint)| {
            let friction = &robot.joints[joint].friction;
            let simple = friction.stribeck_ratio == 0.0;
            let FrictionTerm::Board(column) = term else {
                return Some(0.0);
            };
            match column {
                FrictionColumn::Viscous => simple.then_some(friction.viscous),
                FrictionColumn::Coulomb => simple.then_some(friction.coulomb),
                FrictionColumn::CoggingSine => Some(friction.cogging),
                FrictionColumn::Stribeck | FrictionColumn::ShearThinning => simple.then_some(0.0),
                _ => Some(0.0),
            }
        }));
    }
    out
}

/// Error of the base parameters by epoch of the accelerated layer; empty without a truth.
fn error_curve(
    data: &TrainingData<'_>,
    layout: &Layout,
    reference: &Fit,
    truth: Option<&[Option<f64>]>,
    seed: u64,
) -> Vec<(usize, f64)> {
    let Some(truth) = truth else {
        return Vec::new();
    };
    let layer = data.layer(layout, reference);
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
    use crate::identification::record::{SplitRecord, ValidationRecord};

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
            let unseen = unseen.map(|joints_nrmse_moving_ratio| ValidationRecord {
                joints_nrmse_moving_ratio,
                ..ValidationRecord::default()
            });
            let logs = unseen.map(|unseen| ("log".to_owned(), unseen));
            record.validation = logs.into_iter().collect();
            methods.insert(name.to_string(), record);
            MethodResult::plain(name, Candidate::Linear(DVector::zeros(1)), 1)
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
    }
}
