//! `report.json` of an identification: units in the keys, `null` where a joint never moves.

use super::columns::Layout;
use super::judge::{Finding, Judgement};
use super::methods::Fit;
use crate::dynamics::PerJoint;
use crate::metrics::{ErrorSums, nrmse};
use nalgebra::DVector;
use serde::Serialize;
use std::collections::BTreeMap;

/// Errors of one method on one unseen log.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ValidationRecord {
    /// RMS error of every joint while it moves, N·m.
    pub rmse_moving_nm: Vec<Option<f64>>,
    /// RMS error of every joint while it stands still, N·m.
    pub rmse_still_nm: Vec<Option<f64>>,
    /// RMS error of every joint over all rows, N·m.
    pub rmse_all_nm: Vec<Option<f64>>,
    /// RMS error over RMS torque, moving rows.
    pub nrmse_moving_ratio: Vec<Option<f64>>,
    /// RMS error over the span of the torque, moving rows.
    pub rmse_over_range_moving_ratio: Vec<Option<f64>>,
    /// RMS torque, moving rows, N·m.
    pub torque_rms_moving_nm: Vec<Option<f64>>,
    /// Root of the mean over the joints of `nrmse_moving_ratio` squared.
    pub joints_nrmse_moving_ratio: Option<f64>,
    /// 95 % interval of `joints_nrmse_moving_ratio`: bootstrap over blocks of one second of this log.
    pub joints_nrmse_moving_ratio_ci95: Option<[f64; 2]>,
    /// 95 % interval of `rmse_moving_nm`.
    pub rmse_moving_nm_ci95: Vec<Option<[f64; 2]>>,
    /// Moving rows of every joint.
    pub rows_moving: Vec<u64>,
    /// Cramér–Rao bound of the part that the noise of the training log causes.
    pub cramer_rao_nrmse_moving_ratio: Option<f64>,
    /// Error against the noise-free torque of the true parameters, where they are known.
    pub truth_nrmse_moving_ratio: Option<f64>,
}

/// One identified parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterRecord {
    /// Name, joints from 1.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Unit.
    pub unit: String,
    /// Standard deviation.
    pub std: f64,
    /// 95 % confidence interval by bootstrap over 40 blocks of the training rows (`ols`, `wls`, `irls`): unlike `std` it
    /// counts errors of the model that last longer than a row.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// Value of the description.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub description: Option<f64>,
    /// True value, where known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<f64>,
}

/// Errors on held-out stretches of the same logs: the paper's split, a fifth at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SplitRecord {
    /// RMS error of every joint on all that was held out, moving rows, N·m.
    pub rmse_moving_nm: Vec<Option<f64>>,
    /// RMS error over RMS torque.
    pub nrmse_moving_ratio: Vec<Option<f64>>,
    /// RMS over the joints of each stretch in which a joint moves.
    pub stretches_nrmse_moving_ratio: Vec<f64>,
}

impl SplitRecord {
    pub(super) fn of(joints: usize, stretches: &[PerJoint<ErrorSums>]) -> Self {
        let all = |joint: usize| {
            let sums = stretches.iter().map(|sums| sums[joint]);
            sums.reduce(|all, own| all.with(&own)).unwrap_or_default()
        };
        Self {
            rmse_moving_nm: (0..joints).map(|joint| all(joint).rmse()).collect(),
            nrmse_moving_ratio: (0..joints).map(|joint| all(joint).nrmse()).collect(),
            stretches_nrmse_moving_ratio: stretches.iter().filter_map(|sums| nrmse(sums)).collect(),
        }
    }

    /// Mean over the stretches, and its standard error.
    pub(super) fn mean(&self) -> (f64, f64) {
        let ratios = &self.stretches_nrmse_moving_ratio;
        let count = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / count;
        let squares = ratios.iter().map(|ratio| (ratio - mean).powi(2));
        (
            mean,
            (squares.sum::<f64>() / (count * (count - 1.0))).sqrt(),
        )
    }
}

