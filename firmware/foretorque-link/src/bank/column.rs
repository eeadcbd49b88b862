use core::fmt;
use foretorque::arm::Arm;
use foretorque::dynamics::FRICTION_COLUMNS;
use serde::{Deserialize, Serialize};

/// What a column of the linear model multiplies. Kinds are only ever appended: their index is what a bank holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ColumnKind {
    /// Mass, kg.
    M,
    /// First moment about y–z, m·x, kg·m.
    Mx,
    /// First moment m·y, kg·m.
    My,
    /// First moment m·z, kg·m.
    Mz,
    /// Moment of inertia about x, kg·m².
    Ixx,
    /// Moment of inertia about y, kg·m².
    Iyy,
    /// Moment of inertia about z, kg·m².
    Izz,
    /// Tensor entry, kg·m².
    Ixy,
    /// Tensor entry, kg·m².
    Ixz,
    /// Tensor entry, kg·m².
    Iyz,
    /// Reflected rotor inertia, kg·m².
    Ia,
    /// Viscous friction, N·m·s/rad.
    Fv,
    /// Coulomb friction, N·m.
    Fc,
    /// Stribeck peak of 0.07 rad/s, N·m; no board has it any more.
    Fsn,
    /// Stribeck peak of 0.14 rad/s, N·m; no board has it any more.
    Fsw,
    /// Constant torque of the drive, N·m.
    Fo,
    /// Cogging in phase with the sine, N·m.
    Gs,
    /// Cogging in phase with the cosine, N·m.
    Gc,
    /// Stribeck peak, N·m.
    Fs,
    /// Bend of friction at low speed, N·m.
    Fb,
    /// Friction for each unit of load.
    Fl,
}

impl ColumnKind {
    /// The standard parameters of a link in the order of eq. 14.
    const INERTIAL: [Self; foretorque::arm::LINK_PARAMETERS] = [
        Self::M,
        Self::Mx,
        Self::My,
        Self::Mz,
        Self::Ixx,
        Self::Iyy,
        Self::Izz,
        Self::Ixy,
        Self::Ixz,
        Self::Iyz,
    ];

    /// The friction columns of a joint in the order of [`foretorque::dynamics::friction_row`].
    pub(super) const FRICTION: [Self; FRICTION_COLUMNS] = [
        Self::Fv,
        Self::Fc,
        Self::Fs,
        Self::Fb,
        Self::Fl,
        Self::Fo,
        Self::Gs,
        Self::Gc,
    ];

    const fn symbol(self) -> &'static str {
        match self {
            Self::M => "m",
            Self::Mx => "mx",
            Self::My => "my",
            Self::Mz => "mz",
            Self::Ixx => "Ixx",
            Self::Iyy => "Iyy",
            Self::Izz => "Izz",
            Self::Ixy => "Ixy",
            Self::Ixz => "Ixz",
            Self::Iyz => "Iyz",
            Self::Ia => "Ia",
            Self::Fv => "Fv",
            Self::Fc => "Fc",
            Self::Fsn => "Fsn",
            Self::Fsw => "Fsw",
            Self::Fo => "Fo",
            Self::Gs => "Gs",
            Self::Gc => "Gc",
            Self::Fs => "Fs",
            Self::Fb => "Fb",
            Self::Fl => "Fl",
        }
    }
}

/// Identity of a column: what, and of which joint (from 0). Displayed as `Izz1`, `mx2`, `Ia3`, `Fv1`: joints from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ColumnId {
    /// What the column multiplies.
    pub kind: ColumnKind,
    /// Joint or link, from 0.
    pub joint: u8,
}

impl fmt::Display for ColumnId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.kind.symbol(), u16::from(self.joint) + 1)
    }
}

/// The base columns of an arm in their order: inertial ones link by link, then rotor inertias.
pub fn rigid_columns<A: Arm<N, P>, const N: usize, const P: usize>()
-> impl Iterator<Item = ColumnId> {
    let links = A::COLUMNS
        .into_iter()
        .enumerate()
        .flat_map(|(joint, link)| {
            let kinds = ColumnKind::INERTIAL.into_iter().zip(link.inertial);
            kinds.filter_map(move |(kind, there)| there.then_some(id(kind, joint)))
        });
    let rotors = A::COLUMNS.into_iter().enumerate();
    links.chain(rotors.filter_map(|(joint, link)| link.rotor.then_some(id(ColumnKind::Ia, joint))))
}

pub(super) fn id(kind: ColumnKind, joint: usize) -> ColumnId {
    ColumnId {
        kind,
        joint: joint as u8,
    }
}
