//! A serial arm of revolute joints as the board has it: constants of geometry, base-parameter map and limits; base
//! parameters from the figures of a data sheet.

pub mod panda;
pub mod ur5;

use crate::dynamics::BaseParameters;
use nalgebra::{ArrayStorage, Matrix3, SVector, Vector3};

/// Constant placement of a joint frame in its parent frame, before the joint turns it about its own z axis.
///
/// Craig 2005, section 3.4: `T = Rx(alpha) Tx(a) Tz(d)` is the special case that a DH table gives; a URDF joint origin
/// is the general one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Rotation that maps coordinates of the joint frame at q = 0 into the parent frame, row by row.
    pub rot_parent_child: [[f32; 3]; 3],
    /// Origin of the joint frame, expressed in the parent frame, 3 × m.
    pub origin: [f32; 3],
}

/// Limits of one joint from the data sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Lower and upper end of the joint's range, rad.
    pub position: (f32, f32),
    /// Largest speed, rad/s.
    pub velocity: f32,
    /// Largest torque, N·m.
    pub torque: f32,
}

/// Number of standard inertial parameters of a link (eq. 14): m, m·x, m·y, m·z, Ixx, Iyy, Izz, Ixy, Ixz, Iyz.
pub const LINK_PARAMETERS: usize = 10;

/// Which standard parameters of one link belong to the base set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkColumns {
    /// One flag for each standard parameter, in the order of eq. 14.
    pub inertial: [bool; LINK_PARAMETERS],
    /// The joint's reflected rotor inertia is a base parameter of its own.
    pub rotor: bool,
}

/// One non-zero entry of the map from standard to base parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseTerm {
    /// Index of the base parameter.
    pub base: usize,
    /// Index of the standard parameter: `10 * link + k` for link parameters, `10 * N + joint` for rotor inertias.
    pub standard: usize,
    /// Weight of the standard parameter in the base parameter.
    pub weight: f32,
}

impl BaseTerm {
    /// One entry, for tables.
    pub const fn new(base: usize, standard: usize, weight: f32) -> Self {
        Self {
            base,
            standard,
            weight,
        }
    }
}

/// Constants of an arm with `N` revolute joints and `P` base parameters (rotor inertias after the links).
///
/// A compiled arm implements the constants, and everything that follows from them is settled while compiling. An arm
/// that a program reads while it runs has [`COMPILED`](Self::COMPILED) `None`, implements the functions, and may leave
/// base parameters at the end unused. Both give the same bits.
pub trait Arm<const N: usize, const P: usize>: 'static {
    /// Name of the arm, as in its description file.
    const NAME: &'static str;
    /// Identity of geometry and base-parameter set; both sides of a link compare it.
    const HASH: u32 = identity(&Self::GRAVITY, &Self::PLACEMENTS, &Self::COLUMNS);
    /// Acceleration of gravity, expressed in the base frame, 3 × m/s².
    const GRAVITY: [f32; 3];
    /// Placement of every joint.
    const PLACEMENTS: [Placement; N];
    /// Which standard parameters form the base set: the first independent columns from left to right.
    const COLUMNS: [LinkColumns; N];
    /// The map from standard to base parameters.
    const BASE_MAP: &'static [BaseTerm];
    /// Data-sheet limits.
    const LIMITS: [JointLimits; N];
    /// Cogging periods of each joint in one of its turns; 0 where the drive has none. No part of [`HASH`](Self::HASH).
    const COGGING_CYCLES: [f32; N] = [0.0; N];
    /// Step of the coarsest encoder, rad of its joint; 0 if it is too small to matter. No part of [`HASH`](Self::HASH).
    const ENCODER_STEP: f32 = 0.0;
    /// Base parameters of the description.
    const NOMINAL: [f32; P];
    /// Standard parameters of each link of the description, in its own frame (eq. 14).
    const LINKS: [[f32; LINK_PARAMETERS]; N];
    /// Rotor inertias of the description, reflected to the link side, kg·m².
    const ROTORS: [f32; N];

    /// All constants as a value; `None` where the arm is read while the program runs.
    const COMPILED: Option<ArmModel<N, P>> = Some(ArmModel {
        name: Self::NAME,
        gravity: Self::GRAVITY,
        placements: Self::PLACEMENTS,
        columns: Self::COLUMNS,
        index: BaseIndex::of(&Self::COLUMNS),
        base_map: Self::BASE_MAP,
        limits: Self::LIMITS,
        cogging_cycles: Self::COGGING_CYCLES,
        encoder_step: Self::ENCODER_STEP,
        nominal: BaseParameters::from_array_storage(ArrayStorage([Self::NOMINAL])),
        links: Self::LINKS,
        rotors: Self::ROTORS,
    });

    /// All constants of the arm.
    fn model() -> &'static ArmModel<N, P> {
        const { Self::COMPILED.as_ref().expect("a compiled arm") }
    }
    /// [`NAME`](Self::NAME).
    #[inline(always)]
    fn name() -> &'static str {
        Self::NAME
    }
    /// [`HASH`](Self::HASH).
    #[inline(always)]
    fn hash() -> u32 {
        Self::HASH
    }
    /// [`GRAVITY`](Self::GRAVITY).
    #[inline(always)]
    fn gravity() -> &'static [f32; 3] {
        const { &Self::GRAVITY }
    }
    /// [`PLACEMENTS`](Self::PLACEMENTS).
    #[inline(always)]
    fn placements() -> &'static [Placement; N] {
        const { &Self::PLACEMENTS }
    }
    /// [`COLUMNS`](Self::COLUMNS).
    #[inline(always)]
    fn columns() -> &'static [LinkColumns; N] {
        const { &Self::COLUMNS }
    }
    /// Place of every standard parameter in the base set.
    #[inline(always)]
    fn index() -> &'static BaseIndex<N> {
        const {
            assert!(
                BaseIndex::of(&Self::COLUMNS).count == P,
                "P must be the number of base parameters of the arm"
            );
            &BaseIndex::of(&Self::COLUMNS)
        }
    }
    /// [`BASE_MAP`](Self::BASE_MAP).
    #[inline(always)]
    fn base_map() -> &'static [BaseTerm] {
        Self::BASE_MAP
    }
    /// [`LIMITS`](Self::LIMITS).
    #[inline(always)]
    fn limits() -> &'static [JointLimits; N] {
        const { &Self::LIMITS }
    }
    /// [`COGGING_CYCLES`](Self::COGGING_CYCLES).
    #[inline(always)]
    fn cogging_cycles() -> &'static [f32; N] {
        const { &Self::COGGING_CYCLES }
    }
    /// [`ENCODER_STEP`](Self::ENCODER_STEP).
    #[inline(always)]
    fn encoder_step() -> f32 {
        Self::ENCODER_STEP
    }
    /// [`NOMINAL`](Self::NOMINAL).
    #[inline(always)]
    fn nominal() -> &'static BaseParameters<P> {
        const { &BaseParameters::from_array_storage(ArrayStorage([Self::NOMINAL])) }
    }
}

