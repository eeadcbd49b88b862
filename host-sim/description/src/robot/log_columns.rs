//! Names and units of the columns of foreign logs.

use crate::Refusal;
use crate::files::{from_toml, read_text};
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// Column names of one quantity of all joints.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(untagged)]
pub enum ColumnNames {
    /// One pattern: `{}` or `{1}` is the joint counted from 1, `{0}` from 0, `{name}` its name in the description.
    Pattern(String),
    /// One name a joint.
    List(Vec<String>),
}

impl ColumnNames {
    /// Column of a joint, counted from 0, of this name; `None` past the end of a list, or for a pattern that is the same
    /// for all joints.
    pub fn of(&self, joint: usize, name: &str) -> Option<String> {
        match self {
            Self::List(names) => names.get(joint).cloned(),
            Self::Pattern(pattern) => {
                let number = (joint + 1).to_string();
                let column = pattern
                    .replace("{}", &number)
                    .replace("{1}", &number)
                    .replace("{0}", &joint.to_string())
                    .replace("{name}", name);
                (column != *pattern).then_some(column)
            }
        }
    }

    /// First mark in braces that stands for nothing.
    pub fn unknown_mark(&self) -> Option<&str> {
        let Self::Pattern(pattern) = self else {
            return None;
        };
        let parts = pattern.match_indices('{').map(|(at, _)| &pattern[at..]);
        let mut marks = parts.filter_map(|part| part.get(..=part.find('}')?));
        marks.find(|mark| !["{}", "{0}", "{1}", "{name}"].contains(mark))
    }

    /// Text around `{name}` in the pattern.
    pub fn around_name(&self) -> Option<(&str, &str)> {
        match self {
            Self::Pattern(pattern) => pattern.split_once("{name}"),
            Self::List(_) => None,
        }
    }
}

/// Quantity in the column of torques.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum EffortKind {
    /// Torque at the link side of the gear, N·m.
    #[default]
    Torque,
    /// Motor current, A: times the drive gain of the description.
    Current,
    /// Torque of the motor before the gear, N·m: times the gear ratio.
    Motor,
}

impl FromStr for EffortKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "torque" => Ok(Self::Torque),
            "current" => Ok(Self::Current),
            "motor" => Ok(Self::Motor),
            _ => Err("not one of torque, current, motor".to_owned()),
        }
    }
}

/// Quantities of a log, in the order of [`Units`].
const QUANTITIES: [&str; 6] = ["t", "q", "qd", "qdd", "tau", "i"];

/// Units by quantity: place in [`QUANTITIES`], name, value in SI.
const UNITS: [(usize, &str, f64); 21] = [
    (0, "s", 1.0),
    (0, "ms", 1e-3),
    (0, "us", 1e-6),
    (0, "ns", 1e-9),
    (1, "rad", 1.0),
    (1, "deg", std::f64::consts::PI / 180.0),
    (1, "rev", std::f64::consts::TAU),
    (2, "rad/s", 1.0),
    (2, "deg/s", std::f64::consts::PI / 180.0),
    (2, "rev/s", std::f64::consts::TAU),
    (2, "rpm", std::f64::consts::TAU / 60.0),
    (3, "rad/s2", 1.0),
    (3, "deg/s2", std::f64::consts::PI / 180.0),
    (3, "rev/s2", std::f64::consts::TAU),
    (4, "Nm", 1.0),
    (4, "mNm", 1e-3),
    (4, "Nmm", 1e-3),
    (4, "Ncm", 1e-2),
    (4, "kNm", 1e3),
    (5, "A", 1.0),
    (5, "mA", 1e-3),
];

/// Units of some quantities of a log, written `q=deg,t=ms`. A minus before a unit, as in `tau=-Nm`, is for a source that
/// counts the other way.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub struct Units {
    text: String,
    /// SI value of one unit of time, position, velocity, acceleration, torque and current, where it is given.
    given: [Option<f64>; 6],
}

impl Units {
    /// These units, and those of `below` for quantities that have none here.
    pub fn over(self, below: Option<Self>) -> Self {
        let Some(below) = below else { return self };
        let given = std::array::from_fn(|k| self.given[k].or(below.given[k]));
        let is_replaced = |part: &&str| {
            let quantity = part.split('=').next().unwrap_or_default().trim();
            let mut pairs = QUANTITIES.iter().zip(&self.given);
            pairs.any(|(known, unit)| *known == quantity && unit.is_some())
        };
        let parts = below.text.split(',').filter(|part| !is_replaced(part));
        let parts = parts.chain(self.text.split(','));
        let parts: Vec<&str> = parts.filter(|part| !part.is_empty()).collect();
        let text = parts.join(",");
        Self { text, given }
    }

