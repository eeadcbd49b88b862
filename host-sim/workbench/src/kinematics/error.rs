//! Why no joint positions put the tool where it is wanted.

use std::fmt;

/// Why a pose has no joint positions, or none to go on with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InverseError {
    /// The wrist would be farther from the shoulder than both links together are long.
    TooFar {
        /// Distance of the wrist from the axis of joint 2, m.
        distance_m: f64,
        /// Length of both links, m.
        reach_m: f64,
    },
    /// The wrist would be nearer to the shoulder than the difference of both links.
    TooNear {
        /// Distance of the wrist from the axis of joint 2, m.
        distance_m: f64,
        /// Difference of both lengths, m.
        least_m: f64,
    },
    /// The wrist would be nearer to the axis of joint 1 than the arm's sideways offset.
    InColumn {
        /// Distance of the wrist from the axis of joint 1, m.
        distance_m: f64,
        /// The sideways offset, m.
        least_m: f64,
    },
    /// The numeric search ended elsewhere.
    Missed {
        /// What is left of the position, m.
        left_m: f64,
        /// What is left of the orientation, rad.
        left_rad: f64,
    },
    /// There are solutions, all of them outside the joints' ranges.
    OutsideRanges {
        /// How many there are.
        solutions: usize,
    },
    /// The arm cannot move the tool in every direction there: the way on is not determined.
    Singular {
        /// What is in line.
        posture: &'static str,
    },
}

impl fmt::Display for InverseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFar {
                distance_m,
                reach_m,
            } => write!(
                f,
                "out of reach: the wrist would be {distance_m:.3} m from the axis of joint 2, the arm is {reach_m:.3} m long"
            ),
            Self::TooNear {
                distance_m,
                least_m,
            } => write!(
                f,
                "out of reach: the wrist would be {distance_m:.3} m from the axis of joint 2, folded it is {least_m:.3} m"
            ),
            Self::InColumn {
                distance_m,
                least_m,
            } => write!(
                f,
                "out of reach: the wrist would be {distance_m:.3} m from the axis of joint 1, the arm passes it at {least_m:.3} m"
            ),
            Self::Missed { left_m, left_rad } => write!(
                f,
                "out of reach: the nearest pose found is {left_m:.3} m and {left_rad:.3} rad away"
            ),
            Self::OutsideRanges { solutions } => write!(
                f,
                "out of reach: all {solutions} solutions are outside the joints' ranges"
            ),
            Self::Singular { posture } => write!(f, "singular: {posture}"),
        }
    }
}

impl std::error::Error for InverseError {}
