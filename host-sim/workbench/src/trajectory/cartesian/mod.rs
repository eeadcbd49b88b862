//! Paths of the tool: a small file of lines, circles and via points, laid out as joint motion by inverse kinematics.
//!
//! `parse` (text → moves) → `Move::at` (pose, twist and its derivative at an instant) → [`plan`] (joint positions, velocities
//! and accelerations tick by tick, every limit checked).

mod plan;

pub use plan::plan;

use super::via::ViaPath;
use crate::Refusal;
use crate::files::from_toml;
use crate::kinematics::{Twist, rotation_vector, stacked};
use crate::robot::{Placement, angle_problem};
use nalgebra::{Matrix3, Rotation3, Unit, Vector3, Vector6};
use serde::Deserialize;

/// A move may turn the tool this far from where it started, rad: half a turn has two ways round.
const MOST_TURN: f64 = 3.0;

/// Where the tool is at an instant, and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    pose: Placement,
    /// m/s and rad/s, base frame.
    twist: Twist,
    /// m/s² and rad/s².
    rate: Twist,
}

#[derive(Clone, Debug, PartialEq)]
enum Shape {
    /// Straight, turning about one axis. Position, m, then rotation vector, rad: both from the start.
    Line(Vector6<f64>),
    /// About an axis through `centre` along `axis` (length 1), by `turn` rad; `carry` turns the tool along.
    Circle {
        centre: Vector3<f64>,
        arm: Vector3<f64>,
        axis: Vector3<f64>,
        turn: f64,
        carry: bool,
    },
    /// Through points at even times without stopping.
    Via(ViaPath<6>),
}

/// Position and rotation vector of `to` from the pose `from`.
fn step(from: &Placement, to: &Placement) -> Result<Vector6<f64>, &'static str> {
    let turn = rotation_vector(&(to.rot_parent_child * from.rot_parent_child.transpose()));
    if turn.norm() > MOST_TURN {
        return Err("turns the tool by more than 3 rad from where the move starts: use two moves");
    }
    Ok(stacked(&(to.origin - from.origin), &turn))
}

/// The path of a move through `points`.
///
/// Errors: what makes it none.
fn via(from: &Placement, points: &[Placement], duration_s: f64) -> Result<Shape, &'static str> {
    if points.is_empty() {
        return Err("there is no point");
    }
    let mut steps = vec![Vector6::zeros()];
    for point in points {
        steps.push(step(from, point)?);
    }
    Ok(Shape::Via(ViaPath::through(&steps, duration_s)))
}

impl Move {
    fn end(&self) -> Placement {
        self.at(self.duration_s).pose
    }

    /// The point at `t_s` after the start. Lines and circles follow `10 s³ − 15 s⁴ + 6 s⁵`, so that velocity and
    /// acceleration begin and end at zero.
    fn at(&self, t_s: f64) -> Point {
        let h = self.duration_s;
        let s = (t_s / h).clamp(0.0, 1.0);
        let share = s * s * s * (10.0 + s * (6.0 * s - 15.0));
        let speed = 30.0 * (s * (1.0 - s)).powi(2) / h;
        let rise = s * (60.0 + s * (120.0 * s - 180.0)) / (h * h);
        match &self.shape {
            Shape::Line(step) => self.point(&(step * share), &(step * speed), &(step * rise)),
            Shape::Via(path) => {
                let state = path.at(t_s.clamp(0.0, h));
                self.point(&state.q, &state.qd, &state.qdd)
            }
            Shape::Circle {
                centre,
                arm,
                axis,
                turn,
                carry,
            } => {
                let turned = Rotation3::from_axis_angle(&Unit::new_unchecked(*axis), turn * share);
                let arm = turned * arm;
                let (omega, alpha) = (axis * (turn * speed), axis * (turn * rise));
                let v = omega.cross(&arm);
                let a = alpha.cross(&arm) + omega.cross(&omega.cross(&arm));
                let (still, rot) = (Vector3::zeros(), self.from.rot_parent_child);
                let (rot, omega, alpha) = match carry {
                    true => (turned.matrix() * rot, omega, alpha),
                    false => (rot, still, still),
                };
                Point {
                    pose: Placement {
                        rot_parent_child: rot,
                        origin: centre + arm,
                    },
                    twist: stacked(&v, &omega),
                    rate: stacked(&a, &alpha),
                }
            }
        }
    }

