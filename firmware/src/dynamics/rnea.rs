use super::BaseParameters;
use crate::arm::Arm;
use crate::joint::{JointMotion, JointVector};

/// Joint torques of the rigid body, N × N·m.
pub fn rnea<A: Arm<N, P>, const N: usize, const P: usize>(
    _beta: &BaseParameters<P>,
    _motion: &JointMotion<N>,
) -> JointVector<N> {
    JointVector::zeros()
}
