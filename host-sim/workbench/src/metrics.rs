//! Figures of merit: torque error and tracking error.

use crate::dynamics::Joints;

/// Slower joints count as still: stiction is no function of the velocity, rad/s.
pub const MOVING_RAD_S: f64 = 0.05;

/// Torque error against the truth, accumulated sample by sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueError<const N: usize> {
    all: Sums<N>,
    moving: Sums<N>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sums<const N: usize> {
    error: Joints<N>,
    truth: Joints<N>,
    count: Joints<N>,
}

impl<const N: usize> Sums<N> {
    fn new() -> Self {
        let zero = Joints::zeros();
        Self {
            error: zero,
            truth: zero,
            count: zero,
        }
    }

    fn add(&mut self, joint: usize, truth: f64, predicted: f64) {
        self.error[joint] += (predicted - truth).powi(2);
        self.truth[joint] += truth * truth;
        self.count[joint] += 1.0;
    }

    /// sqrt(mean_j (RMS err_j / RMS tau_j)²); joints without samples or torque are left out.
    fn nrmse(&self) -> f64 {
        let ratios: Vec<f64> = (0..N)
            .filter(|&j| self.truth[j] > 0.0)
            .map(|j| self.error[j] / self.truth[j])
            .collect();
        (ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).sqrt()
    }
}

impl<const N: usize> Default for TorqueError<N> {
    fn default() -> Self {
        Self {
            all: Sums::new(),
            moving: Sums::new(),
        }
    }
}

impl<const N: usize> TorqueError<N> {
    /// Adds one instant: true and predicted torque, N·m, and the velocity they belong to, rad/s.
    pub fn add(&mut self, truth: &Joints<N>, predicted: &Joints<N>, qd: &Joints<N>) {
        for j in 0..N {
            self.all.add(j, truth[j], predicted[j]);
            if qd[j].abs() > MOVING_RAD_S {
                self.moving.add(j, truth[j], predicted[j]);
            }
        }
    }

    /// NRMSE over all samples, a ratio.
    pub fn nrmse(&self) -> f64 {
        self.all.nrmse()
    }

    /// NRMSE over the samples in which the joint moves, a ratio.
    pub fn nrmse_moving(&self) -> f64 {
        self.moving.nrmse()
    }

    /// RMS error of every joint over all samples, N·m.
    pub fn rmse_nm(&self) -> Vec<f64> {
        (0..N)
            .map(|j| (self.all.error[j] / self.all.count[j].max(1.0)).sqrt())
            .collect()
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

    /// Adds what another one has seen.
    pub fn merge(&mut self, other: &Self) {
        self.sum += other.sum;
        self.count += other.count;
    }

    /// RMS over time of every joint, mrad.
    pub fn rms_mrad(&self) -> Vec<f64> {
        self.sum
            .iter()
            .map(|sum| 1e3 * (sum / self.count.max(1.0)).sqrt())
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
