//! Inverse kinematics of any arm: damped least squares from a start.

use super::chain::{Chain, pose_error};
use super::error::InverseError;
use crate::dynamics::Joints;
use crate::robot::Placement;
use nalgebra::SMatrix;

/// Most steps from one start. Starts that arrive take about ten.
const STEPS: usize = 120;
/// Tolerance of the pose, m and rad.
const ARRIVED: f64 = 1e-10;

/// Joint positions near `start` that put the tip of `chain` at `target`.
///
/// `q += Jᵀ (J Jᵀ + λ 1)⁻¹ e` with `λ = ½ eᵀe`: the damping goes with the error, so that a target out of reach does not
/// make the steps explode and the last steps are Newton's                            [Sugihara 2011, eq. 20 without bias]
///
/// Errors: [`InverseError::Missed`].
pub(super) fn solve<const N: usize>(
    chain: &Chain<N>,
    target: &Placement,
    start: &Joints<N>,
) -> Result<Joints<N>, InverseError> {
    let mut q = *start;
    let mut left = pose_error(&chain.forward(&q), target);
    for _ in 0..STEPS {
        if left.amax() < ARRIVED {
            return Ok(q);
        }
        let jacobian = chain.jacobian(&q);
        let damping = 0.5 * left.norm_squared();
        let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * damping;
        let Some(square) = square.cholesky() else {
            break;
        };
        q += jacobian.tr_mul(&square.solve(&left));
        left = pose_error(&chain.forward(&q), target);
    }
    if left.amax() < ARRIVED {
        return Ok(q);
    }
    let (linear, angular) = (left.fixed_rows::<3>(0), left.fixed_rows::<3>(3));
    Err(InverseError::Missed {
        left_m: linear.norm(),
        left_rad: angular.norm(),
    })
}
