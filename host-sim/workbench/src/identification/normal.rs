//! Normal equations, joint by joint, added up over any number of rows.
//!
//! One joint's equations keep their own sums `XᵀX`, `Xᵀτ`, `τᵀτ`: a weight for each joint, a column subset, the RMSE of any
//! parameters and the gradient of the BP network's loss all follow from them without another pass over the log. The price
//! is the square of the condition number, which f64 affords up to about 1e7 (rank decisions are made at 1e4).

use super::IdentifyError;
use super::columns::Layout;
use crate::dynamics::PerJoint;
use crate::metrics::{condition_of, scaled};
use nalgebra::{DMatrix, DMatrixView, DVector};

/// Least part of a column that the columns left of it do not explain, as a share of its length. Useful excitations leave
/// 1e-2 and more, encoder noise on a joint that is held still about 1e-5.
const INDEPENDENT: f64 = 1e-4;

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
    /// Sums over no equations.
    pub(super) fn new(layout: &Layout) -> Self {
        let joints = layout.active.iter();
        Self {
            joints: joints.map(|active| JointSums::new(active.len())).collect(),
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

    /// Equations of all joints.
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

/// Solution of `gram · theta = moment` and the inverse of `gram`, by Cholesky's method on columns of unit length; `None`
/// when `gram` is not positive definite.
pub(super) fn solve(
    gram: &DMatrix<f64>,
    moment: &DVector<f64>,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let (unit, inverse) = equilibrated(gram);
    let cholesky = unit.cholesky()?;
    let theta = cholesky
        .solve(&moment.component_mul(&inverse))
        .component_mul(&inverse);
    Some((theta, scaled(&cholesky.inverse(), &inverse)))
}
