//! Columns of the linear model: base parameters, rotor inertias, and a choice of friction terms.

use crate::Refusal;
use crate::dynamics::{Motion, PerJoint, RigidBodies};
use crate::robot::{LINK_PARAMETERS, Robot};
use foretorque::dynamics::{COGGING_COLUMNS, FrictionColumn, FrictionPoint};
use nalgebra::{DMatrix, DVector};
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
    /// Symbol as in a parameter bank, and unit of the parameter.
    fn symbol_and_unit(self) -> (&'static str, &'static str) {
        match self {
            Board(column) => (column.properties().symbol, column.properties().unit),
            Root => ("Fr", "N·m·(s/rad)^0.5"),
            Cubic => ("F3", "N·m·(s/rad)^3"),
            WarmUp => ("Fvt", "N·m/rad"),
        }
    }

    /// Name of its column set.
    fn set(self) -> &'static str {
        match self {
            Board(column) => column.properties().set,
            Root => "sqrt",
            Cubic => "cubic",
            WarmUp => "warm-up",
        }
    }

    /// All terms of the column sets that are `wanted`, in the order of the columns.
    pub(super) fn of_sets(wanted: impl Fn(&str) -> bool) -> Vec<Self> {
        let mut terms = FrictionColumn::ALL.map(Board).to_vec();
        terms.extend([Root, Cubic, WarmUp]);
        terms.retain(|term| wanted(term.set()));
        terms.sort_by_key(|term| ORDER.iter().position(|name| *name == term.set()));
        terms
    }

    /// Viscous or Coulomb friction, which every drive has.
    pub(super) fn is_plain(self) -> bool {
        matches!(
            self,
            Board(FrictionColumn::Viscous | FrictionColumn::Coulomb)
        )
    }
}

const LOAD: FrictionTerm = Board(FrictionColumn::Load);

/// A choice of friction terms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnSet(pub(super) Vec<FrictionTerm>);

/// Names of the column sets in the order of the columns.
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

impl FromStr for ColumnSet {
    type Err = Refusal;

    /// `coulomb-viscous`, and any of the other words after it, joined by `+`; or `full` for all of them.
    fn from_str(text: &str) -> Result<Self, Refusal> {
        let mut set = Self::plain();
        for word in text.split('+').map(str::trim) {
            let known = |set: &str| [set, "full"].contains(&word);
            let found = FrictionTerm::of_sets(known);
            if found.is_empty() {
                let names = ORDER.join(", ");
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
        Self(FrictionTerm::of_sets(|set| chosen.contains(&set)))
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
        let is_there = |set: &&str| self.0.iter().any(|term| term.set() == *set);
        ORDER.into_iter().filter(is_there).collect()
    }
}

impl fmt::Display for ColumnSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words().join("+"))
    }
}

/// Speed at which the smoothed sign of the Coulomb column has reached 76 %, rad/s, as on the board.
pub(super) const SIGN_WIDTH_RAD_S: f64 = foretorque::dynamics::SIGN_WIDTH as f64;

/// One parameter of the linear model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Name as in a parameter bank, joints from 1.
    pub name: String,
    /// Unit.
    pub unit: &'static str,
    /// Friction term and joint, if it is one.
    pub friction: Option<(FrictionTerm, usize)>,
}

impl Parameter {
    /// Viscous or Coulomb friction in a description; none of another parameter.
    pub(super) fn plain_friction(&self, robot: &Robot) -> Option<f64> {
        let (term, joint) = self.friction?;
        let friction = &robot.joints[joint].friction;
        match term {
            Board(FrictionColumn::Viscous) => Some(friction.viscous),
            Board(FrictionColumn::Coulomb) => Some(friction.coulomb),
            _ => None,
        }
    }
}

/// Order of the parameters, and the columns of each joint's equation.
#[derive(Clone, Debug)]
pub struct Layout {
    /// All parameters: base set, then friction joint by joint.
    pub parameters: Vec<Parameter>,
    /// Number of base parameters, which come first.
    pub base: usize,
    /// Parameters in each joint's equation: those of its own and later links, its own rotor and friction.
    pub active: Vec<Vec<usize>>,
    /// First entry of each joint in a row of all joints: active columns, then sine and cosine of the cogging phase.
    pub offset: Vec<usize>,
    /// Length of that row.
    pub width: usize,
    /// Friction terms of each joint.
    friction: Vec<Vec<FrictionTerm>>,
    /// Standard parameter behind each base parameter.
    standard: Vec<usize>,
    model: RigidBodies,
    cogging: PerJoint<f64>,
    /// Prior of every parameter on the board, 1/variance; 0 for those that every arm has.
    precision: Vec<f64>,
}