    /// There is a unit of currents.
    pub fn has_currents(&self) -> bool {
        self.given[5].is_some()
    }

    /// SI value of one unit of time, position, velocity, acceleration, torque column and current; 1 without a unit.
    ///
    /// Velocities and accelerations without a unit follow the positions. Torque columns that hold currents, by `effort`, have
    /// the unit of currents where there is one.
    pub fn scale(&self, effort: Option<EffortKind>) -> [f64; 6] {
        let [t, q, qd, qdd, tau, i] = self.given;
        let tau = i.filter(|_| effort == Some(EffortKind::Current)).or(tau);
        [t, q, qd.or(q), qdd.or(q), tau, i].map(|unit| unit.unwrap_or(1.0))
    }
}

impl FromStr for Units {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut given = [None; 6];
        for part in text.split(',') {
            let (quantity, unit) = part.split_once('=').unwrap_or((part, ""));
            let mut known = QUANTITIES.iter();
            let Some(place) = known.position(|known| *known == quantity.trim()) else {
                let known = QUANTITIES.join(", ");
                return Err(format!("'{quantity}' is no quantity of a log: {known}"));
            };
            let units = || UNITS.iter().filter(|(of, ..)| *of == place);
            // Time runs one way.
            let turned = unit.trim().strip_prefix('-').filter(|_| place > 0);
            let (sign, plain) = turned.map_or((1.0, unit.trim()), |unit| (-1.0, unit));
            let Some((.., scale)) = units().find(|(_, name, _)| *name == plain) else {
                let known: Vec<&str> = units().map(|(_, name, _)| *name).collect();
                let known = known.join(", ");
                return Err(format!("'{unit}' is no unit of {quantity}: {known}"));
            };
            let scale = sign * scale;
            if given[place].replace(scale).is_some_and(|one| one != scale) {
                return Err(format!("two units of {quantity}: keep one of them"));
            }
        }
        let text = text.to_owned();
        Ok(Self { text, given })
    }
}

impl TryFrom<String> for Units {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Units> for String {
    fn from(units: Units) -> Self {
        units.text
    }
}

/// Columns of a foreign log.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct LogColumns {
    /// Header of files that have none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
    /// Topic of a ROS 2 bag with joint states of several arms.
    pub topic: Option<String>,
    /// Time.
    pub t_s: Option<String>,
    /// Rows a second, in the place of a column of times, Hz.
    pub rate_hz: Option<f64>,
    /// Positions.
    pub q_rad: Option<ColumnNames>,
    /// Velocities.
    pub qd_rad_s: Option<ColumnNames>,
    /// Accelerations.
    pub qdd_rad_s2: Option<ColumnNames>,
    /// Torques.
    pub tau_nm: Option<ColumnNames>,
    /// Motor currents.
    pub i_a: Option<ColumnNames>,
    /// Units of these columns; SI without.
    pub units: Option<Units>,
    /// Quantity in the columns of `tau_nm`; torque at the link without.
    pub effort: Option<EffortKind>,
    /// Motions and torques of an arm with a coupling are those of its joints, currents and torques of motors those of its drives.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub of_joints: bool,
    /// Turns of the motor a turn of the joint, for `effort = "motor"`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub gear_ratios: Vec<f64>,
    /// Units of all logs, also of those with the project's own columns (`--units`).
    #[serde(skip)]
    pub all_units: Option<Units>,
    /// Every column of the map must be there, and its units hold for all columns.
    #[serde(skip)]
    pub required: bool,
    /// The one known source whose columns are taken (`--columns-from`).
    #[serde(skip)]
    pub source: Option<String>,
}

/// Names of the known sources of logs.
pub const LOG_SOURCES: [&str; 4] = ["ros", "rtde", "franka", "lerobot"];

