//! Why there is no excitation.

use std::fmt;

/// Why an excitation was refused, or not found.
#[derive(Clone, Debug, PartialEq)]
pub enum ExcitationError {
    /// It belongs to another robot.
    Robot {
        /// Robot of the file.
        found: String,
        /// Robot asked for.
        expected: String,
    },
    /// Another number of joints or harmonics than expected, or a coefficient or period that makes no sense.
    Shape {
        /// What is wrong.
        problem: String,
    },
    /// The range of a joint is empty.
    Infeasible {
        /// The joint, from 1.
        joint: usize,
    },
    /// No pose at all is that far away.
    OutOfReach {
        /// What is to be kept clear of what.
        of: String,
        /// More than can be had, m.
        most_m: f64,
        /// What is asked for, m.
        asked_m: f64,
    },
    /// No start of the search ended inside all limits.
    Unkept {
        /// The limit that was missed by the best start.
        limit: String,
        /// What was reached, with its unit.
        reached: String,
        /// What is asked for, with its unit.
        asked: String,
    },
    /// Torque does not tell all parameters apart on any path that was tried.
    Unseen,
}

impl fmt::Display for ExcitationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Robot { found, expected } => {
                write!(f, "excitation is for robot '{found}', not '{expected}'")
            }
            Self::Shape { problem } => write!(f, "excitation: {problem}"),
            Self::Infeasible { joint } => {
                write!(
                    f,
                    "excitation: limits of joint {joint} leave no room to move"
                )
            }
            Self::OutOfReach {
                of,
                most_m,
                asked_m,
            } => {
                write!(
                    f,
                    "excitation: no path keeps all limits; in no pose is {of} clear by more than {most_m:.3} m, asked for {asked_m} m"
                )
            }
            Self::Unkept {
                limit,
                reached,
                asked,
            } => {
                write!(
                    f,
                    "excitation: no path keeps all limits; the best one has {limit} {reached}, asked for {asked}"
                )
            }
            Self::Unseen => {
                f.write_str("excitation: within these limits torque cannot see all base parameters")
            }
        }
    }
}

impl std::error::Error for ExcitationError {}
