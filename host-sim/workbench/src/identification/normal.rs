//! Normal equations, joint by joint, added up over any number of rows.
//!
//! One joint's equations keep their own sums `XᵀX`, `Xᵀτ`, `τᵀτ`: a weight for each joint, a column subset, the RMSE of any
//! parameters and the gradient of the BP network's loss all follow from them without another pass over the log. The price
//! is the square of the condition number, which f64 affords up to about 1e7 (rank decisions are made at 1e4).

use super::IdentifyError;
use super::columns::Layout;
use crate::dynamics::{Motion, PerJoint};
use crate::metrics::{condition_of, scaled};
use crate::training::SpeedPoint;
use nalgebra::{DMatrix, DMatrixView, DVector, Matrix2, Vector2};
use std::borrow::Borrow;
use std::collections::BTreeMap;

/// Least part of a column that the columns left of it do not explain, as a share of its length. Useful excitations leave
/// 1e-2 and more, encoder noise on a joint that is held still about 1e-5.
const INDEPENDENT: f64 = 1e-4;

/// One row of the bounded sample.
#[derive(Clone, Debug)]
pub struct SampleRow {
    /// Time in its log, s.
    pub t_s: f64,
    /// Motion.
    pub state: Motion,
    /// Filtered torque, N·m.
    pub tau: PerJoint<f64>,
    /// Filtered torque without spikes, N·m.
    pub clean: PerJoint<f64>,
    /// Joints that move.
    pub moving: PerJoint<bool>,
    /// Active columns and cogging of all joints.
    pub panel: Box<[f64]>,
}

impl SampleRow {
    pub(super) fn columns(&self, layout: &Layout, joint: usize) -> &[f64] {
        layout.columns(joint, &self.panel)
    }

    /// Torque of the linear model at one joint, N·m.
    pub(super) fn linear(&self, layout: &Layout, theta: &DVector<f64>, joint: usize) -> f64 {
        layout.torque(joint, self.columns(layout, joint), theta)
    }
}

/// Sums of one joint's equations.
#[derive(Clone, Debug, PartialEq)]
pub struct JointSums {
    /// XᵀX over the joint's active columns.
    pub gram: DMatrix<f64>,
    /// Xᵀτ.
    pub moment: DVector<f64>,
    /// τᵀτ, N²·m².
    pub power: f64,
    /// Number of equations.
    pub count: f64,
}

impl JointSums {
    /// Sums over no equations of `active` columns.
    pub fn new(active: usize) -> Self {
        Self {
            gram: DMatrix::zeros(active, active),
            moment: DVector::zeros(active),
            power: 0.0,
            count: 0.0,
        }
    }

    /// Adds equations: `x` row after row, `tau` one a row.
    pub fn add(&mut self, x: &[f64], tau: &[f64]) {
        if tau.is_empty() {
            return;
        }
        let columns = DMatrixView::from_slice(x, self.moment.len(), tau.len());
        self.gram.gemm(1.0, &columns, &columns.transpose(), 1.0);
        let tau = DVector::from_column_slice(tau);
        self.moment.gemv(1.0, &columns, &tau, 1.0);
        self.power += tau.norm_squared();
        self.count += tau.len() as f64;
    }

    /// Mean square error of these parameters, N²·m².
    pub fn mean_square(&self, theta: &DVector<f64>) -> f64 {
        let sum = self.power - 2.0 * self.moment.dot(theta) + theta.dot(&(&self.gram * theta));
        (sum / self.count.max(1.0)).max(0.0)
    }
}

/// Sums of all joints' equations.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NormalEquations {
    /// One joint after the other.
    pub joints: Vec<JointSums>,
}

impl NormalEquations {
    /// Sums over no equations, with `more` columns after the active ones of each joint.
    pub(super) fn new(layout: &Layout, more: usize) -> Self {
        let joints = layout.active.iter();
        let joints = joints.map(|active| JointSums::new(active.len() + more));
        Self {
            joints: joints.collect(),
        }
    }