impl Layout {
    /// The layout for a robot.
    pub fn new(robot: &Robot, set: &ColumnSet) -> Self {
        const LEAST_NM: f64 = 1e-9;
        const SYMBOLS: [&str; LINK_PARAMETERS] = [
            "m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz",
        ];
        let model = RigidBodies::new(robot);
        let joints = model.joints();
        let standard = robot.base_map().columns;
        let mut parameters = Vec::new();
        let mut active = vec![Vec::new(); joints];
        for (place, &column) in standard.iter().enumerate() {
            let (link, kind) = (column / LINK_PARAMETERS, column % LINK_PARAMETERS);
            let (first, last, symbol, unit) = match (link < joints, kind) {
                (true, 0) => (0, link, SYMBOLS[kind], "kg"),
                (true, 1..=3) => (0, link, SYMBOLS[kind], "kg·m"),
                (true, _) => (0, link, SYMBOLS[kind], "kg·m²"),
                (false, _) => {
                    let joint = column - LINK_PARAMETERS * joints;
                    (joint, joint, "Ia", "kg·m²")
                }
            };
            let coupling = robot.coupling.as_ref();
            let loads = |joint: usize, drive: usize| match coupling {
                Some(coupling) if column < LINK_PARAMETERS * joints => coupling.loads(joint, drive),
                _ => joint == drive,
            };
            for (drive, seen) in active.iter_mut().enumerate() {
                if (first..=last).any(|joint| loads(joint, drive)) {
                    seen.push(place);
                }
            }
            parameters.push(Parameter {
                name: format!("{symbol}{}", last + 1),
                unit,
                friction: None,
            });
        }
        let gravity = model.largest_gravity_torques();
        // A column that is always zero drops out: load of an upright axis, cogging of a drive without cycles.
        let cogging = PerJoint::from_fn(joints, |joint| {
            robot.joints[joint].friction.cogging_cycles_rev
        });
        let mut friction: Vec<Vec<FrictionTerm>> = Vec::new();
        for (joint, active) in active.iter_mut().enumerate() {
            let mut shown = set.0.clone();
            shown.retain(|&term| match term {
                LOAD => gravity[joint] > LEAST_NM,
                Board(column) => cogging[joint] > 0.0 || !COGGING_COLUMNS.contains(&column),
                _ => true,
            });
            for &term in &shown {
                let (symbol, unit) = term.symbol_and_unit();
                active.push(parameters.len());
                parameters.push(Parameter {
                    name: format!("{symbol}{}", joint + 1),
                    unit,
                    friction: Some((term, joint)),
                });
            }
            friction.push(shown);
        }
        let precision = parameters.iter().map(|parameter| match parameter.friction {
            Some((term @ Board(column), joint)) if !term.is_plain() => {
                let limits = robot.joints[joint].limits.of_board();
                f64::from(column.properties().prior.deviation(&limits)).powi(-2)
            }
            _ => 0.0,
        });
        let mut width = 0;
        let offset = active.iter().map(|active| {
            let offset = width;
            width += active.len() + 2;
            offset
        });
        Self {
            offset: offset.collect(),
            precision: precision.collect(),
            parameters,
            base: standard.len(),
            active,
            width,
            friction,
            standard,
            model,
            cogging,
        }
    }

    /// Adds the board's prior of friction beyond viscous and Coulomb to weighted equations: a column that the motion hardly
    /// shows stays at zero.
    pub(super) fn add_prior(&self, gram: &mut DMatrix<f64>) {
        for (place, precision) in self.precision.iter().enumerate() {
            gram[(place, place)] += precision;
        }
    }