/// FNV-1a (32 bit) over the number of joints, gravity, every placement and the base-parameter set.
///
/// Parameters of one arm mean nothing on another; masses and limits may differ, so they are left out. One column means
/// something else with other masses: friction for each unit of load is for a load by the description
/// ([`crate::dynamics::friction_load`]).
pub const fn identity<const N: usize>(
    gravity: &[f32; 3],
    placements: &[Placement; N],
    columns: &[LinkColumns; N],
) -> u32 {
    let mut hash = fnv1a(0x811C_9DC5, N as u32);
    hash = vector(hash, gravity);
    let mut joint = 0;
    while joint < N {
        let mut row = 0;
        while row < 3 {
            hash = vector(hash, &placements[joint].rot_parent_child[row]);
            row += 1;
        }
        hash = vector(hash, &placements[joint].origin);
        let mut flags = columns[joint].rotor as u32;
        let mut k = 0;
        while k < columns[joint].inertial.len() {
            flags = 2 * flags + columns[joint].inertial[k] as u32;
            k += 1;
        }
        hash = fnv1a(hash, flags);
        joint += 1;
    }
    hash
}

const fn vector(mut hash: u32, values: &[f32; 3]) -> u32 {
    let mut k = 0;
    while k < values.len() {
        hash = fnv1a(hash, values[k].to_bits());
        k += 1;
    }
    hash
}

const fn fnv1a(mut hash: u32, word: u32) -> u32 {
    let bytes = word.to_le_bytes();
    let mut k = 0;
    while k < bytes.len() {
        hash = (hash ^ bytes[k] as u32).wrapping_mul(0x0100_0193);
        k += 1;
    }
    hash
}

/// Most base parameters of an arm of `joints` revolute joints, rounded up to a multiple of 4, because the learner updates
/// its covariance in blocks of four columns.
///
/// 7 a link but 3 of the first, and all rotors but the first: where gravity does not run along the first axis, its link
/// has two first moments beside Izz [Gautier and Khalil 1990], and the first rotor joins Izz of its link.
pub const fn most_parameters(joints: usize) -> usize {
    (8 * joints - 5).next_multiple_of(4)
}

/// Constants of an arm: the fields are those of [`Arm`].
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
    /// [`Arm::HASH`] of this arm.
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