    /// Adds the equations of the joints that move in these rows: columns and torque, N·m.
    pub(super) fn add<'r>(
        &mut self,
        rows: &'r [impl Borrow<SampleRow>],
        equation: impl Fn(&'r SampleRow, usize) -> (&'r [f64], f64),
    ) {
        for (joint, sums) in self.joints.iter_mut().enumerate() {
            let (mut x, mut tau) = (Vec::new(), Vec::new());
            let rows = rows.iter().map(Borrow::borrow);
            for row in rows.filter(|row| row.moving[joint]) {
                let (columns, torque) = equation(row, joint);
                x.extend_from_slice(columns);
                tau.push(torque);
            }
            sums.add(&x, &tau);
        }
    }

    /// The equations with the columns of a poorer layout only.
    pub(super) fn subset(&self, layout: &Layout, poorer: &Layout) -> Self {
        let places = layout.places_of(poorer);
        let joints = self.joints.iter().enumerate().map(|(joint, sums)| {
            let active = layout.active[joint].iter();
            let kept = poorer.active[joint].iter();
            let own: Vec<usize> = kept
                .filter_map(|&kept| active.clone().position(|&own| own == places[kept]))
                .collect();
            JointSums {
                gram: sums.gram.select_rows(&own).select_columns(&own),
                moment: sums.moment.select_rows(&own),
                ..*sums
            }
        });
        Self {
            joints: joints.collect(),
        }
    }

    pub(super) fn count(&self) -> f64 {
        self.joints.iter().map(|joint| joint.count).sum()
    }

    /// Weighted sums over all parameters: each joint's equations divided by its `sigma`, N·m.
    pub(super) fn weighted(&self, layout: &Layout, sigma: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
        let size = layout.parameters.len();
        let mut gram = DMatrix::zeros(size, size);
        let mut moment = DVector::zeros(size);
        for ((joint, active), sigma) in self.joints.iter().zip(&layout.active).zip(sigma) {
            let weight = 1.0 / (sigma * sigma);
            for (a, &row) in active.iter().enumerate() {
                moment[row] += weight * joint.moment[a];
                for (b, &column) in active.iter().enumerate() {
                    gram[(row, column)] += weight * joint.gram[(a, b)];
                }
            }
        }
        (gram, moment)
    }

    /// RMS error of every joint, N·m.
    pub(super) fn rmse(&self, layout: &Layout, theta: &DVector<f64>) -> PerJoint<f64> {
        PerJoint::from_fn(self.joints.len(), |joint| {
            let own = theta.select_rows(&layout.active[joint]);
            self.joints[joint].mean_square(&own).sqrt()
        })
    }

    /// Check that every parameter is observable.
    ///
    /// Errors: [`IdentifyError::RankDeficient`] with the columns that the columns left of them explain.
    pub(super) fn check_rank(&self, layout: &Layout) -> Result<(), IdentifyError> {
        let (mut rest, _) = self.weighted(layout, &vec![1.0; self.joints.len()]);
        let size = rest.nrows();
        let length: Vec<f64> = (0..size).map(|c| rest[(c, c)]).collect();
        let mut unseen = Vec::new();
        for c in 0..size {
            let new = rest[(c, c)];
            if length[c] <= 0.0 || new <= INDEPENDENT * INDEPENDENT * length[c] {
                unseen.push(layout.parameters[c].name.clone());
                continue;
            }
            let column = rest.column(c) / new.sqrt();
            rest.ger(-1.0, &column, &column, 1.0);
        }
        if unseen.is_empty() {
            return Ok(());
        }
        let rank = size - unseen.len();
        Err(IdentifyError::RankDeficient(rank, size, unseen))
    }

    /// Condition number of the raw regressor of the base parameters, SI units; and of all columns at unit length.
    pub(super) fn condition_numbers(&self, layout: &Layout) -> (f64, f64) {
        let (gram, _) = self.weighted(layout, &vec![1.0; self.joints.len()]);
        let raw = gram.view((0, 0), (layout.base, layout.base)).into_owned();
        (condition_of(&raw), condition_of(&equilibrated(&gram).0))
    }
}

/// The matrix with a unit diagonal, and the reciprocal column lengths that make it so.
pub(super) fn equilibrated(gram: &DMatrix<f64>) -> (DMatrix<f64>, DVector<f64>) {
    let inverse = gram
        .diagonal()
        .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    (scaled(gram, &inverse), inverse)
}