    /// The point of a position and rotation vector `x` from the start, with its two derivatives.
    fn point(&self, x: &Vector6<f64>, xd: &Vector6<f64>, xdd: &Vector6<f64>) -> Point {
        let moving = |x: &Vector6<f64>| Vector3::new(x[0], x[1], x[2]);
        let turning = |x: &Vector6<f64>| Vector3::new(x[3], x[4], x[5]);
        let phi = turning(x);
        let (omega, alpha) = rates(&phi, &turning(xd), &turning(xdd));
        Point {
            pose: Placement {
                rot_parent_child: rotation(&phi) * self.from.rot_parent_child,
                origin: self.from.origin + moving(x),
            },
            twist: stacked(&moving(xd), &omega),
            rate: stacked(&moving(xdd), &alpha),
        }
    }
}

/// Below this angle, rad, the coefficients come from their series.
const SMALL: f64 = 1e-2;

/// Rotation matrix of axis × angle, rad.
fn rotation(phi: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::from_scaled_axis(*phi).into_inner()
}

/// Angular velocity and acceleration of `exp([φ]×)` in the frame in which φ is expressed, rad/s and rad/s².
///
/// `ω = A φ̇`, `ω̇ = A φ̈ + Ȧ φ̇` with `A = 1 + b [φ]× + c [φ]×²`, `b = (1 − cos θ)/θ²`, `c = (θ − sin θ)/θ³`, θ = |φ|; and
/// `db/dθ = ((1 − c θ²) − 2 b)/θ`, `dc/dθ = (b − 3 c)/θ`                              [Bullo and Murray 1995, eq. 2.8]
fn rates(
    phi: &Vector3<f64>,
    phid: &Vector3<f64>,
    phidd: &Vector3<f64>,
) -> (Vector3<f64>, Vector3<f64>) {
    let square = phi.norm_squared();
    let theta = square.sqrt();
    // (db/dθ)/θ and (dc/dθ)/θ: times φ·φ̇ they are ḃ and ċ.
    let (b, c, db, dc) = if theta < SMALL {
        (
            0.5 - square / 24.0,
            1.0 / 6.0 - square / 120.0,
            -1.0 / 12.0 + square / 180.0,
            -1.0 / 60.0 + square / 1260.0,
        )
    } else {
        let b = (1.0 - theta.cos()) / square;
        let c = (theta - theta.sin()) / (square * theta);
        (
            b,
            c,
            (1.0 - c * square - 2.0 * b) / square,
            (b - 3.0 * c) / square,
        )
    };
    let turn = phi.dot(phid);
    let apply = |x: &Vector3<f64>| x + phi.cross(x) * b + phi.cross(&phi.cross(x)) * c;
    let omega = apply(phid);
    // Ȧ φ̇; [φ̇]× φ̇ = 0 drops two of its terms.
    let drift = phi.cross(phid) * (db * turn)
        + phi.cross(&phi.cross(phid)) * (dc * turn)
        + phid.cross(&phi.cross(phid)) * c;
    (omega, apply(phidd) + drift)
}

/// The file of a path: TOML, units in the names of the fields. `docs/identification.md` describes the format.
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
struct Path {
    /// The tool's tip in the flange.
    tool: Placement,
    /// Joint positions, rad, near the solution of the start.
    near_q: Option<Vec<f64>>,
    start: Placement,
    moves: Vec<Move>,
}

/// One move from where the last one ended, from rest to rest.
#[derive(Clone, Debug, PartialEq)]
struct Move {
    /// Its kind in the file.
    kind: &'static str,
    /// Points of the file on its way.
    points: Vec<Placement>,
    from: Placement,
    duration_s: f64,
    shape: Shape,
}

