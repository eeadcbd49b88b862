//! One move as a curve in time: pose, twist and its derivative.

use super::rotation::{rates, rotation};
use crate::kinematics::{Twist, rotation_vector};
use crate::robot::Placement;
use crate::trajectory::via::ViaPath;
use nalgebra::{Rotation3, Unit, Vector3, Vector6};

/// A move may turn the tool this far from where it started, rad: half a turn has two ways round.
const MOST_TURN: f64 = 3.0;

/// The way of a move.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Way {
    /// Straight, turning about one axis.
    Line(Placement),
    /// About an axis through `centre` along `normal` (length 1), by `turn` rad; `carry` turns the tool along.
    Circle {
        centre: Vector3<f64>,
        normal: Vector3<f64>,
        turn: f64,
        carry: bool,
    },
    /// Through points at even times without stopping.
    Via(Vec<Placement>),
}

/// Pose and motion of the tool at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    pub(super) pose: Placement,
    /// m/s and rad/s, base frame.
    pub(super) twist: Twist,
    /// m/s² and rad/s².
    pub(super) rate: Twist,
}

/// A move from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Curve {
    from: Placement,
    pub(super) duration_s: f64,
    shape: Shape,
}

#[derive(Clone, Debug, PartialEq)]
enum Shape {
    /// Position, m, then rotation vector, rad: both from the start.
    Line(Vector6<f64>),
    Circle {
        centre: Vector3<f64>,
        arm: Vector3<f64>,
        axis: Vector3<f64>,
        turn: f64,
        carry: bool,
    },
    Via(ViaPath<6>),
}

impl Curve {
    /// The curve of `way` from the pose `from`.
    ///
    /// Errors: what makes it no curve.
    pub(super) fn new(way: &Way, from: &Placement, duration_s: f64) -> Result<Self, &'static str> {
        let step = |to: &Placement| -> Result<Vector6<f64>, &'static str> {
            let turn = rotation_vector(&(to.rot_parent_child * from.rot_parent_child.transpose()));
            if turn.norm() > MOST_TURN {
                return Err(
                    "turns the tool by more than 3 rad from where the move starts: use two moves",
                );
            }
            let way = to.origin - from.origin;
            Ok(Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z))
        };
        let shape = match way {
            Way::Line(to) => Shape::Line(step(to)?),
            Way::Circle {
                centre,
                normal,
                turn,
                carry,
            } => {
                let out = from.origin - centre;
                let along = normal * normal.dot(&out);
                let arm = out - along;
                if arm.norm() < 1e-6 {
                    return Err("the move starts on the axis: there is no radius");
                }
                Shape::Circle {
                    centre: centre + along,
                    arm,
                    axis: *normal,
                    turn: *turn,
                    carry: *carry,
                }
            }
            Way::Via(points) => {
                let mut steps = vec![Vector6::zeros()];
                for point in points {
                    steps.push(step(point)?);
                }
                Shape::Via(ViaPath::through(&steps, duration_s))
            }
        };
        Ok(Self {
            from: *from,
            duration_s,
            shape,
        })
    }

    /// Pose at the end.
    pub(super) fn end(&self) -> Placement {
        self.at(self.duration_s).pose
    }

    /// The point at `t_s` after the start. Lines and circles follow `10 s³ − 15 s⁴ + 6 s⁵`, so that velocity and
    /// acceleration begin and end at zero.
    pub(super) fn at(&self, t_s: f64) -> Point {
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
                let (v, a) = (
                    omega.cross(&arm),
                    alpha.cross(&arm) + omega.cross(&omega.cross(&arm)),
                );
                let still = Vector3::zeros();
                let (rot, omega, alpha) = if *carry {
                    (turned.matrix() * self.from.rot_parent_child, omega, alpha)
                } else {
                    (self.from.rot_parent_child, still, still)
                };
                Point {
                    pose: Placement {
                        rot_parent_child: rot,
                        origin: centre + arm,
                    },
                    twist: Twist::new(v.x, v.y, v.z, omega.x, omega.y, omega.z),
                    rate: Twist::new(a.x, a.y, a.z, alpha.x, alpha.y, alpha.z),
                }
            }
        }
    }

    /// The point of a position and rotation vector `x` from the start, with its two derivatives.
    fn point(&self, x: &Vector6<f64>, xd: &Vector6<f64>, xdd: &Vector6<f64>) -> Point {
        let turning = |x: &Vector6<f64>| Vector3::new(x[3], x[4], x[5]);
        let phi = turning(x);
        let (omega, alpha) = rates(&phi, &turning(xd), &turning(xdd));
        Point {
            pose: Placement {
                rot_parent_child: rotation(&phi) * self.from.rot_parent_child,
                origin: self.from.origin + Vector3::new(x[0], x[1], x[2]),
            },
            twist: Twist::new(xd[0], xd[1], xd[2], omega.x, omega.y, omega.z),
            rate: Twist::new(xdd[0], xdd[1], xdd[2], alpha.x, alpha.y, alpha.z),
        }
    }
}
