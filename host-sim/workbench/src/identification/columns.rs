//! The columns of the linear model: base parameters, rotor inertias, and a choice of friction terms.

use crate::dynamics::{Joints, ReferenceModel, State};
use crate::robot::{LINK_PARAMETERS, Robot};
use nalgebra::DMatrix;
use std::fmt;
use std::str::FromStr;

/// Speed at which the smoothed sign of the Coulomb column has reached 76 %, rad/s: the same as on the board, so that a
/// parameter means the same here and there.
pub(super) const SIGN_WIDTH_RAD_S: f64 = foretorque::dynamics::SIGN_WIDTH as f64;
/// Width of the Stribeck peak, rad/s, as on the board.
const STRIBECK_RAD_S: f64 = 0.09;
/// Speed at which the bend of friction has gone to a half, rad/s, as on the board.
const BEND_RAD_S: f64 = 0.6;

/// One friction term of a joint, linear in its parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrictionColumn {
    /// `qd`
    Viscous,
    /// `tanh(qd / SIGN_WIDTH)`
    Coulomb,
    /// `1`
    Offset,
    /// `tanh(qd / SIGN_WIDTH) exp(−(qd / w)²)` with w = 0.09 rad/s
    Stribeck,
    /// `tanh(qd / SIGN_WIDTH) / (1 + (qd / w)²)` with w = 0.6 rad/s: friction of lubricated drives bends
    Bend,
    /// `tanh(qd / SIGN_WIDTH) sqrt|qd|`
    Root,
    /// `qd³`
    Cubic,
    /// `tanh(qd / SIGN_WIDTH) |G(q)|`, gravity torque of the description; a joint that gravity never moves has no such column
    Load,
    /// `sin(z q)`, z cycles a turn from the description
    CoggingSine,
    /// `cos(z q)`
    CoggingCosine,
    /// `qd t`, t since the start of the log: viscous friction that changes as the drive warms up
    WarmUp,
}

impl FrictionColumn {
    /// The board has this column.
    pub(super) fn on_board(self) -> bool {
        match self {
            Self::Viscous | Self::Coulomb | Self::Stribeck | Self::Bend => true,
            Self::Load | Self::Offset | Self::CoggingSine | Self::CoggingCosine => true,
            Self::Root | Self::Cubic | Self::WarmUp => false,
        }
    }

    /// Short name, as in a parameter bank, and unit of the parameter.
    fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Viscous => ("Fv", "N·m·s/rad"),
            Self::Coulomb => ("Fc", "N·m"),
            Self::Offset => ("Fo", "N·m"),
            Self::Stribeck => ("Fs", "N·m"),
            Self::Bend => ("Fb", "N·m"),
            Self::Root => ("Fr", "N·m·(s/rad)^0.5"),
            Self::Cubic => ("F3", "N·m·(s/rad)^3"),
            Self::Load => ("Fl", "1"),
            Self::CoggingSine => ("Gs", "N·m"),
            Self::CoggingCosine => ("Gc", "N·m"),
            Self::WarmUp => ("Fvt", "N·m/rad"),
        }
    }
}

/// A choice of friction terms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnSet(Vec<FrictionColumn>);

/// Words of a column set and what they stand for.
const WORDS: [(&str, &[FrictionColumn]); 8] = [
    (
        "coulomb-viscous",
        &[FrictionColumn::Viscous, FrictionColumn::Coulomb],
    ),
    ("offset", &[FrictionColumn::Offset]),
    (
        "stribeck",
        &[FrictionColumn::Stribeck, FrictionColumn::Bend],
    ),
    ("sqrt", &[FrictionColumn::Root]),
    ("cubic", &[FrictionColumn::Cubic]),
    ("load", &[FrictionColumn::Load]),
    (
        "cogging",
        &[FrictionColumn::CoggingSine, FrictionColumn::CoggingCosine],
    ),
    ("warm-up", &[FrictionColumn::WarmUp]),
];

impl FromStr for ColumnSet {
    type Err = String;

    /// `coulomb-viscous`, and any of the other words after it, joined by `+`; or `full` for all of them.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut columns: Vec<FrictionColumn> = WORDS[0].1.to_vec();
        for word in text.split('+').map(str::trim) {
            let found: Vec<FrictionColumn> = if word == "full" {
                WORDS
                    .iter()
                    .flat_map(|(_, columns)| *columns)
                    .copied()
                    .collect()
            } else {
                let known = WORDS.iter().find(|(name, _)| *name == word);
                let (_, columns) = known.ok_or_else(|| {
                    let names: Vec<&str> = WORDS.iter().map(|(name, _)| *name).collect();
                    format!(
                        "unknown column set '{word}': join any of {} by '+', or take full for all",
                        names.join(", ")
                    )
                })?;
                columns.to_vec()
            };
            for column in found {
                if !columns.contains(&column) {
                    columns.push(column);
                }
            }
        }
        Ok(Self(columns))
    }
}