/// Longest move, s: an hour of ticks is 3.6 million rows.
const LONGEST_S: f64 = 3600.0;

fn parse(text: &str) -> Result<Path, Refusal> {
    let raw: PathFile = from_toml(text).map_err(Refusal)?;
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
                ("line", Vec::new(), step(&from, &end).map(Shape::Line))
            }
            (None, Some(circle), None) => {
                let shape = circle.shape(&format!("{at}.circle"), &from)?;
                ("circle", Vec::new(), Ok(shape))
            }
            (None, None, Some(points)) => {
                let mut placed: Vec<Placement> = Vec::with_capacity(points.len());
                for (number, point) in points.iter().enumerate() {
                    let at = format!("{at}.via[{}]", number + 1);
                    let point = point.placed(&at, placed.last().unwrap_or(&from))?;
                    placed.push(point);
                }
                let shape = via(&from, &placed, duration_s);
                ("via", placed, shape)
            }
            _ => return Err(Refusal::of(at, "give exactly one of line, circle, via")),
        };
        let shape = shape.map_err(|problem| Refusal::of(format!("{at}.{kind}"), problem))?;
        let step = Move {
            kind,
            points,
            from,
            duration_s,
            shape,
        };
        pose = step.end();
        moves.push(step);
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
        if let Some(problem) = angle_problem(&rpy) {
            return Err(Refusal::of(format!("{at}.rpy_rad"), problem));
        }
        let mut pose = Placement::from_xyz_rpy(self.xyz_m.into(), rpy.into());
        if self.rpy_rad.is_none() {
            pose.rot_parent_child = before.rot_parent_child;
        }
        Ok(pose)
    }
}

impl CircleFile {
    /// The circle from the pose `from` on.
    fn shape(&self, at: &str, from: &Placement) -> Result<Shape, Refusal> {
        let (centre, normal) = (Vector3::from(self.centre_m), Vector3::from(self.normal));
        finite(&format!("{at}.centre_m"), &self.centre_m)?;
        finite(&format!("{at}.normal"), &self.normal)?;
        finite(&format!("{at}.turn_rad"), &[self.turn_rad])?;
        if normal.norm() < 1e-6 {
            return Err(Refusal::of(format!("{at}.normal"), "has no direction"));
        }
        let (axis, out) = (normal.normalize(), from.origin - centre);
        let along = axis * axis.dot(&out);
        if (out - along).norm() < 1e-6 {
            let problem = "the move starts on the axis: there is no radius";
            return Err(Refusal::of(at, problem));
        }
        Ok(Shape::Circle {
            centre: centre + along,
            arm: out - along,
            axis,
            turn: self.turn_rad,
            carry: self.carry,
        })
    }
}

fn finite(name: &str, values: &[f64]) -> Result<(), Refusal> {
    let finite = values.iter().all(|value| value.is_finite());
    let refused = || Refusal::of(name, "is not a finite number");
    finite.then_some(()).ok_or_else(refused)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_derivatives_of_the_rotation() {
        for size in [0.0, 1e-3, 9e-3, 1.1e-2, 0.5, 2.0, 3.0] {
            let axis = Vector3::new(0.6, -0.64, 0.48);
            let (phid, phidd) = (Vector3::new(0.3, 0.7, -0.2), Vector3::new(-0.5, 0.1, 0.9));
            let at = |t: f64| axis * size + phid * t + phidd * (0.5 * t * t);
            let h = 1e-5;
            let step = rotation(&at(h)) * rotation(&at(-h)).transpose();
            let (omega, alpha) = rates(&at(0.0), &phid, &phidd);
            assert!(
                (rotation_vector(&step) / (2.0 * h) - omega).amax() < 1e-8,
                "{size}"
            );
            let omega_at = |t: f64| rates(&at(t), &(phid + phidd * t), &phidd).0;
            let slope = (omega_at(h) - omega_at(-h)) / (2.0 * h);
            assert!((slope - alpha).amax() < 1e-7, "{size}: {slope} {alpha}");
        }
    }
}
