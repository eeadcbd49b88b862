//! An excitation as a board takes it.

use super::series::JointSeries;
use super::{Excitation, ExcitationError, ORDER};
use foretorque_link::excitation::{self as board, ExcitationProgram, HARMONICS, MotionBounds};
use std::f64::consts::TAU;

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
        let joints: &[JointSeries; N] =
            self.joints
                .as_slice()
                .try_into()
                .map_err(|_| ExcitationError::Shape {
                    problem: format!("{} joints where {N} are expected", self.joints.len()),
                })?;
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
                let seen = series.extremes(omega, POINTS);
                MotionBounds {
                    position_rad: (seen.q.0 as f32, seen.q.1 as f32),
                    velocity_rad_s: seen.qd as f32,
                    acceleration_rad_s2: seen.qdd as f32,
                }
            }),
        })
    }
}