/// Solution of `gram · theta = moment` and the inverse of `gram`, by Cholesky's method on columns of unit length.
///
/// Errors: [`IdentifyError::Unsolvable`] when `gram` is not positive definite.
pub(super) fn solve(
    gram: &DMatrix<f64>,
    moment: &DVector<f64>,
) -> Result<(DVector<f64>, DMatrix<f64>), IdentifyError> {
    let (unit, inverse) = equilibrated(gram);
    let cholesky = unit.cholesky().ok_or(IdentifyError::Unsolvable)?;
    let theta = cholesky.solve(&moment.component_mul(&inverse));
    let theta = theta.component_mul(&inverse);
    Ok((theta, scaled(&cholesky.inverse(), &inverse)))
}

/// Amplitudes of sine and cosine of every joint's cogging, N·m: of the torque that repeats with the position.
///
/// They are direct connections of the residual networks. Linear as they are, they follow from sums over rows, and the board
/// has a place for them: the cogging columns of its friction.
pub type CoggingAmplitudes = PerJoint<[f64; 2]>;

/// Gain in squared residuals over their variance from which a joint keeps its connections: two of them reach that by
/// chance in one case of a hundred [chi-squared, 2 degrees of freedom].
const CERTAIN: f64 = 9.21;

impl JointSums {
    /// XᵀS, SᵀS and Sᵀτ, where the last two columns S are sine and cosine of cogging, filtered as the others, X, were.
    fn border(&self) -> (DMatrixView<'_, f64>, Matrix2<f64>, Vector2<f64>) {
        let active = self.moment.len() - 2;
        let gram = self.gram.fixed_view::<2, 2>(active, active);
        let moment = self.moment.fixed_rows::<2>(active);
        let cross = self.gram.view((0, active), (active, 2));
        (cross, gram.into_owned(), moment.into_owned())
    }

    /// Subtracts the torque of these amplitudes (N·m) from the equations of the joint.
    pub(super) fn subtract_cogging(&self, amplitude: [f64; 2], sums: &mut Self) {
        let (cross, gram, moment) = self.border();
        let amplitude = Vector2::from(amplitude);
        sums.moment -= cross * amplitude;
        sums.power -= 2.0 * moment.dot(&amplitude) - amplitude.dot(&(gram * amplitude));
    }

    /// Least-squares amplitudes for the residuals of `theta`, N·m; zero where noise of `sigma`, N·m, explains them.
    pub(super) fn best_cogging(&self, theta: &DVector<f64>, sigma: f64) -> [f64; 2] {
        let (cross, gram, moment) = self.border();
        let left = moment - cross.tr_mul(theta);
        let Some(inverse) = gram.try_inverse() else {
            return [0.0; 2];
        };
        let amplitude = inverse * left;
        if left.dot(&amplitude) > CERTAIN * sigma * sigma {
            amplitude.into()
        } else {
            [0.0; 2]
        }
    }
}

/// Bins from −fastest to fastest.
const BINS: usize = 600;
/// Speed at which bins begin to grow with the speed, rad/s, and the largest that has a bin of its own.
const FINE_RAD_S: f64 = 0.05;
const FASTEST_RAD_S: f64 = 10.0;

/// Sums over the rows of one bin.
#[derive(Clone, Debug, PartialEq)]
struct Bin {
    count: f64,
    qd: f64,
    tau: f64,
    /// Active columns, then sine and cosine of the cogging phase.
    x: Vec<f64>,
}

/// Sums of every joint, for two halves of the log that take turns.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedSums {
    /// Bins by their place among all, for each half and joint.
    bins: Vec<BTreeMap<usize, Bin>>,
}

impl Bin {
    fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.qd += other.qd;
        self.tau += other.tau;
        for (sum, x) in self.x.iter_mut().zip(&other.x) {
            *sum += x;
        }
    }
}

impl SpeedSums {
    pub(super) fn new(joints: usize) -> Self {
        Self {
            bins: vec![BTreeMap::new(); 2 * joints],
        }
    }

    fn put(&mut self, row: usize, place: usize, new: Bin) {
        let bin = self.bins[row].entry(place);
        bin.and_modify(|bin| bin.add(&new)).or_insert(new);
    }

    /// Adds one row of one joint in one half of the log.
    ///
    /// * `x` columns of the joint with cogging; `tau` N·m
    pub(super) fn add(&mut self, (joint, half): (usize, usize), qd: f64, x: &[f64], tau: f64) {
        let share = (qd / FINE_RAD_S).asinh() / (FASTEST_RAD_S / FINE_RAD_S).asinh();
        let place = ((0.5 * (share + 1.0) * BINS as f64).max(0.0) as usize).min(BINS - 1);
        let (count, x) = (1.0, x.to_vec());
        self.put(2 * joint + half, place, Bin { count, qd, tau, x });
    }

