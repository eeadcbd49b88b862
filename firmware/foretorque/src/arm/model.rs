//! Constants of an arm as one value; base parameters from the figures of a data sheet.

use super::{Arm, BaseTerm, JointLimits, LINK_PARAMETERS, LinkColumns, Placement, identity};
use crate::dynamics::BaseParameters;
use nalgebra::{Matrix3, SVector, Vector3};

/// Most base parameters of an arm of `joints` revolute joints, rounded up to a multiple of 4, because the learner updates
/// its covariance in blocks of four columns.
///
/// 7 a link but 3 of the first, and all rotors but the first: where gravity does not run along the first axis, its link
/// has two first moments beside Izz [Gautier and Khalil 1990], and the first rotor joins Izz of its link.
pub const fn most_parameters(joints: usize) -> usize {
    (8 * joints - 5).next_multiple_of(4)
}

/// Constants of an arm: the fields are those of [`Arm`](super::Arm).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmModel<const N: usize, const P: usize> {
    /// Name of the arm, as in its description file.
    pub name: &'static str,
    /// Acceleration of gravity, expressed in the base frame, 3 × m/s².
    pub gravity: [f32; 3],
    /// Placement of every joint.
    pub placements: [Placement; N],
    /// Standard parameters that form the base set.
    pub columns: [LinkColumns; N],
    /// Place of every standard parameter in the base set.
    pub index: BaseIndex<N>,
    /// The map from standard to base parameters.
    pub base_map: &'static [BaseTerm],
    /// Data-sheet limits.
    pub limits: [JointLimits; N],
    /// Cogging periods of each joint in one of its turns; 0 where the drive has none.
    pub cogging_cycles: [f32; N],
    /// Step of the coarsest encoder, rad of its joint.
    pub encoder_step: f32,
    /// Base parameters of the description; zero beyond [`BaseIndex::count`].
    pub nominal: BaseParameters<P>,
    /// Standard parameters of each link.
    pub links: [[f32; LINK_PARAMETERS]; N],
    /// Rotor inertias reflected to the link side, kg·m².
    pub rotors: [f32; N],
}

impl<const N: usize, const P: usize> ArmModel<N, P> {
    /// [`Arm::HASH`](super::Arm::HASH) of this arm.
    pub const fn hash(&self) -> u32 {
        identity(&self.gravity, &self.placements, &self.columns)
    }
}

/// Place of every standard parameter in the base set: link parameters, link by link, then rotor inertias.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BaseIndex<const N: usize> {
    /// Base index of each link parameter; those that are not in the base set are zero in every torque.
    pub link: [[Option<usize>; LINK_PARAMETERS]; N],
    /// Base index of each rotor inertia.
    pub rotor: [Option<usize>; N],
    /// Number of base parameters.
    pub count: usize,
}

impl<const N: usize> BaseIndex<N> {
    /// The places by the flags of every link.
    pub const fn of(columns: &[LinkColumns; N]) -> Self {
        assert!(N <= crate::dynamics::MAX_JOINTS, "too many joints");
        let mut index = Self {
            link: [[None; LINK_PARAMETERS]; N],
            rotor: [None; N],
            count: 0,
        };
        let mut link = 0;
        while link < N {
            let mut k = 0;
            while k < LINK_PARAMETERS {
                if columns[link].inertial[k] {
                    index.link[link][k] = Some(index.count);
                    index.count += 1;
                }
                k += 1;
            }
            link += 1;
        }
        let mut joint = 0;
        while joint < N {
            if columns[joint].rotor {
                index.rotor[joint] = Some(index.count);
                index.count += 1;
            }
            joint += 1;
        }
        index
    }

    /// This index, of `parameters` base parameters.
    pub(super) const fn counted(self, parameters: usize) -> Self {
        assert!(
            self.count == parameters,
            "P must be the number of base parameters of the arm"
        );
        self
    }
}

/// `table!(A, f)`: `f(&model)` of the arm `A`, computed while compiling if the arm is compiled.
macro_rules! table {
    ($arm:ty, $table:expr) => {
        match const {
            match <$arm>::COMPILED {
                Some(ref model) => Some($table(model)),
                None => None,
            }
        } {
            Some(table) => table,
            None => $table(<$arm>::model()),
        }
    };
}
pub(crate) use table;

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