/// Error of a method trained on the first part of the training rows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LearningPoint {
    /// Share of the rows, from the start.
    pub share_ratio: f64,
    /// Rows.
    pub rows: usize,
    /// Time of the fit, s.
    pub seconds: f64,
    /// Error on the first validation log.
    pub joints_nrmse_moving_ratio: f64,
}

/// One method.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MethodRecord {
    /// Unseen logs by file name; the method for the bank is chosen by them.
    pub validation: BTreeMap<String, ValidationRecord>,
    /// Further unseen logs, by which nothing is chosen.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub test: BTreeMap<String, ValidationRecord>,
    /// The paper's 80/20 split, stretch by stretch; it is optimistic where the path repeats.
    pub split_80_20: SplitRecord,
    /// Parameters of the linear part.
    pub parameters: Vec<ParameterRecord>,
    /// Norm of the error of the base parameters over their norm, where the truth is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_parameter_error_ratio: Option<f64>,
    /// Noise of every joint's equations, N·m.
    pub noise_nm: Vec<f64>,
    /// Rows it was fitted on.
    pub rows: usize,
    /// Epochs or iterations.
    pub epochs: usize,
    /// Time of the fit, without reading the logs, s.
    pub seconds: f64,
    /// Errors after training on growing shares of at most 4000 rows; shares that do not show every parameter are left out.
    /// `bp_residual` gets filtered rows here, which suit it less than the raw ones of the whole log.
    pub learning_curve: Vec<LearningPoint>,
    /// Loss by epoch, thinned: epoch, RMSE as a ratio of the noise (`bp_physical`), of the spread of the torques
    /// (`bp_black_box`), of the torque limit (`bp_residual`, mean of the joints).
    pub loss_ratio: Vec<(usize, f64)>,
    /// Cost of physical consistency: half the squared Mahalanobis distance from the free fit, nats. Under noise alone it is
    /// about half the number of parameters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_from_free_nats: Option<f64>,
    /// Epochs to 1.05 times the loss of weighted least squares (`bp_physical`), accelerated and plain.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epochs_to_1_05_wls: Option<[Option<usize>; 2]>,
    /// Norm of the error of the base parameters over their norm, by epoch (`bp_physical`, truth known).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub base_parameter_error_ratio_by_epoch: Vec<(usize, f64)>,
}

/// Gain of one drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GainRecord {
    /// Gain that was used, N·m/A.
    pub gain_nm_a: f64,
    /// Its standard deviation; `null` where standstill does not determine the gain and the description's was taken.
    pub std_nm_a: Option<f64>,
    /// Gain of the description, N·m/A; `null` where it gives none.
    pub description_nm_a: Option<f64>,
    /// Poses in which the arm stood still, one after the other.
    pub stands: usize,
}

