//! Excitation trajectories: the finite Fourier series of eq. 17, inside the robot's limits.
//!
//! ```text
//! q(t)   = q0 + Σ_l a_l / (ω l) sin(ω l t) − b_l / (ω l) cos(ω l t)          ω = 2 π / period
//! qd(t)  =      Σ_l a_l cos(ω l t) + b_l sin(ω l t)
//! qdd(t) =      Σ_l −a_l ω l sin(ω l t) + b_l ω l cos(ω l t)
//! ```
//! The position line is eq. 17 as printed. Its printed velocity and acceleration carry the other sign of b and are not
//! the derivatives of that position; here they are.
//!
//! [`optimise`] searches for the best one and certifies it; [`Excitation::quick`] takes the best of many random ones.

mod certificate;
mod certify;
mod clearance;
mod information;
mod objective;
pub mod page;
mod path;
mod rates;
mod rows;
mod search;
mod series;

pub use certificate::{Certificate, LimitCheck};
pub use information::Criterion;
pub use path::{Excitation, QuickConfig};
pub use search::{SearchConfig, optimise};
pub use series::{JointSeries, ORDER};

/// Reason for which an excitation is refused, or not found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExcitationError {
    /// It belongs to another robot.
    #[error("excitation is for robot '{found}', not '{expected}'")]
    Robot {
        /// Robot of the file.
        found: String,
        /// Robot expected.
        expected: String,
    },
    /// Another number of joints or harmonics than expected, or a coefficient or period that makes no sense.
    #[error("excitation: {problem}")]
    Shape {
        /// Reason.
        problem: String,
    },
    /// The range of a joint is empty.
    #[error("excitation: limits of joint {joint} leave no room to move")]
    Infeasible {
        /// The joint, from 1.
        joint: usize,
    },
    /// No motion that was tried, however slow, keeps the torque limits of some joints: what each of them needs.
    #[error("excitation: {}: correct it with --torque-limits", .0.join("; "))]
    TooWeak(Vec<String>),
    /// No pose has that clearance.
    #[error(
        "excitation: no path keeps all limits; in no pose is {of} clear by more than {largest_m:.3} m, asked for {required_m} m"
    )]
    OutOfReach {
        /// Names of the two bodies.
        of: String,
        /// Upper bound of the clearance over all poses, m.
        largest_m: f64,
        /// Distance that is required, m.
        required_m: f64,
    },
    /// No start of the search ended inside all limits.
    #[error(
        "excitation: no path keeps all limits; the best one has {}{mend}", .missed.join("; ")
    )]
    Unkept {
        /// Limits of the worst kind that the best start missed, each with the value reached and the one required.
        missed: Vec<String>,
        /// Option that mends it; empty where there is none.
        mend: &'static str,
    },
    /// Torque does not distinguish all parameters on any path that was tried.
    #[error("excitation: within these limits torque cannot see all base parameters")]
    Unseen,
}

impl ExcitationError {
    /// The error of a robot that has not `expected` joints.
    pub(super) fn joint_count(found: usize, expected: usize) -> Self {
        Self::Shape {
            problem: format!("{found} joints where {expected} are expected"),
        }
    }
}
