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
pub use objective::SearchConfig;
pub use path::{Excitation, QuickConfig};
pub use search::optimise;
pub use series::{JointSeries, ORDER};

use crate::Refusal;

/// The refusal of an excitation.
fn refused(problem: impl std::fmt::Display) -> Refusal {
    Refusal::of("excitation", problem)
}

/// The refusal of a robot that has not `expected` joints.
fn other_joints(found: usize, expected: usize) -> Refusal {
    refused(format!("{found} joints where {expected} are expected"))
}

/// The refusal of paths whose torque does not distinguish all parameters.
fn unseen() -> Refusal {
    refused("within these limits torque cannot see all base parameters")
}
