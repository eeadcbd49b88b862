//! The file of a path: TOML, units in the names of the fields. `docs/identification.md` describes the format.

use super::{Curve, Way};
use crate::kinematics::InverseError;
use crate::robot::Placement;
use crate::trajectory::BeyondLimits;
use nalgebra::Vector3;
use serde::Deserialize;
use std::fmt;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PathFile {
    tool: Option<PoseFile>,
    near_q_rad: Option<Vec<f64>>,
    start: PoseFile,
    #[serde(rename = "move")]
    moves: Vec<MoveFile>,
}

/// Origin, and roll–pitch–yaw about fixed axes, `R = Rz(yaw) Ry(pitch) Rx(roll)`; without angles as before.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseFile {
    xyz_m: [f64; 3],
    rpy_rad: Option<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MoveFile {
    duration_s: f64,
    line: Option<PoseFile>,
    circle: Option<CircleFile>,
    via: Option<Vec<PoseFile>>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct CircleFile {
    centre_m: [f64; 3],
    normal: [f64; 3],
    turn_rad: f64,
    #[serde(default)]
    carry: bool,
}

/// A path in the file's terms.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Path {
    /// The tool's tip in the flange.
    pub(super) tool: Placement,
    /// Joint positions, rad, near the solution of the start.
    pub(super) near_q: Option<Vec<f64>>,
    pub(super) start: Placement,
    pub(super) moves: Vec<Move>,
}

/// One move from where the last one ended, from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Move {
    pub(super) way: Way,
    pub(super) curve: Curve,
}

/// Longest move, s: an hour of ticks is 3.6 million rows.
const LONGEST_S: f64 = 3600.0;

/// Reads and checks a path.
pub(super) fn parse(text: &str) -> Result<Path, CartesianError> {
    let raw: PathFile = toml::from_str(text).map_err(|error| {
        let (line, reason) = crate::files::toml_complaint(text, &error);
        CartesianError::Syntax { line, reason }
    })?;
    let tool = match raw.tool {
        Some(pose) => pose.placed("tool", &Placement::identity())?,
        None => Placement::identity(),
    };
    let start = raw.start.placed("start", &Placement::identity())?;
    if raw.start.rpy_rad.is_none() {
        return Err(field("start.rpy_rad", "is missing"));
    }
    if let Some(near) = &raw.near_q_rad {
        finite("near_q_rad", near)?;
    }
    if raw.moves.is_empty() {
        return Err(field("move", "there is none"));
    }
    let mut moves = Vec::with_capacity(raw.moves.len());
    let mut pose = start;
    for (index, given) in raw.moves.iter().enumerate() {
        let at = format!("move[{}]", index + 1);
        let from = pose;
        let duration_s = given.duration_s;
        if !(duration_s > 0.0 && duration_s <= LONGEST_S) {
            let problem = format!("is {duration_s}, must be above 0 and at most {LONGEST_S}");
            return Err(field(&format!("{at}.duration_s"), &problem));
        }
        let way = match (&given.line, &given.circle, &given.via) {
            (Some(end), None, None) => {
                pose = end.placed(&format!("{at}.line"), &pose)?;
                Way::Line(pose)
            }
            (None, Some(circle), None) => circle.way(&at)?,
            (None, None, Some(points)) => {
                let mut placed = Vec::with_capacity(points.len());
                for (number, point) in points.iter().enumerate() {
                    pose = point.placed(&format!("{at}.via[{}]", number + 1), &pose)?;
                    placed.push(pose);
                }
                if placed.is_empty() {
                    return Err(field(&format!("{at}.via"), "there is no point"));
                }
                Way::Via(placed)
            }
            _ => return Err(field(&at, "give exactly one of line, circle, via")),
        };
        let curve = Curve::new(&way, &from, duration_s)
            .map_err(|problem| field(&format!("{at}.{}", way.name()), problem))?;
        pose = curve.end();
        moves.push(Move { way, curve });
    }
    Ok(Path {
        tool,
        near_q: raw.near_q_rad,
        start,
        moves,
    })
}

impl PoseFile {
    /// The pose; its orientation is that of `before` where it gives none.
    fn placed(&self, at: &str, before: &Placement) -> Result<Placement, CartesianError> {
        finite(&format!("{at}.xyz_m"), &self.xyz_m)?;
        let rpy = self.rpy_rad.unwrap_or_default();
        finite(&format!("{at}.rpy_rad"), &rpy)?;
        let mut pose = Placement::from_xyz_rpy(self.xyz_m.into(), rpy.into());
        if self.rpy_rad.is_none() {
            pose.rot_parent_child = before.rot_parent_child;
        }
        Ok(pose)
    }
}

impl CircleFile {
    fn way(&self, at: &str) -> Result<Way, CartesianError> {
        finite(&format!("{at}.circle.centre_m"), &self.centre_m)?;
        finite(&format!("{at}.circle.normal"), &self.normal)?;
        finite(&format!("{at}.circle.turn_rad"), &[self.turn_rad])?;
        let normal = Vector3::from(self.normal);
        if normal.norm() < 1e-6 {
            return Err(field(&format!("{at}.circle.normal"), "has no direction"));
        }
        Ok(Way::Circle {
            centre: self.centre_m.into(),
            normal: normal.normalize(),
            turn: self.turn_rad,
            carry: self.carry,
        })
    }
}

fn field(field: &str, problem: &str) -> CartesianError {
    CartesianError::Field {
        field: field.to_owned(),
        problem: problem.to_owned(),
    }
}

fn finite(name: &str, values: &[f64]) -> Result<(), CartesianError> {
    if values.iter().all(|value| value.is_finite()) {
        Ok(())
    } else {
        Err(field(name, "is not a finite number"))
    }
}

/// Position of an error on the path.
#[derive(Clone, Debug, PartialEq)]
pub struct Spot {
    /// The waypoint or move, as the file counts: `start`, `move 2 (circle)`, `move 3 (via), point 2`.
    pub waypoint: String,
    /// Time on the path, s; `None` for the waypoint itself.
    pub t_s: Option<f64>,
    /// Target of the tool there, base frame, m.
    pub target: Vector3<f64>,
}

impl fmt::Display for Spot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.waypoint)?;
        if let Some(t_s) = self.t_s {
            write!(f, " at {t_s:.3} s")?;
        }
        let [x, y, z] = self.target.into();
        write!(f, ", tool at ({x:.3}, {y:.3}, {z:.3}) m")
    }
}

/// Reason for which a path of the tool cannot be played.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CartesianError {
    /// The file is no path.
    #[error("line {line}: {reason}")]
    Syntax {
        /// Line, from 1.
        line: usize,
        /// First complaint of the parser.
        reason: String,
    },
    /// A value is missing or makes no sense.
    #[error("{field}: {problem}")]
    Field {
        /// The field, for example `move[2].duration_s`, moves from 1.
        field: String,
        /// Reason.
        problem: String,
    },
    /// The robot has another number of joints than expected.
    #[error("the robot has not {expected} joints")]
    Joints {
        /// Joints expected.
        expected: usize,
    },
    /// No joint positions put the tool there.
    #[error("{spot}: {error}")]
    Kinematics {
        /// Where.
        spot: Spot,
        /// Why.
        error: InverseError,
    },
    /// The joints could, but not within their limits.
    #[error("{spot}: {error}")]
    Limits {
        /// Where.
        spot: Spot,
        /// Which joint.
        error: BeyondLimits,
    },
}
