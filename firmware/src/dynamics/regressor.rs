use crate::arm::Arm;
use crate::joint::JointMotion;
use nalgebra::SVector;

/// Row `joint` of the joint torque regressor over the base set.
pub fn regressor_row<A: Arm<N, P>, const N: usize, const P: usize>(
    _joint: usize,
    _motion: &JointMotion<N>,
) -> SVector<f32, P> {
    SVector::zeros()
}
