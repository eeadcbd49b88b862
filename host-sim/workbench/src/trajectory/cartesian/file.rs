//! The file of a path: TOML, units in the names of the fields. `docs/identification.md` describes the format.

use super::{Curve, Shape};
use crate::Refusal;
use crate::robot::Placement;
use nalgebra::Vector3;
use serde::Deserialize;

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
    /// Its kind in the file.
    pub(super) kind: &'static str,
    /// Points of the file on its way.
    pub(super) points: Vec<Placement>,
    pub(super) curve: Curve,
}

/// Longest move, s: an hour of ticks is 3.6 million rows.
const LONGEST_S: f64 = 3600.0;

/// Reads and checks a path.
pub(super) fn parse(text: &str) -> Result<Path, Refusal> {
    let raw: PathFile = toml::from_str(text).map_err(|error| {
        let (line, reason) = crate::files::toml_complaint(text, &error);
        Refusal(format!("line {line}: {reason}"))
    })?;
    let tool = match raw.tool {
        Some(pose) => pose.placed("tool", &Placement::identity())?,
        None => Placement::identity(),
    };
    let start = raw.start.placed("start", &Placement::identity())?;
    if raw.start.rpy_rad.is_none() {
        return Err(Refusal::of("start.rpy_rad", "is missing"));
    }
    if let Some(near) = &raw.near_q_rad {
        finite("near_q_rad", near)?;
    }
    if raw.moves.is_empty() {
        return Err(Refusal::of("move", "there is none"));
    }
    let mut moves = Vec::with_capacity(raw.moves.len());
    let mut pose = start;
    for (index, given) in raw.moves.iter().enumerate() {
        let at = format!("move[{}]", index + 1);
        let from = pose;
        let duration_s = given.duration_s;
        if !(duration_s > 0.0 && duration_s <= LONGEST_S) {
            let problem = format!("is {duration_s}, must be above 0 and at most {LONGEST_S}");
            return Err(Refusal::of(at + ".duration_s", problem));
        }
        let (kind, points, shape) = match (&given.line, &given.circle, &given.via) {
            (Some(end), None, None) => {
                let end = end.placed(&format!("{at}.line"), &from)?;
                ("line", Vec::new(), Shape::line(&from, &end))
            }
            (None, Some(circle), None) => {
                circle.check(&format!("{at}.circle"))?;
                ("circle", Vec::new(), circle.shape(&from))
            }
            (None, None, Some(points)) => {
                let mut placed: Vec<Placement> = Vec::with_capacity(points.len());
                for (number, point) in points.iter().enumerate() {
                    let at = format!("{at}.via[{}]", number + 1);
                    let point = point.placed(&at, placed.last().unwrap_or(&from))?;
                    placed.push(point);
                }
                let shape = Shape::via(&from, &placed, duration_s);
                ("via", placed, shape)
            }
            _ => return Err(Refusal::of(at, "give exactly one of line, circle, via")),
        };
        let shape = shape.map_err(|problem| Refusal::of(format!("{at}.{kind}"), problem))?;
        let curve = Curve {
            from,
            duration_s,
            shape,
        };
        pose = curve.end();
        moves.push(Move {
            kind,
            points,
            curve,
        });
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
    fn placed(&self, at: &str, before: &Placement) -> Result<Placement, Refusal> {
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
    fn check(&self, at: &str) -> Result<(), Refusal> {
        finite(&format!("{at}.centre_m"), &self.centre_m)?;
        finite(&format!("{at}.normal"), &self.normal)?;
        finite(&format!("{at}.turn_rad"), &[self.turn_rad])?;
        if Vector3::from(self.normal).norm() < 1e-6 {
            return Err(Refusal::of(format!("{at}.normal"), "has no direction"));
        }
        Ok(())
    }

    /// The circle from the pose `from` on.
    fn shape(&self, from: &Placement) -> Result<Shape, &'static str> {
        let axis = Vector3::from(self.normal).normalize();
        Shape::circle(from, self.centre_m.into(), axis, self.turn_rad, self.carry)
    }
}

fn finite(name: &str, values: &[f64]) -> Result<(), Refusal> {
    if values.iter().all(|value| value.is_finite()) {
        Ok(())
    } else {
        Err(Refusal::of(name, "is not a finite number"))
    }
}
