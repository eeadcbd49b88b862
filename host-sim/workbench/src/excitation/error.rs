//! Failures of an excitation.

use crate::robot::Robot;

/// An excitation that was refused, or not found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExcitationError {
    /// It belongs to another robot.
    #[error("excitation is for robot '{found}', not '{expected}'")]
    Robot {
        /// Robot of the file.
        found: String,
        /// Robot asked for.
        expected: String,
    },
    /// Another number of joints or harmonics than expected, or a coefficient or period that makes no sense.
    #[error("excitation: {problem}")]
    Shape {
        /// The problem.
        problem: String,
    },
    /// The range of a joint is empty.
    #[error("excitation: limits of joint {joint} leave no limit to move")]
    Infeasible {
        /// The joint, from 1.
        joint: usize,
    },
    /// No pose at all is that far away.
    #[error(
        "excitation: no path keeps all limits; in no pose is {of} clear by more than {most_m:.3} m, asked for {asked_m} m"
    )]
    OutOfReach {
        /// The two bodies.
        of: String,
        /// More than can be had, m.
        most_m: f64,
        /// Distance asked for, m.
        asked_m: f64,
    },
    /// No start of the search ended inside all limits.
    #[error(
        "excitation: no path keeps all limits; the best one has {limit} {reached}, asked for {asked}"
    )]
    Unkept {
        /// The limit that was missed by the best start.
        limit: String,
        /// Value reached, with its unit.
        reached: String,
        /// Value asked for, with its unit.
        asked: String,
    },
    /// Torque does not tell all parameters apart on any path that was tried.
    #[error("excitation: within these limits torque cannot see all base parameters")]
    Unseen,
}

impl ExcitationError {
    /// A robot that has not `expected` joints.
    pub(super) fn joints(robot: &Robot, expected: usize) -> Self {
        Self::Shape {
            problem: format!(
                "{} joints where {expected} are expected",
                robot.joint_count()
            ),
        }
    }
}
