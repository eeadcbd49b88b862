use crate::joint::JointVector;

/// Number of friction columns of one joint.
pub const FRICTION_COLUMNS: usize = 2;

/// Friction of one joint, linear in its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionParameters {
    /// Viscous coefficient, N·m·s/rad.
    pub viscous: f32,
    /// Coulomb torque, N·m.
    pub coulomb: f32,
}

/// The friction columns of one joint at velocity `qd`: viscous, Coulomb.
pub fn friction_row(_qd: f32) -> [f32; FRICTION_COLUMNS] {
    [0.0; FRICTION_COLUMNS]
}

/// Friction torques, N × N·m.
pub fn friction<const N: usize>(
    _parameters: &[FrictionParameters; N],
    _qd: &JointVector<N>,
) -> JointVector<N> {
    JointVector::zeros()
}
