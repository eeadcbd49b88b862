//! Joint friction, linear in its parameters.

use crate::joint::JointVector;
use crate::math::{exp, tanh};

/// Number of friction columns of one joint.
pub const FRICTION_COLUMNS: usize = 4;

/// Velocity over which Coulomb friction changes sign, rad/s: `sign(qd)` is smoothed to `tanh(qd / SIGN_WIDTH)`.
///
/// 0.01 rad/s is a tenth of the Stribeck velocity of the drives modelled here (0.10 rad/s) and a fifth of the 0.05 rad/s
/// under which learning ignores a joint, where the smoothed sign has reached 0.9999. The sign is that of the desired
/// velocity: it closes no loop that could chatter.
pub const SIGN_WIDTH: f32 = 0.01;
const INV_SIGN_WIDTH: f32 = 1.0 / SIGN_WIDTH;

/// Reciprocal of the Stribeck velocity of the wide column, s/rad: 0.14 rad/s. The narrow one has half of that.
///
/// A peak whose width lies between the two is a sum of both to within 5 % of its height, and sums are what an
/// estimator that is linear in its parameters can find.
const INV_WIDE: f32 = 1.0 / 0.14;

/// Friction of one joint, linear in its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionParameters {
    /// Viscous coefficient, N·m·s/rad.
    pub viscous: f32,
    /// Coulomb torque, N·m.
    pub coulomb: f32,
    /// Height of the Stribeck peak of width 0.07 rad/s, N·m.
    pub stribeck_narrow: f32,
    /// Height of the Stribeck peak of width 0.14 rad/s, N·m.
    pub stribeck_wide: f32,
}

impl FrictionParameters {
    /// No friction.
    pub const NONE: Self = Self::from_columns([0.0; FRICTION_COLUMNS]);

    /// The parameters in the order of [`friction_row`].
    pub const fn columns(self) -> [f32; FRICTION_COLUMNS] {
        [
            self.viscous,
            self.coulomb,
            self.stribeck_narrow,
            self.stribeck_wide,
        ]
    }

    /// Parameters from the order of [`friction_row`].
    pub const fn from_columns(
        [viscous, coulomb, stribeck_narrow, stribeck_wide]: [f32; FRICTION_COLUMNS],
    ) -> Self {
        Self {
            viscous,
            coulomb,
            stribeck_narrow,
            stribeck_wide,
        }
    }

    /// The nearest friction that resists at every velocity. A peak may be negative, to take away from the other; no more
    /// than half of the Coulomb torque, so that both together leave some. What is no number becomes 0.
    pub fn resisting(self) -> Self {
        let above = |value: f32, floor: f32| if value > floor { value } else { floor };
        let coulomb = above(self.coulomb, 0.0);
        Self {
            viscous: above(self.viscous, 0.0),
            coulomb,
            stribeck_narrow: above(self.stribeck_narrow, -0.5 * coulomb),
            stribeck_wide: above(self.stribeck_wide, -0.5 * coulomb),
        }
    }
}

/// The friction columns of one joint at velocity `qd`, rad/s.
///
/// ```text
/// viscous qd,   Coulomb s = tanh(qd / 0.01),   Stribeck s exp(−(qd / 0.07)²) and s exp(−(qd / 0.14)²)
/// ```
///
/// Cost: one [`tanh`], one [`exp`] (the narrow peak is the fourth power of the wide one), 9 multiplications.
#[inline]
pub fn friction_row(qd: f32) -> [f32; FRICTION_COLUMNS] {
    let sign = tanh(qd * INV_SIGN_WIDTH);
    let ratio = qd * INV_WIDE;
    let wide = exp(-(ratio * ratio));
    let squared = wide * wide;
    [qd, sign, sign * (squared * squared), sign * wide]
}

/// Friction torques at joint velocities `qd`, N × N·m: what the drives must supply, so positive along +qd.
///
/// Cost: one [`friction_row`], 4 multiply-adds a joint.
pub fn friction<const N: usize>(
    parameters: &[FrictionParameters; N],
    qd: &JointVector<N>,
) -> JointVector<N> {
    JointVector::from_fn(|joint, _| {
        let [viscous, coulomb, narrow, wide] = friction_row(qd[joint]);
        let p = &parameters[joint];
        p.viscous * viscous
            + p.coulomb * coulomb
            + p.stribeck_narrow * narrow
            + p.stribeck_wide * wide
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
            stribeck_narrow: 1.0,
            stribeck_wide: -0.5,
        };
        let tau = friction(&[joint; 3], &JointVector::<3>::new(0.0, 1.5, -1.5));
        assert_eq!(tau[0], 0.0);
        assert!((tau[1] - 25.0).abs() < 1e-5);
        assert_eq!(tau[2], -tau[1]);
    }

    #[test]
    fn two_peaks_make_one_of_a_width_between_them() {
        // Least squares over 0.05 … 2 rad/s.
        for (width, narrow, wide) in [(0.08, 1.02, 0.10), (0.1, 0.82, 0.38), (0.12, 0.44, 0.69)] {
            for step in 10..400 {
                let qd = step as f32 * 5e-3;
                let [_, s, n, w] = friction_row(qd);
                let peak = s * (-(qd / width).powi(2)).exp();
                let error = narrow * n + wide * w - peak;
                assert!(error.abs() < 0.055, "{error} at {qd} for {width}");
            }
        }
    }

    #[test]
    fn whatever_was_estimated_resists_at_every_velocity() {
        for wild in [
            [-1.0, 3.0, -9.0, -9.0],
            [f32::NAN, -1.0, 2.0, f32::NAN],
            [0.5, 4.0, -9.0, 1.0],
        ] {
            let friction_of = FrictionParameters::from_columns(wild).resisting();
            for step in 1..400 {
                let tau = friction(&[friction_of], &JointVector::<1>::new(step as f32 * 5e-3));
                assert!(tau[0] >= 0.0, "{tau} of {friction_of:?}");
            }
        }
    }
}
