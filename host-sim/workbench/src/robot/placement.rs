//! Placements: composing, turning round, and keeping right angles exact.

use super::Placement;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Direction cosines this close to 0 and ±1, and lengths (m) this close to 0, are meant to be exact: a right angle
/// written in decimals must cost nothing on the board.
const EXACT: f64 = 1e-12;

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

    /// This placement followed by another one.
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rot_parent_child: self.rot_parent_child * next.rot_parent_child,
            origin: self.origin + self.rot_parent_child * next.origin,
        }
    }

    /// The parent placed in the child.
    pub fn inverse(&self) -> Self {
        let rot_child_parent = self.rot_parent_child.transpose();
        Self {
            rot_parent_child: rot_child_parent,
            origin: -(rot_child_parent * self.origin),
        }
    }

    /// This placement with what rounding left of exact zeros and ones removed.
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
