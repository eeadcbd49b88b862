//! Cogging, the torque that repeats with a joint's position: an input of the residual networks beside the speed.
//!
//! Their direct connections from sin(z q) and cos(z q) to the output are linear, so they follow from sums over rows, and
//! the board has a place for them: the cogging columns of its friction.

use super::columns::Layout;
use super::normal::JointSums;
use nalgebra::{DMatrix, DMatrixView, DVector, Matrix2, Vector2};

/// Amplitudes of sine and cosine of every joint, N·m.
pub type CoggingAmplitudes<const N: usize> = [[f64; 2]; N];

/// Gain in squared residuals over their variance from which a joint keeps its connections: two of them reach that by
/// chance in one case of a hundred [chi-squared, 2 degrees of freedom].
const CERTAIN: f64 = 9.21;

/// Sums that border one joint's equations by its sine and cosine, filtered as the equations were.
#[derive(Clone, Debug, PartialEq)]
struct Border {
    /// XᵀS.
    cross: DMatrix<f64>,
    /// SᵀS.
    gram: Matrix2<f64>,
    /// Sᵀτ.
    moment: Vector2<f64>,
}

/// The borders of all joints' equations.
#[derive(Clone, Debug, PartialEq)]
pub struct CoggingSums<const N: usize> {
    joints: Vec<Border>,
}

impl<const N: usize> CoggingSums<N> {
    /// No rows yet.
    pub(super) fn new(layout: &Layout<N>) -> Self {
        let joints = layout.active.iter().map(|active| Border {
            cross: DMatrix::zeros(active.len(), 2),
            gram: Matrix2::zeros(),
            moment: Vector2::zeros(),
        });
        Self {
            joints: joints.collect(),
        }
    }

    /// Adds rows of one joint: `x` row after row, `cogging_basis` sine and cosine a row, `tau` one a row.
    pub(super) fn add(&mut self, joint: usize, x: &[f64], cogging_basis: &[f64], tau: &[f64]) {
        if tau.is_empty() {
            return;
        }
        let border = &mut self.joints[joint];
        let columns = DMatrixView::from_slice(x, border.cross.nrows(), tau.len());
        let cogging_basis = DMatrixView::from_slice(cogging_basis, 2, tau.len());
        border.cross += columns * cogging_basis.transpose();
        border.gram += cogging_basis * cogging_basis.transpose();
        border.moment += cogging_basis * DVector::from_column_slice(tau);
    }

    /// Takes the torque of these amplitudes (N·m) from the equations of a joint.
    pub(super) fn subtract(&self, joint: usize, amplitude: [f64; 2], sums: &mut JointSums) {
        let (border, amplitude) = (&self.joints[joint], Vector2::from(amplitude));
        sums.moment -= &border.cross * amplitude;
        sums.power -=
            2.0 * border.moment.dot(&amplitude) - amplitude.dot(&(border.gram * amplitude));
    }

    /// Amplitudes that explain most of what `theta` leaves, N·m; zero where noise of `sigma`, N·m, could be all there is.
    pub(super) fn best(&self, joint: usize, theta: &DVector<f64>, sigma: f64) -> [f64; 2] {
        let border = &self.joints[joint];
        let left = border.moment - border.cross.tr_mul(theta);
        let Some(inverse) = border.gram.try_inverse() else {
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

#[cfg(test)]
mod tests {
    use crate::dynamics::{Joints, State};
    use crate::identification::{Layout, MethodName, SampleRow, fit_rows};
    use crate::robot::{LINK_PARAMETERS, Robot};
    use nalgebra::DMatrix;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Rows of an arm with viscous and Coulomb friction, a Stribeck peak and cogging, 1 mN·m of noise.
    fn rows(robot: &Robot, layout: &Layout<6>, seed: u64) -> Vec<SampleRow<6>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let model = crate::dynamics::ReferenceModel::<6>::new(robot).expect("six joints");
        let mut scratch = DMatrix::zeros(6, (LINK_PARAMETERS + 1) * 6);
        let mut draw = |reach: f64| Joints::<6>::from_fn(|_, _| random.random_range(-reach..reach));
        (0..4000)
            .map(|_| {
                let state = State {
                    q: draw(2.0),
                    qd: draw(1.0),
                    qdd: draw(3.0),
                };
                let mut panel = Vec::new();
                layout.append_row(&state, 0.0, &mut scratch, &mut panel);
                let rigid = model.inverse_dynamics(&state);
                let noise = draw(1e-3);
                let tau = std::array::from_fn(|j| {
                    let (friction, qd) = (&robot.joints[j].friction, state.qd[j]);
                    let peak = friction.stribeck_ratio * (-(qd / 0.1).powi(2)).exp();
                    rigid[j]
                        + friction.viscous * qd
                        + friction.coulomb * (1.0 + peak) * qd.signum()
                        + friction.cogging * (202.0 * state.q[j]).cos()
                        + noise[j]
                });
                SampleRow {
                    state,
                    tau,
                    clean: tau,
                    moving: std::array::from_fn(|j| state.qd[j].abs() > 0.05),
                    panel: panel.into(),
                    cogging_basis: layout.cogging_basis(&state.q),
                }
            })
            .collect()
    }

    #[test]
    fn networks_on_plain_columns_leave_less_than_0_4_of_what_least_squares_leaves() {
        let robot = Robot::load("ur5").expect("built in");
        let set = crate::identification::ColumnSet::plain();
        let layout = Layout::<6>::new(&robot, &set).expect("six joints");
        let (training, unseen) = (rows(&robot, &layout, 1), rows(&robot, &layout, 2));
        let training: Vec<&SampleRow<6>> = training.iter().collect();
        let methods = [MethodName::Wls, MethodName::BpResidual];
        let trials =
            fit_rows(&robot, (&layout, &layout), &methods, &training, 1).expect("well shown");
        let errors: Vec<f64> = trials
            .iter()
            .map(|trial| {
                let square = |row: &SampleRow<6>| {
                    let predicted = trial.candidate.torque(&layout, row);
                    let moving = (0..6).filter(|&j| row.moving[j]);
                    moving
                        .map(|j| {
                            ((predicted[j] - row.tau[j]) / robot.joints[j].limits.torque).powi(2)
                        })
                        .sum::<f64>()
                };
                unseen.iter().map(square).sum::<f64>().sqrt()
            })
            .collect();
        assert!(errors[1] < 0.4 * errors[0], "{errors:?}");
    }
}
