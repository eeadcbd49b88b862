//! From the figures of a data sheet to the base parameters.

use super::{Arm, LINK_PARAMETERS};
use nalgebra::{Matrix3, SVector, Vector3};

/// Mass distribution of one link as a data sheet gives it.
///
/// Frame: that of the link, z along its own joint axis, origin on it, turning with the link; at q = 0 it lies in the
/// frame of the link before of [`Arm::PLACEMENTS`]. Figures in the frame at the far end of a link, as standard
/// Denavit–Hartenberg tables have them, are converted where a description is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkInertia {
    /// Mass, kg.
    pub mass: f32,
    /// Centre of mass, measured from and expressed in the link frame, m.
    pub com: Vector3<f32>,
    /// Inertia tensor about the centre of mass, expressed in the link frame, kg·m²; tensor entries, Ixy = −∫ x y dm.
    pub inertia_com: Matrix3<f32>,
}

impl LinkInertia {
    /// Nothing: no mass, no inertia.
    pub const NONE: Self = Self {
        mass: 0.0,
        com: Vector3::new(0.0, 0.0, 0.0),
        inertia_com: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    /// Standard parameters about the origin of the link frame, in the order of eq. 14.
    ///
    /// Parallel axes: `I_o = I_c + m (c·c 1 − c cᵀ)`.
    pub fn standard_parameters(&self) -> [f32; LINK_PARAMETERS] {
        let (m, c) = (self.mass, self.com);
        let i = self.inertia_com + (Matrix3::identity() * c.dot(&c) - c * c.transpose()) * m;
        let first = c * m;
        [
            m, first.x, first.y, first.z, i.m11, i.m22, i.m33, i.m12, i.m13, i.m23,
        ]
    }
}

/// Base parameters of an arm from its links and the rotor inertias reflected to the link side (kg·m²).
///
/// beta = B·x with the constant map of the arm (eq. 16).
///
/// ```
/// use foretorque::arm::{LinkInertia, base_parameters, ur5::Ur5};
/// // What a rotor of 1 kg·m² on the last joint is to the base set: its own, last parameter.
/// let rotors = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
/// let beta = base_parameters::<Ur5, 6, 40>(&[LinkInertia::NONE; 6], &rotors);
/// assert_eq!(beta[39], 1.0);
/// ```
///
/// Cost: 10 N parallel-axis terms and one multiply-add for each entry of the map; not for the tick.
pub fn base_parameters<A: Arm<N, P>, const N: usize, const P: usize>(
    links: &[LinkInertia; N],
    rotor_inertias: &[f32; N],
) -> SVector<f32, P> {
    let standard = links.map(|link| link.standard_parameters());
    let mut beta = SVector::zeros();
    for term in A::base_map() {
        let value = match term.standard.checked_sub(LINK_PARAMETERS * N) {
            Some(joint) => rotor_inertias[joint],
            None => standard[term.standard / LINK_PARAMETERS][term.standard % LINK_PARAMETERS],
        };
        beta[term.base] += term.weight * value;
    }
    beta
}
