//! The excitation of all joints, and its form on a board.

use super::certificate::Certificate;
use super::error::ExcitationError;
use super::series::{JointSeries, ORDER};
use crate::dynamics::{Motion, State};
use crate::robot::Robot;
use foretorque_link::excitation::{self as board, ExcitationProgram, HARMONICS, MotionBounds};
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
    /// Checked limits. Never read back: a certificate holds only for the coefficients it was computed from.
    #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Box<Certificate>>,
}

impl Excitation {
    /// The motion at `t_s`, which may lie beyond the first period.
    pub fn motion(&self, t_s: f64) -> Motion {
        let omega = TAU / self.period_s;
        let mut motion = Motion::zeros(self.joints.len());
        for (j, series) in self.joints.iter().enumerate() {
            (motion.q[j], motion.qd[j], motion.qdd[j]) = series.at(t_s, omega);
        }
        motion
    }

    /// See [`motion`](Self::motion). Panics for another number of joints.
    pub fn at<const N: usize>(&self, t_s: f64) -> State<N> {
        self.motion(t_s).into()
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
            let (found, expected) = (self.joints.len(), robot.joint_count());
            return Err(ExcitationError::joint_count(found, expected));
        }
        if !(self.period_s.is_finite() && self.period_s > 0.0) {
            return shape(format!("period of {} s", self.period_s));
        }
        Ok(())
    }
}

const _: () = assert!(ORDER == HARMONICS);

/// Points on which the bounds are taken; what lies between them is bounded.
const POINTS: usize = 10_000;

impl Excitation {
    /// The series in f32, with the bounds it keeps: taken anew from the coefficients, as a certificate in a file proves
    /// nothing.
    ///
    /// * `periods` how often it is played; 0 until stopped      * `tracking_rad` tracking error that ends it, rad
    ///
    /// Errors: [`ExcitationError::Shape`] when it has not `N` joints or a period that the board cannot count.
    pub fn program<const N: usize>(
        &self,
        arm_hash: u32,
        periods: u16,
        tracking_rad: f32,
    ) -> Result<ExcitationProgram<N>, ExcitationError> {
        let joints: &[JointSeries; N] = self
            .joints
            .as_slice()
            .try_into()
            .map_err(|_| ExcitationError::joint_count(self.joints.len(), N))?;
        let period_us = (self.period_s * 1e6).round();
        if !(1.0..=f64::from(u32::MAX)).contains(&period_us) {
            return Err(ExcitationError::Shape {
                problem: format!("period of {} s", self.period_s),
            });
        }
        let omega = TAU / self.period_s;
        Ok(ExcitationProgram {
            arm_hash,
            period_us: period_us as u32,
            periods,
            tracking_rad,
            joints: joints.map(|series| board::JointSeries {
                q0_rad: series.q0_rad as f32,
                a_rad_s: series.a_rad_s.map(|a| a as f32),
                b_rad_s: series.b_rad_s.map(|b| b as f32),
            }),
            certificate: joints.map(|series| {
                let extremes = series.extremes(omega, POINTS);
                MotionBounds {
                    position_rad: (extremes.q.0 as f32, extremes.q.1 as f32),
                    velocity_rad_s: extremes.qd as f32,
                    acceleration_rad_s2: extremes.qdd as f32,
                }
            }),
        })
    }
}
