//! Paths of the tool that cannot be played.

use crate::kinematics::InverseError;
use crate::trajectory::BeyondLimits;
use nalgebra::Vector3;
use std::fmt;

/// Place on the path.
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

/// A path of the tool that cannot be played.
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
        /// The problem.
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
        /// The place.
        spot: Spot,
        /// The reason.
        error: InverseError,
    },
    /// The joints could, but not within their limits.
    #[error("{spot}: {error}")]
    Limits {
        /// The place.
        spot: Spot,
        /// The joint.
        error: BeyondLimits,
    },
}