    /// Words for the friction columns that a description holds in part or not at all: it has no offset and no load friction,
    /// and cogging of one phase.
    pub(super) fn undescribed(&self) -> Vec<&'static str> {
        use FrictionColumn::{CoggingSine, Coulomb, ShearThinning, Stribeck, Viscous};
        let described = [Viscous, Coulomb, Stribeck, ShearThinning, CoggingSine].map(Board);
        let terms = self.friction.iter().flatten().copied();
        ColumnSet(terms.filter(|term| !described.contains(term)).collect()).words()
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.active.len()
    }

    /// Places in this layout of the parameters of a poorer layout of the same robot.
    pub fn places_of(&self, poorer: &Self) -> Vec<usize> {
        let place = |name: &String| self.parameters.iter().position(|own| own.name == *name);
        let wanted = poorer.parameters.iter().map(|parameter| &parameter.name);
        wanted.filter_map(place).collect()
    }

    /// Active columns of `joint` in a row of all joints.
    pub(super) fn columns<'r>(&self, joint: usize, row: &'r [f64]) -> &'r [f64] {
        &row[self.offset[joint]..][..self.active[joint].len()]
    }

    /// Active columns of `joint` in a row of all joints, and behind them `[sin(z q), cos(z q)]`, z the cogging cycles a turn;
    /// zero where the description gives none.
    pub(super) fn columns_and_cogging<'r>(&self, joint: usize, row: &'r [f64]) -> &'r [f64] {
        &row[self.offset[joint]..][..self.active[joint].len() + 2]
    }

    /// Torque of the linear model at `joint` from its active columns, N·m.
    pub(super) fn torque(&self, joint: usize, columns: &[f64], theta: &DVector<f64>) -> f64 {
        let pairs = columns.iter().zip(&self.active[joint]);
        pairs.map(|(x, &place)| x * theta[place]).sum()
    }

    /// Torque of the linear model and of cogging at `joint`, N·m.
    ///
    /// * `columns` with cogging; `amplitudes` of sine and cosine, N·m
    pub(super) fn torque_with_cogging(
        &self,
        joint: usize,
        columns: &[f64],
        theta: &DVector<f64>,
        amplitudes: [f64; 2],
    ) -> f64 {
        let cogging = columns[self.active[joint].len()..].iter().zip(amplitudes);
        let cogging: f64 = cogging.map(|(x, amplitude)| x * amplitude).sum();
        self.torque(joint, columns, theta) + cogging
    }

    /// Appends the row of all joints at `motion` to `table`.
    ///
    /// * `age_s` time since the start of the log
    /// * `scratch` N × 11 N matrix, zero at first; entries that are always zero are never written.
    pub fn append_row(
        &self,
        motion: &Motion,
        age_s: f64,
        scratch: &mut DMatrix<f64>,
        table: &mut Vec<f64>,
    ) {
        self.model.regressor_into(motion, scratch, 0);
        let load = if self.friction.iter().any(|terms| terms.contains(&LOAD)) {
            self.model.gravity_torques(&motion.q)
        } else {
            PerJoint::repeat(self.joints(), 0.0)
        };
        for (joint, friction) in self.friction.iter().enumerate() {
            let (q, qd) = (motion.q[joint], motion.qd[joint]);
            let active = &self.active[joint];
            let inertial = active[..active.len() - friction.len()].iter();
            table.extend(inertial.map(|&place| scratch[(joint, self.standard[place])]));
            let (cogging_sin, cogging_cos) = match self.cogging[joint] {
                cycles if cycles > 0.0 => (cycles * q).sin_cos(),
                _ => (0.0, 0.0),
            };
            let point = FrictionPoint {
                qd,
                sign: (qd / SIGN_WIDTH_RAD_S).tanh(),
                load: load[joint],
                cogging_sin,
                cogging_cos,
            };
            let board = point.columns();
            table.extend(friction.iter().map(|term| match term {
                Board(column) => board[*column as usize],
                Root => point.sign * qd.abs().sqrt(),
                Cubic => qd.powi(3),
                WarmUp => qd * age_s,
            }));
            table.extend([cogging_sin, cogging_cos]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_set_has_a_place() {
        for term in FrictionTerm::of_sets(|_| true) {
            assert!(ORDER.contains(&term.set()), "{term:?}");
        }
    }

    #[test]
    fn cogging_of_drives_without_cycles_has_no_columns() {
        let full = "full".parse::<ColumnSet>().expect("known word");
        for (name, columns) in [("panda", 0), ("ur5", 12)] {
            let layout = Layout::new(&Robot::load(name).expect("built in"), &full);
            let terms = layout.parameters.iter().filter_map(|own| own.friction);
            let cogging = COGGING_COLUMNS.map(Board);
            let found = terms.filter(|(term, _)| cogging.contains(term));
            assert_eq!(found.count(), columns, "{name}");
        }
    }

    #[test]
    fn friction_grows_with_the_load_where_gravity_makes_one() {
        let robot = Robot::load("ur5").expect("built in");
        let set = "coulomb-viscous+load"
            .parse::<ColumnSet>()
            .expect("known words");
        let layout = Layout::new(&robot, &set);
        let friction = layout.parameters.iter().filter_map(|p| p.friction);
        let load = friction.filter(|(term, _)| *term == LOAD);
        let joints: Vec<usize> = load.map(|(_, joint)| joint).collect();
        // The first axis stands upright, the last one carries its link in the middle.
        assert_eq!(joints, [1, 2, 3, 4]);

        let state = Motion {
            q: PerJoint::from_fn(6, |joint| 0.3 + joint as f64),
            qd: PerJoint::repeat(6, -1.0),
            qdd: PerJoint::repeat(6, 2.0),
        };
        let (mut row, mut scratch) = (Vec::new(), DMatrix::zeros(6, 66));
        layout.append_row(&state, 0.0, &mut scratch, &mut row);
        assert_eq!(row.len(), layout.width);
        let gravity = layout.model.gravity_torques(&state.q);
        for joint in joints {
            let last = layout.columns(joint, &row).last().expect("not empty");
            assert!((last + gravity[joint].abs()).abs() < 1e-12, "joint {joint}");
        }
    }

    #[test]
    fn the_default_columns_read_back() {
        let columns = ColumnSet::default();
        assert_eq!(columns.to_string(), "coulomb-viscous+offset+stribeck+load");
        assert_eq!(columns.to_string().parse::<ColumnSet>(), Ok(columns));
    }
}
