//! A serial arm of revolute joints as the board sees it: constants of geometry, base-parameter map and limits.

mod identity;
pub mod panda;
mod standard;
pub mod ur5;

pub use identity::identity;
pub use standard::{LinkInertia, base_parameters};

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
}
