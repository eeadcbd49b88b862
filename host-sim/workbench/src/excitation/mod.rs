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
mod information;
mod objective;
pub mod page;
mod rates;
mod rows;
mod search;
mod series;

pub use certificate::{Certificate, LimitCheck};
pub use information::Criterion;
pub use objective::SearchConfig;
pub use search::optimise;
pub use series::{JointSeries, ORDER};

use crate::Refusal;
use crate::dynamics::{Motion, State};
use crate::metrics::condition_of;
use crate::robot::Robot;
use foretorque_link::excitation::{self as board, ExcitationProgram, HARMONICS, MotionBounds};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rows::{Frames, Rows};
use serde::{Deserialize, Serialize};
use series::Extremes;
use std::f64::consts::{PI, TAU};

const _: () = assert!(ORDER == HARMONICS);

/// Largest speed, rad/s, and acceleration, rad/s², at the begin of an excitation: those of rounded coefficients.
const REST: (f64, f64) = (1e-3, 1e-2);
/// Longest period, s: every millisecond of it is a row.
pub const MOST_PERIOD_S: f64 = 1000.0;
/// Points on which the bounds are taken; what lies between them is bounded.
const POINTS: usize = 10_000;
/// Share of every limit that a quick search uses.
const LIMIT_SHARE: f64 = 0.95;
/// Points of one period on which the limits are checked.
const CHECK_POINTS: usize = 4000;

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
    /// The series of all joints of a robot, without a certificate.
    fn of(robot: &Robot, period_s: f64, seed: u64, joints: Vec<JointSeries>) -> Self {
        Self {
            robot: robot.name.clone(),
            period_s,
            order: ORDER,
            seed,
            joints,
            certificate: None,
        }
    }

    /// The motion at `t_s`, which may lie beyond the first period.
    pub fn motion(&self, t_s: f64) -> Motion {
        let omega = TAU / self.period_s;
        let mut motion = Motion::zeros(self.joints.len());
        for (j, series) in self.joints.iter().enumerate() {
            (motion.q[j], motion.qd[j], motion.qdd[j]) = series.at(t_s, omega);
        }
        motion
    }

    /// Motions at `count` instants of the first period.
    fn instants(&self, count: usize) -> Vec<Motion> {
        let t_s = |k: usize| self.period_s * k as f64 / count as f64;
        (0..count).map(|k| self.motion(t_s(k))).collect()
    }

    /// See [`motion`](Self::motion). Panics for another number of joints.
    pub fn at<const N: usize>(&self, t_s: f64) -> State<N> {
        self.motion(t_s).into()
    }

    /// Checks that the excitation is one for this robot.
    ///
    /// Errors: a line with the reason why it is none.
    pub fn check(&self, robot: &Robot) -> Result<(), Refusal> {
        let (found, expected, period_s) = (&self.robot, &robot.name, self.period_s);
        if found != expected {
            let problem = format!("excitation is for robot '{found}', not '{expected}'");
            return Err(Refusal(problem));
        }
        if self.order != ORDER {
            let problem = format!("order {} where {ORDER} is expected", self.order);
            return Err(refused(problem));
        }
        if self.joints.len() != robot.joint_count() {
            return Err(other_joints(self.joints.len(), robot.joint_count()));
        }
        if !(period_s > 0.0 && period_s <= MOST_PERIOD_S) {
            let within = format!("not above 0 and at most {MOST_PERIOD_S} s");
            return Err(refused(format!("period of {period_s} s, {within}")));
        }
        let (begin, ends) = (self.motion(0.0), REST);
        let most = |values: &[f64]| {
            values
                .iter()
                .fold(0.0_f64, |most, value| most.max(value.abs()))
        };
        let (speed, acceleration) = (most(&begin.qd), most(&begin.qdd));
        if !(speed <= ends.0 && acceleration <= ends.1) {
            let problem =
                format!("it begins at {speed:.4} rad/s and {acceleration:.4} rad/s², not at rest");
            return Err(refused(problem));
        }
        Ok(())
    }

    /// Checks limits of torque and clearance anew: those of the robot may have changed since the search.
    ///
    /// Errors: a line with the first that is broken.
    pub fn check_torque_and_clearance(&self, robot: &Robot) -> Result<(), Refusal> {
        match certificate::broken(robot, self).first() {
            None => Ok(()),
            Some(check) => Err(refused(format!(
                "{} of {} reaches {:.3} {unit}, its limit is {:.3} {unit}: repeat excite",
                check.limit,
                check.of,
                check.worst,
                check.allowed,
                unit = check.unit
            ))),
        }
    }

    /// The series in f32, with the bounds it keeps: taken anew from the coefficients, as a certificate in a file proves
    /// nothing.
    ///
    /// * `periods` how often it is played; 0 until stopped
    /// * `tracking_rad` tracking error that ends it, rad
    ///
    /// Errors: it has not `N` joints, or a period that the board cannot count.
    pub fn program<const N: usize>(
        &self,
        arm_hash: u32,
        periods: u16,
        tracking_rad: f32,
    ) -> Result<ExcitationProgram<N>, Refusal> {
        let joints: Result<&[JointSeries; N], _> = self.joints.as_slice().try_into();
        let joints = joints.map_err(|_| other_joints(self.joints.len(), N))?;
        let period_us = (self.period_s * 1e6).round();
        if !(1.0..=f64::from(u32::MAX)).contains(&period_us) {
            return Err(refused(format!("period of {} s", self.period_s)));
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

    /// Best of so many random `candidates`: the one whose stacked base regressor, in the frames of the board, has the smallest
    /// condition number. Keeps limits of position, speed and acceleration, and ignores table and links.
    ///
    /// Every candidate starts and ends at rest and is scaled radially into the limits, so that all are feasible.
    /// `progress` is called after every candidate.
    ///
    /// Errors: the range of a joint is empty.
    pub fn quick(
        robot: &Robot,
        seed: u64,
        period_s: f64,
        candidates: usize,
        mut progress: impl FnMut(),
    ) -> Result<Self, Refusal> {
        let rows = Rows::new(robot, Frames::Board);
        let limits = Extremes::of_limits(robot, PI, LIMIT_SHARE)?;
        let omega = TAU / period_s;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = || {
            let series =
                |limits| JointSeries::random(limits, omega, CHECK_POINTS, 1.0, &mut random);
            let joints = limits.iter().map(series).collect();
            let candidate = Self::of(robot, period_s, seed, joints);
            let condition = candidate.condition_number(&rows);
            progress();
            (condition, candidate)
        };
        let mut best = draw();
        for _ in 1..candidates {
            let candidate = draw();
            if candidate.0 < best.0 {
                best = candidate;
            }
        }
        Ok(best.1)
    }

    /// Condition number of the rigid base regressor, rotors included, stacked over 100 instants of the period.
    fn condition_number(&self, rows: &Rows) -> f64 {
        let rigid = rows.count() - 2 * rows.joints();
        let stacked = rows.stacked(&self.instants(100));
        let stacked = stacked.columns(0, rigid).into_owned();
        condition_of(&stacked.tr_mul(&stacked))
    }
}

fn refused(problem: impl std::fmt::Display) -> Refusal {
    Refusal::of("excitation", problem)
}

/// The refusal of a robot that has not `expected` joints.
fn other_joints(found: usize, expected: usize) -> Refusal {
    refused(format!("{found} joints where {expected} are expected"))
}

/// The refusal of paths whose torque does not distinguish all parameters.
fn unseen() -> Refusal {
    refused(
        "within these limits torque cannot see all base parameters: widen the motion (--range-rad, --velocity-limits), or correct --torque-limits",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quick(seed: u64) -> (Robot, Excitation) {
        let robot = Robot::load("ur5").expect("built in");
        let excitation = Excitation::quick(&robot, seed, 10.0, 3, || {}).expect("feasible");
        (robot, excitation)
    }

    #[test]
    fn limits_hold_on_a_grid_finer_than_the_checked_one() {
        for seed in 0..10 {
            let (robot, excitation) = quick(seed);
            for k in 0..20_011 {
                let state = excitation.at::<6>(10.0 * f64::from(k) / 20_011.0);
                for (j, joint) in robot.joints.iter().enumerate() {
                    let values = [state.q[j], state.qd[j], state.qdd[j]].map(f64::abs);
                    let limits = [PI, joint.limits.velocity, joint.limits.acceleration];
                    let mut pairs = values.iter().zip(limits);
                    let kept = pairs.all(|(value, limit)| *value <= limit);
                    assert!(kept, "seed {seed}, joint {j}");
                }
            }
        }
    }

    #[test]
    fn every_joint_uses_some_limit_and_rests_at_both_ends() {
        let (_, excitation) = quick(1);
        for t_s in [0.0, 10.0] {
            let state = excitation.at::<6>(t_s);
            assert!(state.qd.amax() < 1e-9 && state.qdd.amax() < 1e-9);
        }
        let omega = TAU / excitation.period_s;
        for series in &excitation.joints {
            let extremes = series.extremes(omega, CHECK_POINTS);
            let used = (extremes.qd / PI)
                .max(extremes.qdd / 10.0)
                .max((extremes.q.1 - extremes.q.0) / (2.0 * PI));
            assert!((0.94..=0.9501).contains(&used), "{used}");
        }
    }

    #[test]
    fn torque_and_clearance_are_those_of_the_robot_now() {
        let mut robot = Robot::load("ur5").expect("built in");
        let shipped = include_str!("../../../paths/ur5-excitation.json");
        let excitation: Excitation = serde_json::from_str(shipped).expect("an excitation");
        assert_eq!(excitation.check_torque_and_clearance(&robot), Ok(()));
        let limit = robot.joints[1].limits.torque;
        robot.joints[1].limits.torque = 20.0;
        let broken = excitation
            .check_torque_and_clearance(&robot)
            .expect_err("weak");
        assert!(
            broken
                .to_string()
                .contains("torque of shoulder_lift reaches"),
            "{broken}"
        );
        robot.joints[1].limits.torque = limit;
        robot.workspace.table_height = Some(1.0);
        let broken = excitation
            .check_torque_and_clearance(&robot)
            .expect_err("high");
        assert!(broken.to_string().contains("clearance of "), "{broken}");
    }

    #[test]
    fn a_series_that_does_not_begin_at_rest_is_none() {
        let (robot, mut excitation) = quick(1);
        assert!(excitation.check(&robot).is_ok());
        excitation.joints[2].a_rad_s[0] += 0.1;
        let refused = excitation.check(&robot).expect_err("it moves").to_string();
        assert!(refused.contains("it begins at 0.1000 rad/s"), "{refused}");
    }

    #[test]
    fn velocity_and_acceleration_are_derivatives_of_position() {
        let (_, excitation) = quick(2);
        let h = 1e-4;
        for k in 0..50 {
            let t_s = 0.2 * f64::from(k);
            let [before, here, after] = [-h, 0.0, h].map(|by| excitation.at::<6>(t_s + by));
            let qd = (after.q - before.q) / (2.0 * h);
            let qdd = (after.qd - before.qd) / (2.0 * h);
            // Central differences are off by jerk · h² / 6 and snap · h² / 6.
            assert!((qd - here.qd).amax() < 1e-6);
            assert!((qdd - here.qdd).amax() < 1e-5);
        }
    }
}
