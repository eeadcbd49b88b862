//! Placements of frames, capsules around links, and the workspace.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// A turn, rad, with the error of two decimals. Angles of a file beyond it are degrees as a rule.
pub const TURN: f64 = std::f64::consts::TAU + 0.01;

/// Reason why angles of a file, rad, are none; `None` if they are.
pub fn angle_problem(angles: &[f64]) -> Option<&'static str> {
    if !angles.iter().all(|angle| angle.is_finite()) {
        return Some("is not a finite number");
    }
    let far = angles.iter().any(|angle| angle.abs() > TURN);
    far.then_some("is in radians, and has more than a turn")
}

/// Direction cosines this close to 0 and ±1, and lengths (m) this close to 0, are meant to be exact: a right angle
/// written in decimals must cost nothing on the board.
const EXACT: f64 = 1e-12;

/// Constant placement of a frame in the frame before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Rotation that maps child coordinates (at q = 0) into the parent frame.
    pub rot_parent_child: Matrix3<f64>,
    /// Origin of the child frame, expressed in the parent frame, m.
    pub origin: Vector3<f64>,
}

impl Default for Placement {
    fn default() -> Self {
        Self::identity()
    }
}

impl Placement {
    /// The frame that coincides with its parent.
    pub fn identity() -> Self {
        Self {
            rot_parent_child: Matrix3::identity(),
            origin: Vector3::zeros(),
        }
    }

    /// Origin `xyz` (m) in the parent; roll, pitch, yaw (rad) about its fixed axes, `R = Rz(yaw) Ry(pitch) Rx(roll)`.
    pub fn from_xyz_rpy(xyz: Vector3<f64>, rpy: Vector3<f64>) -> Self {
        let placement = Self {
            rot_parent_child: Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z).into_inner(),
            origin: xyz,
        };
        placement.snapped()
    }

    /// Roll, pitch and yaw about fixed axes, rad.
    pub fn rpy(&self) -> Vector3<f64> {
        let rot = Rotation3::from_matrix_unchecked(self.rot_parent_child);
        let (roll, pitch, yaw) = rot.euler_angles();
        Vector3::new(roll, pitch, yaw)
    }

    /// This placement followed by another one.
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rot_parent_child: self.rot_parent_child * next.rot_parent_child,
            origin: self.origin + self.rot_parent_child * next.origin,
        }
    }

    /// This placement, turned about its z axis by `angle`, rad.
    pub fn turned(&self, angle: f64) -> Self {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        Self {
            rot_parent_child: self.rot_parent_child * turn.matrix(),
            origin: self.origin,
        }
    }

    /// A `point` of the child in the parent, m.
    pub fn point(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.origin + self.rot_parent_child * point
    }

    /// The parent placed in the child.
    pub fn inverse(&self) -> Self {
        let rot_child_parent = self.rot_parent_child.transpose();
        Self {
            rot_parent_child: rot_child_parent,
            origin: -(rot_child_parent * self.origin),
        }
    }

    /// This placement with near-exact zeros and ones rounded.
    pub fn snapped(&self) -> Self {
        Self {
            rot_parent_child: self.rot_parent_child.map(|entry| {
                let nearest = entry.round();
                if (entry - nearest).abs() < EXACT {
                    // Adding 0 turns −0 into 0.
                    nearest + 0.0
                } else {
                    entry
                }
            }),
            origin: self.origin.map(|x| if x.abs() < EXACT { 0.0 } else { x }),
        }
    }
}

/// A segment with a radius: all points within `radius` of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// Ends of the segment, in the joint frame of the link, m.
    pub ends: [Vector3<f64>; 2],
    /// Radius, m.
    pub radius: f64,
}

impl Capsule {
    /// Distance of its farthest point from the joint frame's origin, m.
    pub fn reach(&self) -> f64 {
        self.ends[0].norm().max(self.ends[1].norm()) + self.radius
    }
}

/// Obstacles of the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct Workspace {
    /// Height of the table the base stands on, along the base's z, m.
    #[serde(rename = "table_height_m")]
    pub table_height: Option<f64>,
    /// Distance that links keep from the table and from each other, m.
    #[serde(rename = "clearance_m", default)]
    pub clearance: f64,
}

/// Distance of two segments, m (Ericson 2005, §5.1.9).
///
/// The closest points are `a0 + s u` and `b0 + t v`. For given t the best s is known and the other way round, so the
/// unconstrained optimum is clamped to [0, 1] once for each.
pub fn segment_distance(a: &[Vector3<f64>; 2], b: &[Vector3<f64>; 2]) -> f64 {
    let (u, v, w) = (a[1] - a[0], b[1] - b[0], a[0] - b[0]);
    let (uu, uv, vv) = (u.dot(&u), u.dot(&v), v.dot(&v));
    let (uw, vw) = (u.dot(&w), v.dot(&w));
    // A segment of no length is a point; a share of nothing is nothing.
    let share = |numerator: f64, denominator: f64| {
        if denominator > f64::MIN_POSITIVE {
            (numerator / denominator).clamp(0.0, 1.0)
        } else {
            0.0
        }
    };
    let s = share(uv * vw - uw * vv, uu * vv - uv * uv);
    let t = share(uv * s + vw, vv);
    let s = share(uv * t - uw, uu);
    (w + u * s - v * t).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn no_two_points_are_closer_than_the_distance_of_segments() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut point = || Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
        for case in 0..500 {
            let a = [point(), point()];
            let b = match case % 3 {
                0 => [point(), point()],
                // Parallel, and a point.
                1 => [a[0] + Vector3::x(), a[1] + Vector3::x()],
                _ => [a[0] + Vector3::y(); 2],
            };
            let distance = segment_distance(&a, &b);
            let mut closest = f64::INFINITY;
            for s in 0..=100 {
                for t in 0..=100 {
                    let on = |c: &[Vector3<f64>; 2], k: i32| c[0].lerp(&c[1], f64::from(k) / 100.0);
                    closest = closest.min((on(&a, s) - on(&b, t)).norm());
                }
            }
            assert!(distance <= closest + 1e-12, "case {case}");
            // The grid misses the closest points by at most half a step on each segment.
            let near = closest - distance < 0.04;
            assert!(near, "case {case}: {closest} {distance}");
        }
    }
}
