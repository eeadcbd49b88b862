//! Forward kinematics, Jacobian and inverse kinematics of the tool.
//!
//! The tool flange is the tip of the description: the frame `flange` of a TOML file where it gives one, else the far end
//! of the last link (its DH frame); of a URDF the tip link. All poses are expressed in the base frame. Twists are six
//! numbers: velocity of the flange's origin, m/s, then angular velocity, rad/s, both along the axes of the base.
//!
//! `chain` (any arm: forward, Jacobian) → `ur` (closed form) or damped least squares → [`Inverse`].

mod chain;
mod inverse;
mod ur;

pub use chain::{Chain, Twist, rotation_vector};
pub use inverse::Inverse;

/// Reason for which a pose has no joint positions, or none that continues a branch.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InverseError {
    /// The wrist would be farther from the shoulder than both links together are long.
    #[error(
        "out of reach: the wrist would be {distance_m:.3} m from the axis of joint 2, the arm is {reach_m:.3} m long"
    )]
    TooFar {
        /// Distance of the wrist from the axis of joint 2, m.
        distance_m: f64,
        /// Length of both links, m.
        reach_m: f64,
    },
    /// The wrist would be nearer to the shoulder than the difference of both links.
    #[error(
        "out of reach: the wrist would be {distance_m:.3} m from the axis of joint 2, folded it is {least_m:.3} m"
    )]
    TooNear {
        /// Distance of the wrist from the axis of joint 2, m.
        distance_m: f64,
        /// Difference of both lengths, m.
        least_m: f64,
    },
    /// The wrist would be nearer to the axis of joint 1 than the arm's sideways offset.
    #[error(
        "out of reach: the wrist would be {distance_m:.3} m from the axis of joint 1, the arm passes it at {least_m:.3} m"
    )]
    InColumn {
        /// Distance of the wrist from the axis of joint 1, m.
        distance_m: f64,
        /// The sideways offset, m.
        least_m: f64,
    },
    /// The numeric search ended elsewhere.
    #[error("out of reach: the nearest pose found is {left_m:.3} m and {left_rad:.3} rad away")]
    Missed {
        /// Remaining error of the position, m.
        left_m: f64,
        /// Remaining error of the orientation, rad.
        left_rad: f64,
    },
    /// There are solutions, all of them outside the joints' ranges.
    #[error("out of reach: all {solutions} solutions are outside the joints' ranges")]
    OutsideRanges {
        /// Number of solutions.
        solutions: usize,
    },
    /// The arm cannot move the tool in every direction there: the way on is not determined.
    #[error("singular: {posture}")]
    Singular {
        /// Parts that are in line.
        posture: &'static str,
    },
}
