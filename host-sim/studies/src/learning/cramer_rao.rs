//! The Cramér–Rao bound of a payload estimate with everything else given.

use super::setup::{N, P};
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMotion, JointVector};
use foretorque::learning::{ConditionedSample, torque_row};
use nalgebra::{SMatrix, SVector, Vector3};

/// Mass, first moment and moments of inertia of a body at the last link.
const NUMBERS: usize = 7;
/// The first of them among the standard parameters.
const FIRST: usize = 10 * (N - 1);
/// Rows slower than this are left out, rad/s: the gate of the board.
const GATE_RAD_S: f32 = 0.05;
/// Standard deviations before anything is weighed: kg, kg·m, kg·m². Wide: they hardly count.
const WIDE: [f64; NUMBERS] = [6.0, 1.0, 1.0, 1.0, 0.15, 0.15, 0.15];

/// Information of the torques of all joints along a motion about a payload, if the arm itself is known exactly and torque
/// noise is the only disturbance. No unbiased estimate has a smaller covariance than its inverse.
#[derive(Clone, Debug)]
pub(super) struct CramerRao {
    information: SMatrix<f64, NUMBERS, NUMBERS>,
}

impl CramerRao {
    /// Information of the wide prior alone.
    pub(super) fn new() -> Self {
        let information = SVector::from(WIDE.map(|sigma| 1.0 / (sigma * sigma)));
        Self {
            information: SMatrix::from_diagonal(&information),
        }
    }

    /// Takes the torques of one tick, of noise `noise` in units of the torque limit.
    pub(super) fn add(&mut self, motion: &JointMotion<N>, noise: f64) {
        let seen = ConditionedSample {
            motion: *motion,
            tau: JointVector::zeros(),
        };
        for joint in (0..N).filter(|&joint| motion.qd[joint].abs() >= GATE_RAD_S) {
            let row = torque_row::<Ur5, N, P>(joint, &seen);
            let sigma = noise * f64::from(<Ur5 as Arm<N, P>>::LIMITS[joint].torque);
            let mut phi = SVector::<f64, NUMBERS>::zeros();
            for term in <Ur5 as Arm<N, P>>::BASE_MAP {
                let number = term.standard.checked_sub(FIRST);
                if let Some(number) = number.filter(|&number| number < NUMBERS) {
                    phi[number] += f64::from(term.weight * row.rigid[term.base]) / sigma;
                }
            }
            self.information += phi * phi.transpose();
        }
    }

    /// Standard deviations that are left for a body of mass `mass` with its centre at `com`: of its mass, kg, and of its
    /// centre of mass (root of the sum over the axes), m.
    pub(super) fn sigmas(&self, mass: f64, com: &Vector3<f64>) -> Option<(f64, f64)> {
        let covariance = self.information.try_inverse()?;
        // com = first moment / mass.
        let mut slope = SMatrix::<f64, 3, NUMBERS>::zeros();
        for axis in 0..3 {
            slope[(axis, 0)] = -com[axis] / mass;
            slope[(axis, 1 + axis)] = 1.0 / mass;
        }
        let spread = slope * covariance * slope.transpose();
        Some((covariance[(0, 0)].sqrt(), spread.trace().sqrt()))
    }
}