impl ColumnSet {
    /// Viscous and Coulomb friction.
    pub fn plain() -> Self {
        Self(WORDS[0].1.to_vec())
    }

    /// The part of it that the board has, and the words for the rest.
    pub fn on_board(&self) -> (Self, Vec<&'static str>) {
        let (known, other): (Vec<_>, Vec<_>) = self.0.iter().partition(|column| column.on_board());
        let words = WORDS
            .iter()
            .filter(|(_, columns)| other.contains(&columns[0]));
        (Self(known), words.map(|(word, _)| *word).collect())
    }

    /// Its terms.
    pub fn columns(&self) -> &[FrictionColumn] {
        &self.0
    }
}

impl fmt::Display for ColumnSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = WORDS
            .iter()
            .filter(|(_, columns)| self.0.contains(&columns[0]));
        let words: Vec<&str> = words.map(|(name, _)| *name).collect();
        f.write_str(&words.join("+"))
    }
}

/// One parameter of the linear model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Name as in a parameter bank, joints from 1.
    pub name: String,
    /// Unit.
    pub unit: &'static str,
    /// Friction term and joint, if it is one.
    pub friction: Option<(FrictionColumn, usize)>,
}

/// Place of every column of the model, and the columns that each joint's torque depends on.
#[derive(Clone, Debug)]
pub struct Layout<const N: usize> {
    /// All parameters: base set, then friction joint by joint.
    pub parameters: Vec<Parameter>,
    /// Number of base parameters, which come first.
    pub base: usize,
    /// Parameters in each joint's equation: those of its own and later links, its own rotor and friction.
    pub active: [Vec<usize>; N],
    /// First entry of each joint in a row of all joints' active columns, and the length of that row.
    pub offset: [usize; N],
    /// Length of that row.
    pub width: usize,
    /// Friction columns of each joint.
    friction: [Vec<FrictionColumn>; N],
    /// Standard parameter behind each base parameter.
    standard: Vec<usize>,
    model: ReferenceModel<N>,
    cogging: [f64; N],
}

/// True for joints that feel gravity in some position: not one whose axis stands upright, nor one that turns a link about its
/// centre of mass.
fn feels_gravity<const N: usize>(model: &ReferenceModel<N>) -> [bool; N] {
    const LEAST_NM: f64 = 1e-9;
    let mut feels = [false; N];
    for position in 0..4 * N {
        let q = Joints::from_fn(|joint, _| 1.0 + (position * (joint + 2)) as f64);
        let torques = model.gravity_torques(&q);
        for (feels, torque) in feels.iter_mut().zip(torques.iter()) {
            *feels |= torque.abs() > LEAST_NM;
        }
    }
    feels
}

impl<const N: usize> Layout<N> {
    /// The layout for a robot; `None` when it has not `N` joints.
    pub fn new(robot: &Robot, set: &ColumnSet) -> Option<Self> {
        const SYMBOLS: [(&str, &str); LINK_PARAMETERS] = [
            ("m", "kg"),
            ("mx", "kg·m"),
            ("my", "kg·m"),
            ("mz", "kg·m"),
            ("Ixx", "kg·m²"),
            ("Iyy", "kg·m²"),
            ("Izz", "kg·m²"),
            ("Ixy", "kg·m²"),
            ("Ixz", "kg·m²"),
            ("Iyz", "kg·m²"),
        ];
        let model = ReferenceModel::<N>::new(robot)?;
        let standard = robot.base_map().columns;
        let base = standard.len();
        let mut parameters = Vec::new();
        let mut active: [Vec<usize>; N] = std::array::from_fn(|_| Vec::new());
        for (place, &column) in standard.iter().enumerate() {
            let (link, (symbol, unit)) = if column < LINK_PARAMETERS * N {
                let link = column / LINK_PARAMETERS;
                for seen in active.iter_mut().take(link + 1) {
                    seen.push(place);
                }
                (link, SYMBOLS[column % LINK_PARAMETERS])
            } else {
                let joint = column - LINK_PARAMETERS * N;
                active[joint].push(place);
                (joint, ("Ia", "kg·m²"))
            };
            parameters.push(Parameter {
                name: format!("{symbol}{}", link + 1),
                unit,
                friction: None,
            });
        }
        let feels_gravity = feels_gravity(&model);
        let friction = feels_gravity.map(|feels| {
            let columns = set.columns().iter().copied();
            columns
                .filter(|&column| feels || column != FrictionColumn::Load)
                .collect::<Vec<_>>()
        });
        for (joint, active) in active.iter_mut().enumerate() {
            for &column in &friction[joint] {
                let (symbol, unit) = column.name();
                active.push(parameters.len());
                parameters.push(Parameter {
                    name: format!("{symbol}{}", joint + 1),
                    unit,
                    friction: Some((column, joint)),
                });
            }
        }
        let mut offset = [0; N];
        let mut width = 0;
        for (offset, active) in offset.iter_mut().zip(&active) {
            *offset = width;
            width += active.len();
        }
        Some(Self {
            parameters,
            base,
            active,
            offset,
            width,
            friction,
            standard,
            model,
            cogging: std::array::from_fn(|joint| robot.joints[joint].friction.cogging_cycles_rev),
        })
    }

