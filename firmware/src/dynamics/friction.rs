//! Joint friction, linear in its parameters.

use crate::joint::JointVector;
use crate::math::tanh;

/// Number of friction columns of one joint.
pub const FRICTION_COLUMNS: usize = 2;

/// Reciprocal of the velocity over which Coulomb friction changes sign, s/rad: `sign(qd)` is smoothed to
/// `tanh(qd / 0.02)`.
///
/// 0.02 rad/s is a fifth of the Stribeck velocity of the drives modelled here (0.10 rad/s) and below the 0.05 rad/s
/// under which learning ignores a joint, where the smoothed sign has reached 0.987.
const INV_SIGN_WIDTH: f32 = 50.0;

/// Friction of one joint, linear in its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionParameters {
    /// Viscous coefficient, N·m·s/rad.
    pub viscous: f32,
    /// Coulomb torque, N·m.
    pub coulomb: f32,
}

impl FrictionParameters {
    /// The parameters in the order of [`friction_row`].
    pub const fn columns(self) -> [f32; FRICTION_COLUMNS] {
        [self.viscous, self.coulomb]
    }

    /// Parameters from the order of [`friction_row`].
    pub const fn from_columns([viscous, coulomb]: [f32; FRICTION_COLUMNS]) -> Self {
        Self { viscous, coulomb }
    }
}

/// The friction columns of one joint at velocity `qd`, rad/s: viscous `qd`, Coulomb `tanh(qd / 0.02)`.
///
/// Cost: one [`tanh`], one multiplication.
#[inline]
pub fn friction_row(qd: f32) -> [f32; FRICTION_COLUMNS] {
    [qd, tanh(qd * INV_SIGN_WIDTH)]
}

/// Friction torques at joint velocities `qd`, N × N·m: what the drives must supply, so positive along +qd.
///
/// Cost: one [`tanh`], 3 multiplications and 1 addition a joint.
pub fn friction<const N: usize>(
    parameters: &[FrictionParameters; N],
    qd: &JointVector<N>,
) -> JointVector<N> {
    JointVector::from_fn(|joint, _| {
        let [viscous, coulomb] = friction_row(qd[joint]);
        parameters[joint].viscous * viscous + parameters[joint].coulomb * coulomb
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_opposes_motion_and_is_coulomb_plus_viscous_away_from_rest() {
        let joint = FrictionParameters {
            viscous: 12.0,
            coulomb: 7.0,
        };
        let tau = friction(&[joint; 3], &JointVector::<3>::new(0.0, 1.5, -1.5));
        assert_eq!(tau[0], 0.0);
        assert!((tau[1] - 25.0).abs() < 1e-5);
        assert_eq!(tau[2], -tau[1]);
    }
}
