//! A serial arm of revolute joints as the board sees it: constants of geometry, base-parameter map and limits.

mod model;
pub mod panda;
pub mod ur5;

use crate::dynamics::BaseParameters;
pub(crate) use model::table;
pub use model::{ArmModel, BaseIndex, LinkInertia, base_parameters, most_parameters};
use nalgebra::ArrayStorage;

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
        const { &BaseIndex::of(&Self::COLUMNS).counted(P) }
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