    /// Places of the parameters that a poorer layout of the same robot has.
    pub fn places_of(&self, poorer: &Self) -> Vec<usize> {
        let names = poorer.parameters.iter();
        names
            .filter_map(|wanted| {
                self.parameters
                    .iter()
                    .position(|own| own.name == wanted.name)
            })
            .collect()
    }

    /// Widths of the bells `exp(−(qd / w)²)` that have height and area of the Stribeck peak and of the bend, rad/s.
    pub(super) fn bell_widths(&self) -> [f64; 2] {
        [STRIBECK_RAD_S, BEND_RAD_S * std::f64::consts::PI.sqrt()]
    }

    /// `[sin(z q), cos(z q)]` of every joint, z its cogging cycles a turn; zero where the description gives none.
    pub fn cogging_basis(&self, q: &Joints<N>) -> [[f64; 2]; N] {
        std::array::from_fn(|joint| {
            let cycles = self.cogging[joint];
            if cycles > 0.0 {
                let (sin, cos) = (cycles * q[joint]).sin_cos();
                [sin, cos]
            } else {
                [0.0; 2]
            }
        })
    }

    /// Appends the active columns of all joints at `state` to `table`.
    ///
    /// * `age_s` time since the start of the log
    /// * `scratch` N × 11 N matrix, zero at first; entries that are always zero are never written.
    pub fn append_row(
        &self,
        state: &State<N>,
        age_s: f64,
        scratch: &mut DMatrix<f64>,
        table: &mut Vec<f64>,
    ) {
        self.model.regressor_into(state, scratch, 0);
        let loaded = |columns: &Vec<FrictionColumn>| columns.contains(&FrictionColumn::Load);
        let load = if self.friction.iter().any(loaded) {
            self.model.gravity_torques(&state.q)
        } else {
            Joints::zeros()
        };
        for joint in 0..N {
            let (q, qd) = (state.q[joint], state.qd[joint]);
            let friction = &self.friction[joint];
            let inertial = &self.active[joint][..self.active[joint].len() - friction.len()];
            table.extend(
                inertial
                    .iter()
                    .map(|&place| scratch[(joint, self.standard[place])]),
            );
            let sign = (qd / SIGN_WIDTH_RAD_S).tanh();
            table.extend(friction.iter().map(|column| match column {
                FrictionColumn::Viscous => qd,
                FrictionColumn::Coulomb => sign,
                FrictionColumn::Offset => 1.0,
                FrictionColumn::Stribeck => sign * (-(qd / STRIBECK_RAD_S).powi(2)).exp(),
                FrictionColumn::Bend => sign / (1.0 + (qd / BEND_RAD_S).powi(2)),
                FrictionColumn::Root => sign * qd.abs().sqrt(),
                FrictionColumn::Cubic => qd.powi(3),
                FrictionColumn::Load => sign * load[joint].abs(),
                FrictionColumn::CoggingSine => (self.cogging[joint] * q).sin(),
                FrictionColumn::CoggingCosine => (self.cogging[joint] * q).cos(),
                FrictionColumn::WarmUp => qd * age_s,
            }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_grows_with_the_load_where_gravity_makes_one() {
        let robot = Robot::load("ur5").expect("built in");
        let set = ColumnSet::from_str("coulomb-viscous+load").expect("known words");
        let layout = Layout::<6>::new(&robot, &set).expect("six joints");
        let loads = layout.parameters.iter().filter_map(|p| p.friction);
        let loaded: Vec<usize> = loads
            .filter(|(column, _)| *column == FrictionColumn::Load)
            .map(|(_, joint)| joint)
            .collect();
        // The first axis stands upright, the last one carries its link in the middle.
        assert_eq!(loaded, [1, 2, 3, 4]);

        let q = Joints::from_fn(|joint, _| 0.3 + joint as f64);
        let state = State {
            q,
            qd: Joints::repeat(-1.0),
            qdd: Joints::repeat(2.0),
        };
        let (mut row, mut scratch) = (Vec::new(), DMatrix::zeros(6, 66));
        layout.append_row(&state, 0.0, &mut scratch, &mut row);
        assert_eq!(row.len(), layout.width);
        let gravity = layout.model.gravity_torques(&q);
        for joint in loaded {
            let last = layout.offset[joint] + layout.active[joint].len() - 1;
            assert!(
                (row[last] + gravity[joint].abs()).abs() < 1e-12,
                "joint {joint}"
            );
        }
    }
}
