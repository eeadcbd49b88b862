//! Information that a path carries about the parameters, and its gradient with respect to the regressor.

use super::rows::Rows;
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::joints;
use crate::metrics::{MOVING_RAD_S, condition_of, scaled};
use crate::robot::Robot;
use crate::trajectory::via::ViaPath;
use nalgebra::{Cholesky, DMatrix};

/// Objective of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Criterion {
    /// Condition number of the raw base regressor of the links in standard DH frames.
    Condition,
    /// Volume of the parameters' confidence ellipsoid.
    DOptimal,
    /// Predicted torque error on task motion.
    VOptimal,
    /// Predicted torque error, the condition number kept below a limit.
    Constrained,
}

/// Torque noise assumed, standard deviation as a share of the torque limit.
pub(super) const NOISE: f64 = 0.01;
/// Number of samples assumed: 10 s at 1 kHz.
pub(super) const SAMPLES: f64 = 10_000.0;
/// Width of the Coulomb columns' sign, rad/s, as in the firmware.
pub(super) const SIGN_WIDTH_RAD_S: f64 = foretorque::dynamics::SIGN_WIDTH as f64;
/// Exponent of the smooth stand-in for the largest and smallest eigenvalue: an upper bound of κ, 36^(1/32) = 1.12 at worst
/// in κ, and a per cent where eigenvalues are spread.
const EXPONENT: f64 = 32.0;

/// The motion whose torque is to be predicted: quintics through random via points.
const TASK_PATHS: u64 = 4;
const TASK_PATH_S: f64 = 30.0;
const TASK_PEAK_RAD_S: f64 = 2.7;
const TASK_PERIOD_S: f64 = 0.02;
const TASK_SEED: u64 = 0x7461_736b;

/// Everything that does not change with the path.
#[derive(Clone, Debug)]
pub(super) struct Experiment {
    /// 1 / σ² of each joint's torque, 1/(N·m)².
    weight: PerJoint<f64>,
    /// Mean over joints of the task's information, each divided by the joint's mean square torque.
    task: DMatrix<f64>,
    /// Mean information of the task about the torque of each joint.
    tasks: Vec<DMatrix<f64>>,
    links: usize,
}

/// Figures of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Worth {
    /// ln of the condition number (smooth upper bound of it).
    pub(super) ln_condition: f64,
    /// ln of the predicted torque error, as a share.
    pub(super) ln_error: f64,
    /// −ln det of the information, per parameter, halved.
    pub(super) ln_spread: f64,
}

impl Experiment {
    pub(super) fn new(robot: &Robot, rows: &Rows) -> Self {
        let (model, joints) = (RigidBodies::new(robot), robot.joint_count());
        let width = rows.count();
        let mut moments = vec![DMatrix::<f64>::zeros(width, width); joints];
        let (mut power, mut count) = (vec![0.0; joints], vec![0.0_f64; joints]);
        let mut block = DMatrix::zeros(width, joints);
        for path in 0..TASK_PATHS {
            for state in task(robot, TASK_SEED + path) {
                rows.write(&state, SIGN_WIDTH_RAD_S, block.as_mut_slice());
                let rigid = model.inverse_dynamics(&state);
                for (j, joint) in robot.joints.iter().enumerate() {
                    if state.qd[j].abs() < MOVING_RAD_S {
                        continue;
                    }
                    let row = block.column(j);
                    moments[j].syger(1.0, &row, &row, 1.0);
                    let friction = joint.friction.sliding(state.qd[j]);
                    power[j] += (rigid[j] + friction).powi(2);
                    count[j] += 1.0;
                }
            }
        }
        let mut task = DMatrix::zeros(width, width);
        for j in 0..joints {
            moments[j].fill_upper_triangle_with_lower_triangle();
            // Sums over the same rows on both sides of the fraction: their number cancels.
            if count[j] > 0.0 {
                task += &moments[j] / (power[j] * joints as f64);
                moments[j] /= count[j];
            }
        }
        Self {
            weight: PerJoint::from_fn(joints, |j| (NOISE * robot.joints[j].limits.torque).powi(-2)),
            task,
            tasks: moments,
            links: rows.link_columns.len(),
        }
    }

    /// Information of the rows `transposed` on all parameters, and its factors: the rows over their variances, the inverse,
    /// ln det. `None` where parameters cannot be distinguished.
    fn covariance(&self, transposed: &DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>, f64)> {
        let points = (transposed.ncols() / self.weight.len()) as f64;
        let scale = SAMPLES / points;
        let mut weighted = transposed.clone();
        for (column, mut row) in weighted.column_iter_mut().enumerate() {
            row *= self.weight[column % self.weight.len()] * scale;
        }
        let information = &weighted * transposed.transpose();
        // The rows' units differ by orders of magnitude: factorise with a diagonal of ones.
        let size = information.diagonal();
        let size = size.map(|d| d.max(f64::MIN_POSITIVE).sqrt().recip());
        let factor = Cholesky::new(scaled(&information, &size))?;
        let diagonal = factor.l_dirty().diagonal();
        let log_det = diagonal.iter().map(|d| 2.0 * d.ln()).sum::<f64>()
            - 2.0 * size.iter().map(|s| s.ln()).sum::<f64>();
        let mut covariance = factor.inverse();
        for i in 0..size.len() {
            for j in 0..size.len() {
                covariance[(i, j)] *= size[i] * size[j];
            }
        }
        Some((weighted, covariance, log_det))
    }

