use core::fmt;
use foretorque::arm::{Arm, LINK_PARAMETERS};
use foretorque::dynamics::{FRICTION_COLUMNS, FrictionColumn};
use serde::{Deserialize, Serialize};

/// Quantity that a column of the linear model multiplies, as the number that a bank holds.
///
/// 0 to 9 are the standard parameters of a link (eq. 14), 10 is the reflected rotor inertia, the friction columns have
/// [`bank_kind`](foretorque::dynamics::FrictionProperties::bank_kind). Numbers are only ever added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8")]
pub struct ColumnKind(u8);

const LINK_SYMBOLS: [&str; LINK_PARAMETERS] = [
    "m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz",
];
const ROTOR: u8 = LINK_PARAMETERS as u8;
/// Stribeck peaks of 0.07 and 0.14 rad/s: decoded, but no longer in the model.
const RETIRED: [(u8, &str); 2] = [(13, "Fsn"), (14, "Fsw")];

const _: () = {
    let mut k = 0;
    while k < FRICTION_COLUMNS {
        let kind = FrictionColumn::ALL[k].properties().bank_kind;
        assert!(kind > ROTOR && kind != RETIRED[0].0 && kind != RETIRED[1].0);
        k += 1;
    }
};

impl ColumnKind {
    /// Reflected rotor inertia, kg·m².
    pub const ROTOR: Self = Self(ROTOR);

    /// Friction columns of a joint in the order of [`FrictionColumn::ALL`].
    const FRICTION: [Self; FRICTION_COLUMNS] = {
        let mut kinds = [Self::ROTOR; FRICTION_COLUMNS];
        let mut k = 0;
        while k < FRICTION_COLUMNS {
            kinds[k] = Self::friction(FrictionColumn::ALL[k]);
            k += 1;
        }
        kinds
    };

    /// A friction column.
    pub const fn friction(column: FrictionColumn) -> Self {
        Self(column.properties().bank_kind)
    }

    /// Short name; empty for a number that is no kind.
    fn symbol(self) -> &'static str {
        let number = usize::from(self.0);
        let friction = || {
            let place = Self::FRICTION.iter().position(|&kind| kind == self)?;
            Some(FrictionColumn::ALL.get(place)?.properties().symbol)
        };
        let retired = || RETIRED.iter().find(|(kind, _)| *kind == self.0);
        match LINK_SYMBOLS.get(number) {
            Some(symbol) => symbol,
            None if self == Self::ROTOR => "Ia",
            None => friction()
                .or(retired().map(|(_, symbol)| *symbol))
                .unwrap_or(""),
        }
    }
}

/// A number that is no kind of column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoColumnKind;

impl fmt::Display for NoColumnKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no kind of column")
    }
}

impl TryFrom<u8> for ColumnKind {
    type Error = NoColumnKind;

    fn try_from(number: u8) -> Result<Self, NoColumnKind> {
        let kind = Self(number);
        let known = number <= ROTOR
            || Self::FRICTION.contains(&kind)
            || RETIRED.iter().any(|(retired, _)| *retired == number);
        known.then_some(kind).ok_or(NoColumnKind)
    }
}

/// Identity of a column: kind, and joint from 0. Displayed as `Izz1`, `mx2`, `Ia3`, `Fv1`: joints from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ColumnId {
    /// Quantity that the column multiplies.
    pub kind: ColumnKind,
    /// Joint or link, from 0.
    pub joint: u8,
}

impl fmt::Display for ColumnId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.kind.symbol(), u16::from(self.joint) + 1)
    }
}

/// The columns of an arm in their order: inertial ones link by link, rotor inertias, then friction joint by joint.
pub fn columns<A: Arm<N, P>, const N: usize, const P: usize>() -> impl Iterator<Item = ColumnId> {
    let links = A::columns().iter().enumerate().flat_map(|(joint, link)| {
        let kinds = (0..).map(ColumnKind).zip(link.inertial);
        kinds.filter_map(move |(kind, there)| there.then_some(id(kind, joint)))
    });
    let rotors = A::columns().iter().enumerate();
    let rotors =
        rotors.filter_map(|(joint, link)| link.rotor.then_some(id(ColumnKind::ROTOR, joint)));
    let friction = (0..N).flat_map(|joint| ColumnKind::FRICTION.map(|kind| id(kind, joint)));
    links.chain(rotors).chain(friction)
}

const fn id(kind: ColumnKind, joint: usize) -> ColumnId {
    ColumnId {
        kind,
        joint: joint as u8,
    }
}
