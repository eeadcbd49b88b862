//! A serial arm of revolute joints as the board sees it: constants of geometry, base-parameter map and limits.

mod identity;
mod model;
pub mod panda;
mod standard;
pub mod ur5;

pub use identity::identity;
pub(crate) use model::table;
pub use model::{ArmModel, BaseIndex, most_parameters};
pub use standard::{LinkInertia, base_parameters};

use crate::dynamics::BaseParameters;
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
    /// [`NOMINAL`](Self::NOMINAL).
    #[inline(always)]
    fn nominal() -> &'static BaseParameters<P> {
        const { &BaseParameters::from_array_storage(ArrayStorage([Self::NOMINAL])) }
    }
}