    /// Figures of the path with the regressor rows `transposed` (one row a column, joints fastest); with `adjoint`, also
    /// d(shares · worth) / d(rows), added to it. `None` where parameters cannot be distinguished.
    ///
    /// With C the covariance, T the task and M = n/K Σ w wᵀ/σ²: error² = tr(C T), so
    /// `d ln error = −(C T C w / error²)·dw n/(K σ²)`; `d ln det M = 2 C w·dw …`;
    /// for the eigenvalues λ of the raw information, `dλ = 2 (v·w)(v·dw)/K`.
    pub(super) fn worth(
        &self,
        transposed: &DMatrix<f64>,
        shares: impl Fn(&Worth) -> Worth,
        adjoint: Option<&mut DMatrix<f64>>,
    ) -> Option<Worth> {
        let points = (transposed.ncols() / self.weight.len()) as f64;
        let links = transposed.rows(0, self.links);
        let raw = links * links.transpose() / points;
        let (weighted, covariance, log_det) = self.covariance(transposed)?;
        let parameters = covariance.nrows() as f64;
        let error_squared = covariance.dot(&self.task);
        let eigen = raw.symmetric_eigen();
        let lambda = &eigen.eigenvalues;
        let (top, bottom) = (lambda.max(), lambda.min());
        if !(bottom > 0.0 && error_squared > 0.0) {
            return None;
        }
        let high = lambda.map(|l| (l / top).powf(EXPONENT));
        let low = lambda.map(|l| (bottom / l).powf(EXPONENT));
        let ln_condition =
            0.5 * (top.ln() - bottom.ln() + (high.sum().ln() + low.sum().ln()) / EXPONENT);
        let worth = Worth {
            ln_condition,
            ln_error: 0.5 * error_squared.ln(),
            ln_spread: -0.5 * log_det / parameters,
        };
        if let Some(adjoint) = adjoint {
            let share = shares(&worth);
            if share.ln_error != 0.0 {
                let steep = &covariance * &self.task * &covariance;
                *adjoint -= (steep * &weighted) * (share.ln_error / error_squared);
            }
            if share.ln_spread != 0.0 {
                *adjoint -= (&covariance * &weighted) * (share.ln_spread / parameters);
            }
            if share.ln_condition != 0.0 {
                let mut vectors = eigen.eigenvectors.clone();
                for (i, mut vector) in vectors.column_iter_mut().enumerate() {
                    let slope = (high[i] / high.sum() - low[i] / low.sum()) / lambda[i];
                    vector *= slope * share.ln_condition / points;
                }
                let steep = vectors * eigen.eigenvectors.transpose();
                let mut target = adjoint.rows_mut(0, self.links);
                target += steep * links;
            }
        }
        Some(worth)
    }

    /// Condition number of the raw base regressor of the links, the figures of the path through `states`, and the predicted
    /// torque error of every joint on task motion, N·m; rows of joints at rest count as unusable.
    pub(super) fn figures(&self, rows: &Rows, states: &[Motion]) -> Option<(f64, Worth, Vec<f64>)> {
        let mut transposed = rows.transposed(states, SIGN_WIDTH_RAD_S);
        let condition = condition_number(rows, &transposed);
        for (k, state) in states.iter().enumerate() {
            for (j, qd) in state.qd.iter().enumerate() {
                if qd.abs() < MOVING_RAD_S {
                    // A row of zeros keeps its place in the number of samples: it was spent.
                    transposed.column_mut(k * state.qd.len() + j).fill(0.0);
                }
            }
        }
        let worth = self.worth(&transposed, |_| Worth::default(), None)?;
        let (_, covariance, _) = self.covariance(&transposed)?;
        let errors = self.tasks.iter().map(|task| covariance.dot(task).sqrt());
        Some((condition, worth, errors.collect()))
    }
}

/// Motion on one of the task's paths.
fn task(robot: &Robot, seed: u64) -> Vec<Motion> {
    let times = (0..(TASK_PATH_S / TASK_PERIOD_S) as usize).map(|k| k as f64 * TASK_PERIOD_S);
    joints!(robot.joint_count(), N => {
        let path = ViaPath::<N>::random(robot, seed, TASK_PATH_S, TASK_PEAK_RAD_S);
        times.map(|t_s| path.at(t_s).into()).collect()
    }, else Vec::new())
}

/// Condition number of the raw base regressor of the links, of rows as [`Rows::transposed`] gives them.
pub(super) fn condition_number(rows: &Rows, transposed: &DMatrix<f64>) -> f64 {
    let links = transposed.rows(0, rows.link_columns.len());
    condition_of(&(links * links.transpose()))
}