impl LogColumns {
    /// Columns from a TOML file.
    ///
    /// Errors: a line that names the file and its line.
    pub fn load(path: &str) -> Result<Self, Refusal> {
        let text = read_text(path.as_ref()).map_err(|error| {
            let known = LOG_SOURCES.join(", ");
            Refusal::of(path, format!("not one of {known}, and as a file: {error}"))
        })?;
        let columns: Self = from_toml(&text).map_err(|problem| Refusal::of(path, problem))?;
        if columns == Self::default() {
            let problem = "no columns: write t_s (or rate_hz), q_rad and tau_nm (or i_a)";
            return Err(Refusal::of(path, problem));
        }
        let mut ratios = columns.gear_ratios.iter();
        match ratios.find(|ratio| !ratio.is_normal()) {
            Some(ratio) => {
                let problem = format!("gear_ratios: {ratio} is no ratio");
                Err(Refusal::of(path, problem))
            }
            None => Ok(columns),
        }
    }

    /// Columns of positions, velocities, accelerations, torques and currents.
    pub fn quantities(&self) -> [Option<&ColumnNames>; 5] {
        let motion = [&self.q_rad, &self.qd_rad_s, &self.qdd_rad_s2];
        let [q, qd, qdd] = motion.map(Option::as_ref);
        [q, qd, qdd, self.tau_nm.as_ref(), self.i_a.as_ref()]
    }

    /// Columns of the known sources, by name. A source may write its columns in more than one way.
    pub fn known() -> Vec<(String, Self)> {
        #[derive(Deserialize)]
        struct Known {
            source: Vec<Source>,
        }
        #[derive(Deserialize)]
        struct Source {
            name: String,
            columns: LogColumns,
        }
        let known: Known = toml::from_str(include_str!("log_sources.toml")).expect("is a table");
        let pair = |source: Source| (source.name, source.columns);
        known.source.into_iter().map(pair).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_columns_count_from_zero_or_one_or_carry_the_joint() {
        for (pattern, wanted) in [
            ("q{}", Some("q3")),
            ("q{1}", Some("q3")),
            ("q[{0}]", Some("q[2]")),
            ("{name}/position", Some("elbow/position")),
            ("q", None),
        ] {
            let names = ColumnNames::Pattern(pattern.to_owned());
            assert_eq!(names.of(2, "elbow").as_deref(), wanted);
        }
        let list = ColumnNames::List(vec!["a".to_owned(), "b".to_owned()]);
        assert_eq!(list.of(1, "x").as_deref(), Some("b"));
        assert_eq!(list.of(2, "x"), None);
        for (pattern, unknown) in [
            ("pos_{nam}_{}", Some("{nam}")),
            ("{name}/{2}", Some("{2}")),
            ("{q{name}", Some("{q{name}")),
            ("{name}_{0}{1}{}", None),
        ] {
            let names = ColumnNames::Pattern(pattern.to_owned());
            assert_eq!(names.unknown_mark(), unknown);
        }
    }

    #[test]
    fn units_are_read_and_velocities_follow_positions() {
        let units: Units = "q=deg,t=ms,tau=mNm".parse().expect("known");
        let degree = std::f64::consts::PI / 180.0;
        assert_eq!(units.scale(None), [1e-3, degree, degree, degree, 1e-3, 1.0]);
        let units: Units = "q=-deg,tau=-Nm,i=A".parse().expect("known");
        assert_eq!(
            units.scale(None),
            [1.0, -degree, -degree, -degree, -1.0, 1.0]
        );
        assert_eq!(units.scale(Some(EffortKind::Current))[4], 1.0);
        let below: Units = "tau=mNm,qd=rpm,t=ms".parse().expect("known");
        let both = units.over(Some(below));
        assert_eq!(both.scale(None)[..2], [1e-3, -degree]);
        assert_eq!(both.scale(None)[3..], [-degree, -1.0, 1.0]);
        let text = String::from(both.clone());
        assert_eq!(text, "qd=rpm,t=ms,q=-deg,tau=-Nm,i=A");
        assert_eq!(text.parse::<Units>().expect("known").given, both.given);
        assert!("q=deg,t=ms,q=deg".parse::<Units>().is_ok());
        for wrong in ["q=grad", "q=--deg", "t=-s", "speed=rad", "q", ""] {
            assert!(wrong.parse::<Units>().is_err(), "{wrong}");
        }
        for wrong in ["q=deg,q=rad", "q=deg,t=s, q =-deg"] {
            let refused = wrong.parse::<Units>().expect_err(wrong);
            assert!(refused.starts_with("two units of "), "{refused}");
        }
        for (name, columns) in LogColumns::known() {
            assert!(LOG_SOURCES.contains(&&*name) && columns.units.is_some());
        }
    }
}
