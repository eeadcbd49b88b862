//! Figures of merit: torque error and tracking error.

use crate::dynamics::Joints;
use nalgebra::{DMatrix, DVector};

/// Speed below which a joint counts as still, rad/s: stiction is no function of the velocity.
pub const MOVING_RAD_S: f64 = 0.05;

/// Root of the mean of `squares`; 0 of none.
pub fn root_mean(squares: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for square in squares {
        sum += square;
        count += 1.0;
    }
    (sum / f64::max(count, 1.0)).sqrt()
}

/// An even sample of `items`, of `most` at most.
pub(crate) fn even_sample<T>(items: &[T], most: usize) -> impl ExactSizeIterator<Item = &T> {
    items.iter().step_by(items.len().div_ceil(most).max(1))
}

/// Root of the mean square of the known `values`.
pub(crate) fn root_mean_square(values: &[Option<f64>]) -> f64 {
    root_mean(values.iter().flatten().map(|value| value * value))
}

/// The square matrix with row k and column k times `scale[k]`.
pub(crate) fn scaled(square: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(scale.len(), scale.len(), |r, c| {
        square[(r, c)] * scale[r] * scale[c]
    })
}

/// Condition number of a matrix X with XᵀX = `gram`.
pub(crate) fn condition_of(gram: &DMatrix<f64>) -> f64 {
    let values = gram.symmetric_eigenvalues();
    (values.max() / values.min().max(f64::MIN_POSITIVE)).sqrt()
}

/// Torque error against the truth, accumulated sample by sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueError<const N: usize> {
    all: [ErrorSums; N],
    moving: [ErrorSums; N],
}

/// Sums over the samples of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorSums {
    /// Squared errors and squared torques, N²·m².
    error: f64,
    pub(crate) truth: f64,
    pub(crate) count: f64,
}

impl ErrorSums {
    /// Adds a sample, N·m.
    pub fn add(&mut self, truth: f64, predicted: f64) {
        self.error += (predicted - truth).powi(2);
        self.truth += truth * truth;
        self.count += 1.0;
    }

    /// These sums and those of other samples.
    pub(crate) fn with(&self, other: &Self) -> Self {
        Self {
            error: self.error + other.error,
            truth: self.truth + other.truth,
            count: self.count + other.count,
        }
    }

    /// RMS error, N·m; none without samples.
    pub fn rmse(&self) -> Option<f64> {
        (self.count > 0.0).then(|| (self.error / self.count).sqrt())
    }

    /// RMS torque, N·m; none without samples.
    pub(crate) fn torque_rms(&self) -> Option<f64> {
        (self.count > 0.0).then(|| (self.truth / self.count).sqrt())
    }

    /// RMS error over RMS torque; none without torque.
    pub(crate) fn nrmse(&self) -> Option<f64> {
        (self.truth > 0.0).then(|| (self.error / self.truth).sqrt())
    }
}

/// sqrt(mean_j (RMS err_j / RMS tau_j)²); joints without samples or torque are left out, and of these alone there is none.
pub(crate) fn nrmse(sums: &[ErrorSums]) -> Option<f64> {
    let joints = sums.iter().filter(|sums| sums.truth > 0.0);
    let squares: Vec<f64> = joints.map(|sums| sums.error / sums.truth).collect();
    (!squares.is_empty()).then(|| root_mean(squares))
}

impl<const N: usize> Default for TorqueError<N> {
    fn default() -> Self {
        Self {
            all: [ErrorSums::default(); N],
            moving: [ErrorSums::default(); N],
        }
    }
}

impl<const N: usize> TorqueError<N> {
    /// Adds one instant: true and predicted torque, N·m, and the velocity they belong to, rad/s.
    pub fn add(&mut self, truth: &Joints<N>, predicted: &Joints<N>, qd: &Joints<N>) {
        for j in 0..N {
            self.all[j].add(truth[j], predicted[j]);
            if qd[j].abs() > MOVING_RAD_S {
                self.moving[j].add(truth[j], predicted[j]);
            }
        }
    }

    /// NRMSE over all samples, a ratio; 0 of none.
    pub fn nrmse(&self) -> f64 {
        nrmse(&self.all).unwrap_or(0.0)
    }

    /// NRMSE over the samples in which the joint moves, a ratio; 0 of none.
    pub fn nrmse_moving(&self) -> f64 {
        nrmse(&self.moving).unwrap_or(0.0)
    }

    /// RMS error of every joint over all samples, N·m.
    pub fn rmse_nm(&self) -> Vec<f64> {
        let joints = self.all.iter();
        joints.map(|sums| sums.rmse().unwrap_or(0.0)).collect()
    }
}

/// Tracking error, accumulated tick by tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackingError<const N: usize> {
    sum: Joints<N>,
    count: f64,
}

impl<const N: usize> Default for TrackingError<N> {
    fn default() -> Self {
        Self {
            sum: Joints::zeros(),
            count: 0.0,
        }
    }
}

impl<const N: usize> TrackingError<N> {
    /// Adds the distance of desired and true position, rad.
    pub fn add(&mut self, error: &Joints<N>) {
        self.sum += error.component_mul(error);
        self.count += 1.0;
    }

    /// RMS over time of every joint, mrad.
    pub fn rms_mrad(&self) -> Vec<f64> {
        let sums = self.sum.iter();
        sums.map(|sum| 1e3 * (sum / self.count.max(1.0)).sqrt())
            .collect()
    }

    /// Mean over the joints of their RMS, mrad.
    pub fn mean_rms_mrad(&self) -> f64 {
        self.rms_mrad().iter().sum::<f64>() / N as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::vector;

    #[test]
    fn nrmse_is_the_root_mean_square_of_the_joints_ratios() {
        let mut error = TorqueError::<2>::default();
        // Joint 1 errs by 10 % of its torque, joint 2 by 20 % of its own: sqrt((0.01 + 0.04) / 2).
        for sign in [1.0, -1.0] {
            error.add(
                &vector![100.0, 1.0],
                &vector![100.0 + 10.0 * sign, 0.8],
                &vector![1.0, 0.0],
            );
        }
        assert!((error.nrmse() - 0.025_f64.sqrt()).abs() < 1e-12);
        assert!(
            (error.nrmse_moving() - 0.1).abs() < 1e-12,
            "joint 2 stands still"
        );
        assert!((error.rmse_nm()[0] - 10.0).abs() < 1e-12);
    }

    #[test]
    fn tracking_error_is_in_milliradians() {
        let mut error = TrackingError::<2>::default();
        error.add(&vector![0.003, 0.001]);
        error.add(&vector![-0.003, 0.001]);
        assert!((error.mean_rms_mrad() - 2.0).abs() < 1e-12);
    }
}
