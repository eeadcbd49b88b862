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
mod error;
mod information;
mod objective;
pub mod page;
mod path;
mod quick;
mod rates;
mod rows;
mod search;
mod series;
mod slopes;
mod variables;

pub use certificate::{Certificate, LimitCheck};
pub use error::ExcitationError;
pub use information::Criterion;
pub use path::Excitation;
pub use quick::QuickConfig;
pub use search::{SearchConfig, optimise};
pub use series::{JointSeries, ORDER};