    /// Adds all rows of another part of the log.
    pub(super) fn merge(&mut self, other: &Self) {
        for (row, bins) in other.bins.iter().enumerate() {
            for (place, bin) in bins {
                self.put(row, *place, bin.clone());
            }
        }
    }

    /// Subtracts a torque that depends on the speed alone (N·m) from the equations of a joint.
    ///
    /// The equations come from filtered and thinned rows, these sums from raw ones: inner products with the slow columns of
    /// a motion are the same but for the number of rows.
    pub(super) fn subtract(&self, joint: usize, sums: &mut JointSums, torque: &dyn Fn(f64) -> f64) {
        let halves = &self.bins[2 * joint..2 * joint + 2];
        let bins = || halves.iter().flat_map(BTreeMap::values);
        let all: f64 = bins().map(|bin| bin.count).sum();
        let share = sums.count / all.max(1.0);
        for bin in bins() {
            let torque = torque(bin.qd / bin.count);
            sums.power -= share * torque * (2.0 * bin.tau - torque * bin.count);
            for (moment, x) in sums.moment.iter_mut().zip(&bin.x) {
                *moment -= share * torque * x;
            }
        }
    }

    /// Mean residuals of a linear model and cogging at each speed, divided by `unit`, N·m, in one half of the log.
    pub(super) fn residuals(
        &self,
        layout: &Layout,
        theta: &DVector<f64>,
        cogging: [f64; 2],
        (joint, half): (usize, usize),
        unit: f64,
    ) -> Vec<SpeedPoint> {
        let bins = self.bins[2 * joint + half].values();
        bins.map(|bin| {
            let model = layout.torque_with_cogging(joint, &bin.x, theta, cogging);
            SpeedPoint {
                qd: bin.qd / bin.count,
                residual: (bin.tau - model) / bin.count / unit,
                weight: bin.count,
            }
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::dynamics::RigidBodies;
    use crate::identification::dataset::random_rows;
    use crate::identification::normal::SampleRow;
    use crate::identification::{ColumnSet, Layout, MethodName, fit_rows};
    use crate::robot::Robot;

    /// Rows of an arm with viscous and Coulomb friction, a Stribeck peak and cogging, 1 mN·m of noise.
    fn rows(robot: &Robot, layout: &Layout, seed: u64) -> Vec<SampleRow> {
        let model = RigidBodies::new(robot);
        random_rows(layout, 4000, seed, [2.0, 1.0, 3.0], 1e-3, |row, j| {
            let (friction, qd) = (&robot.joints[j].friction, row.state.qd[j]);
            let peak = friction.stribeck_ratio * (-(qd / 0.1).powi(2)).exp();
            model.inverse_dynamics(&row.state)[j]
                + friction.viscous * qd
                + friction.coulomb * (1.0 + peak) * qd.signum()
                + friction.cogging * (202.0 * row.state.q[j]).cos()
        })
    }

    #[test]
    fn networks_leave_less_than_0_4_of_what_least_squares_leaves() {
        let robot = Robot::load("ur5").expect("built in");
        let layout = Layout::new(&robot, &ColumnSet::plain());
        let (training, unseen) = (rows(&robot, &layout, 1), rows(&robot, &layout, 2));
        let training: Vec<&SampleRow> = training.iter().collect();
        let methods = [MethodName::Wls, MethodName::BpResidual];
        let results = fit_rows(&robot, (&layout, &layout), &methods, &training, 1);
        let errors: Vec<f64> = results
            .expect("well shown")
            .iter()
            .map(|result| {
                let square = |row: &SampleRow| {
                    let predicted = result.candidate.torque(&layout, row);
                    let moving = (0..6).filter(|&j| row.moving[j]);
                    let limit = |j: usize| robot.joints[j].limits.torque;
                    moving
                        .map(|j| ((predicted[j] - row.tau[j]) / limit(j)).powi(2))
                        .sum::<f64>()
                };
                unseen.iter().map(square).sum::<f64>().sqrt()
            })
            .collect();
        assert!(errors[1] < 0.4 * errors[0], "{errors:?}");
    }
}
