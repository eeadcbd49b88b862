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
mod clearance;
mod descent;
mod error;
mod information;
mod objective;
pub mod page;
mod quick;
mod rates;
mod rows;
mod search;
mod series;
mod upload;
mod variables;

pub use certificate::{Certificate, LimitCheck};
pub use error::ExcitationError;
pub use information::Criterion;
pub use quick::QuickConfig;
pub use search::{SearchConfig, optimise};
pub use series::{JointSeries, ORDER};

use crate::dynamics::{Joints, State};
use crate::robot::Robot;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A periodic excitation of all joints, at rest at both ends of the period.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Excitation {
    /// Name of the robot.
    pub robot: String,
    /// Period of the fundamental, s.
    pub period_s: f64,
    /// Number of harmonics, [`ORDER`].
    pub order: usize,
    /// Seed of the search.
    pub seed: u64,
    /// Coefficients, one entry a joint.
    pub joints: Vec<JointSeries>,
    /// The checks. Never read back: a certificate holds only for the coefficients it was computed from.
    #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Box<Certificate>>,
}

impl Excitation {
    /// The motion at `t_s`, which may lie beyond the first period.
    pub fn at<const N: usize>(&self, t_s: f64) -> State<N> {
        let omega = TAU / self.period_s;
        let zero = Joints::zeros();
        let mut state = State {
            q: zero,
            qd: zero,
            qdd: zero,
        };
        for (j, series) in self.joints.iter().take(N).enumerate() {
            (state.q[j], state.qd[j], state.qdd[j]) = series.at(t_s, omega);
        }
        state
    }

    /// Checks that the excitation is one for this robot.
    ///
    /// Errors: [`ExcitationError`].
    pub fn check(&self, robot: &Robot) -> Result<(), ExcitationError> {
        let shape = |problem: String| Err(ExcitationError::Shape { problem });
        if self.robot != robot.name {
            return Err(ExcitationError::Robot {
                found: self.robot.clone(),
                expected: robot.name.clone(),
            });
        }
        if self.order != ORDER {
            return shape(format!("order {} where {ORDER} is expected", self.order));
        }
        if self.joints.len() != robot.joint_count() {
            return shape(format!(
                "{} joints where {} are expected",
                self.joints.len(),
                robot.joint_count()
            ));
        }
        if !(self.period_s.is_finite() && self.period_s > 0.0) {
            return shape(format!("period of {} s", self.period_s));
        }
        Ok(())
    }
}