/// The whole report.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// Robot.
    pub robot: String,
    /// Version of this program.
    pub version: String,
    /// Seed.
    pub seed: u64,
    /// Friction columns.
    pub columns: String,
    /// Drive gains found from standstill, joint by joint; none where those of the description were taken.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub drive_gains: Vec<GainRecord>,
    /// Training logs.
    pub logs: Vec<String>,
    /// Remarks on derived columns, gaps and thinning.
    pub notes: Vec<String>,
    /// Period on which training logs were folded, s.
    pub fold_period_s: Option<f64>,
    /// Cut-off of the filter on the motion, Hz.
    pub motion_cutoff_hz: f64,
    /// Cut-off of the filter on torque and regressor, Hz; `null` for none.
    pub torque_cutoff_hz: Option<f64>,
    /// A joint slower than this stands still, rad/s.
    pub still_rad_s: f64,
    /// Rows read, edges left out.
    pub rows_read: usize,
    /// Rows in the sums, after thinning to the bandwidth of the filter.
    pub rows_used: usize,
    /// Share of the rows in which each joint stands still, left out of its equations.
    pub still_share_ratio: Vec<f64>,
    /// Torque spikes found.
    pub spikes: usize,
    /// Rank of the regressor with all columns.
    pub rank: usize,
    /// Condition number of the raw SI regressor of the base parameters: moving rows, Craig link frames, first
    /// independent columns from left to right. It does not compare with figures for other frames.
    pub condition_number: f64,
    /// Reference of the condition number.
    pub condition_number_of: String,
    /// Condition number of all columns at unit length.
    pub condition_number_equilibrated: f64,
    /// The method whose parameters went into the bank: the one with the least error on the validation logs (mean of
    /// `joints_nrmse_moving_ratio`) of those the board can run. Without such logs, the most constrained one within a standard
    /// error of the least mean error on the stretches that the split held out.
    pub recommended: String,
    /// Methods by name, with two rivals that are fitted to nothing: `description` and `zero` torque.
    pub methods: BTreeMap<String, MethodRecord>,
    /// RMS torque error of the recommended method on the first unseen log, or without one on the rows held out, joint by
    /// joint, N·m.
    pub headline_rmse_nm: Vec<Option<f64>>,
    /// RMS torque error of the description's own parameters on those rows, N·m.
    pub headline_description_rmse_nm: Vec<Option<f64>>,
    /// RMS torque on the same rows, N·m.
    pub headline_torque_rms_nm: Vec<Option<f64>>,
    /// Findings on logs and parameters, refusals first.
    pub findings: Vec<Finding>,
    /// Judgement of the training logs before anything was identified.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_check: Option<Judgement>,
}

impl Report {
    /// Rows of the headline.
    pub fn headline_rows(&self) -> &'static str {
        let mut methods = self.methods.values();
        match methods.any(|method| !method.validation.is_empty()) {
            true => "first log of --validate",
            false => "rows held out of the training logs",
        }
    }
}

/// Names of the rivals in the table of methods.
pub(super) const RIVALS: [&str; 2] = ["description", "zero"];

impl MethodRecord {
    /// Adds the parameters of a fit.
    ///
    /// * `described` parameters of the description; `intervals` 95 % of each parameter
    pub(super) fn add_parameters(
        &mut self,
        fit: &Fit,
        layout: &Layout,
        truth: Option<&[Option<f64>]>,
        described: &DVector<f64>,
        intervals: Option<&[[f64; 2]]>,
    ) {
        self.noise_nm = fit.sigma.to_vec();
        self.base_parameter_error_ratio =
            truth.and_then(|truth| base_error(&fit.theta, truth, layout.base));
        let deviations = fit.deviations();
        let named = layout.parameters.iter().enumerate();
        // Columns the method does not have carry neither value nor deviation.
        let own = named.filter(|(place, _)| fit.covariance[(*place, *place)] > 0.0);
        let parameters = own.map(|(place, parameter)| ParameterRecord {
            name: parameter.name.clone(),
            value: fit.theta[place],
            unit: parameter.unit.to_owned(),
            std: deviations[place],
            ci95: intervals.map(|intervals| intervals[place]),
            description: Some(described[place]),
            truth: truth.and_then(|truth| truth[place]),
        });
        self.parameters = parameters.collect();
    }
}

/// Sum of the errors on logs; none of logs in which no joint moves.
pub(super) fn sum_of_errors(logs: &BTreeMap<String, ValidationRecord>) -> Option<f64> {
    let errors = logs
        .values()
        .filter_map(|log| log.joints_nrmse_moving_ratio);
    errors.reduce(|sum, error| sum + error)
}

/// Norm of the error of the base parameters over their norm.
pub(super) fn base_error(theta: &DVector<f64>, truth: &[Option<f64>], base: usize) -> Option<f64> {
    let truth: Vec<f64> = truth.iter().take(base).copied().collect::<Option<_>>()?;
    let pairs = truth.iter().zip(theta.iter());
    let error: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
    let size: f64 = truth.iter().map(|value| value * value).sum();
    Some((error / size).sqrt())
}
