//! Friction terms of the linear model, and choices of them.

use crate::Refusal;
use foretorque::dynamics::FrictionColumn;
use std::fmt;
use std::str::FromStr;

/// One friction term of a joint, linear in its parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrictionTerm {
    /// A column of the board. `Load` is absent where gravity never moves the joint.
    Board(FrictionColumn),
    /// `tanh(qd / SIGN_WIDTH) sqrt|qd|`
    Root,
    /// `qd³`
    Cubic,
    /// `qd t`, t since the start of the log: viscous friction that changes as the drive warms up
    WarmUp,
}

use FrictionTerm::*;

impl FrictionTerm {
    /// Symbol, as in a parameter bank, and unit of the parameter.
    pub(super) fn symbol_and_unit(self) -> (&'static str, &'static str) {
        match self {
            Board(column) => (column.properties().symbol, column.properties().unit),
            Root => ("Fr", "N·m·(s/rad)^0.5"),
            Cubic => ("F3", "N·m·(s/rad)^3"),
            WarmUp => ("Fvt", "N·m/rad"),
        }
    }

    /// Viscous or Coulomb friction, which every drive has.
    pub(super) fn is_plain(self) -> bool {
        matches!(
            self,
            Board(FrictionColumn::Viscous | FrictionColumn::Coulomb)
        )
    }
}

pub(super) const LOAD: FrictionTerm = Board(FrictionColumn::Load);

/// A choice of friction terms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnSet(pub(super) Vec<FrictionTerm>);

/// Order of the column sets, and so of the columns.
const ORDER: [&str; 8] = [
    "coulomb-viscous",
    "offset",
    "stribeck",
    "sqrt",
    "cubic",
    "load",
    "cogging",
    "warm-up",
];

/// Names of the column sets with their terms: sets of the board's columns, and those of the host.
fn sets() -> Vec<(&'static str, Vec<FrictionTerm>)> {
    let mut sets = Vec::from(ORDER.map(|name| (name, Vec::new())));
    let board = FrictionColumn::ALL.map(|column| (column.properties().set, Board(column)));
    let host = [("sqrt", Root), ("cubic", Cubic), ("warm-up", WarmUp)];
    for (set, term) in board.into_iter().chain(host) {
        match sets.iter_mut().find(|(name, _)| *name == set) {
            Some((_, terms)) => terms.push(term),
            None => sets.push((set, vec![term])),
        }
    }
    sets
}

impl FromStr for ColumnSet {
    type Err = Refusal;

    /// `coulomb-viscous`, and any of the other words after it, joined by `+`; or `full` for all of them.
    fn from_str(text: &str) -> Result<Self, Refusal> {
        let mut set = Self::plain();
        for word in text.split('+').map(str::trim) {
            let known = sets().into_iter();
            let known = known.filter(|(name, _)| [*name, "full"].contains(&word));
            let found: Vec<FrictionTerm> = known.flat_map(|(_, terms)| terms).collect();
            if found.is_empty() {
                let names: Vec<&str> = sets().iter().map(|(name, _)| *name).collect();
                let names = names.join(", ");
                return Err(Refusal(format!(
                    "unknown column set '{word}': join any of {names} by '+', or take full for all"
                )));
            }
            for term in found {
                if !set.0.contains(&term) {
                    set.0.push(term);
                }
            }
        }
        Ok(set)
    }
}

impl Default for ColumnSet {
    /// The columns that real arms need. Without load friction, torques of arms with much of it seem early.
    fn default() -> Self {
        let chosen = ["coulomb-viscous", "offset", "stribeck", "load"];
        let sets = sets().into_iter();
        let sets = sets.filter(|(name, _)| chosen.contains(name));
        Self(sets.flat_map(|(_, terms)| terms).collect())
    }
}

impl ColumnSet {
    /// Viscous and Coulomb friction.
    pub fn plain() -> Self {
        let terms = FrictionColumn::ALL.map(Board).into_iter();
        Self(terms.filter(|term| term.is_plain()).collect())
    }

    /// The part of it that the board has, and the words for the rest.
    pub fn on_board(&self) -> (Self, Vec<&'static str>) {
        let (known, other) = self.0.iter().partition(|term| matches!(term, Board(_)));
        (Self(known), Self(other).words())
    }

    fn words(&self) -> Vec<&'static str> {
        let sets = sets().into_iter();
        let chosen = sets.filter(|(_, terms)| self.0.contains(&terms[0]));
        chosen.map(|(name, _)| name).collect()
    }
}

impl fmt::Display for ColumnSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words().join("+"))
    }
}
