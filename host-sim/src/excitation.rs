//! Excitation trajectories: the finite Fourier series of eq. 17, inside the robot's limits.
//!
//! ```text
//! q(t)   = q0 + Σ_l a_l / (ω l) sin(ω l t) − b_l / (ω l) cos(ω l t)          ω = 2 π / period
//! qd(t)  =      Σ_l a_l cos(ω l t) + b_l sin(ω l t)
//! qdd(t) =      Σ_l −a_l ω l sin(ω l t) + b_l ω l cos(ω l t)
//! ```
//! The position line is eq. 17 as printed. Its printed velocity and acceleration carry the other sign of b and are not
//! the derivatives of that position; here they are.

use crate::dynamics::{Joints, ReferenceModel, State};
use crate::robot::{Limits, Robot};
use nalgebra::DMatrix;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::fmt;

/// Harmonics of the series.
pub const ORDER: usize = 5;

/// Points of one period on which the limits are checked.
const CHECK_POINTS: usize = 4000;

/// Coefficients of one joint: 2 · 5 + 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointSeries {
    /// Offset, rad.
    pub q0_rad: f64,
    /// Sine amplitudes of the position line, rad/s.
    pub a_rad_s: [f64; ORDER],
    /// Cosine amplitudes of the position line, rad/s.
    pub b_rad_s: [f64; ORDER],
}

/// What was checked before an excitation was handed out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Points of one period that were checked.
    pub points: usize,
    /// Largest distance from q = 0 over all joints, between the points included, rad.
    pub peak_q_rad: f64,
    /// Largest speed over all joints, between the points included, rad/s.
    pub peak_qd_rad_s: f64,
    /// Largest acceleration over all joints, between the points included, rad/s².
    pub peak_qdd_rad_s2: f64,
    /// Condition number of the stacked base regressor in Craig link frames, first independent columns from left to
    /// right, raw SI. It depends on frames and columns: compare it with itself only.
    pub condition_number: f64,
    /// Random candidates the best was taken from.
    pub candidates: usize,
}

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
    /// What was checked.
    pub certificate: Certificate,
}

/// Why an excitation was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
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
    /// No candidate fits the limits.
    Infeasible {
        /// Joint, from 1, whose range leaves no room.
        joint: usize,
    },
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
        }
    }
}

impl std::error::Error for ExcitationError {}

/// What a search needs to know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchConfig {
    /// Period of the fundamental, s.
    pub period_s: f64,
    /// Random candidates.
    pub candidates: usize,
    /// Share of every limit that is used.
    pub limit_share: f64,
    /// Range of every joint around zero, rad, on top of the robot's own.
    pub range_rad: f64,
}

impl Default for SearchConfig {
    fn default() -> Self {
        Self {
            period_s: 10.0,
            candidates: 200,
            limit_share: 0.95,
            range_rad: PI,
        }
    }
}

impl JointSeries {
    /// Position, velocity and acceleration at `t_s`: rad, rad/s, rad/s².
    fn at(&self, t_s: f64, omega: f64) -> (f64, f64, f64) {
        let (sin1, cos1) = (omega * t_s).sin_cos();
        let (mut sin, mut cos) = (sin1, cos1);
        let (mut q, mut qd, mut qdd) = (self.q0_rad, 0.0, 0.0);
        for l in 0..ORDER {
            let (a, b) = (self.a_rad_s[l], self.b_rad_s[l]);
            let rate = omega * (l + 1) as f64;
            q += (a * sin - b * cos) / rate;
            qd += a * cos + b * sin;
            qdd += rate * (b * cos - a * sin);
            (sin, cos) = (sin * cos1 + cos * sin1, cos * cos1 - sin * sin1);
        }
        (q, qd, qdd)
    }

    /// Bounds of the next two derivatives over all times: jerk, rad/s³, and snap, rad/s⁴.
    fn higher_bounds(&self, omega: f64) -> (f64, f64) {
        (0..ORDER).fold((0.0, 0.0), |(jerk, snap), l| {
            let rate = omega * (l + 1) as f64;
            let size = self.a_rad_s[l].hypot(self.b_rad_s[l]);
            (jerk + size * rate.powi(2), snap + size * rate.powi(3))
        })
    }

    /// Range of the position and peaks of speed and acceleration, those between the points included.
    ///
    /// A function whose second derivative is bounded by K exceeds the larger of two neighbouring samples by at most
    /// K h² / 8 between them.
    fn extremes(&self, omega: f64) -> Extremes {
        let step = TAU / omega / CHECK_POINTS as f64;
        let mut seen = Extremes {
            q: (f64::INFINITY, f64::NEG_INFINITY),
            qd: 0.0,
            qdd: 0.0,
        };
        for k in 0..CHECK_POINTS {
            let (q, qd, qdd) = self.at(k as f64 * step, omega);
            seen.q = (seen.q.0.min(q), seen.q.1.max(q));
            seen.qd = seen.qd.max(qd.abs());
            seen.qdd = seen.qdd.max(qdd.abs());
        }
        let (jerk, snap) = self.higher_bounds(omega);
        let between = step * step / 8.0;
        seen.qdd += snap * between;
        seen.qd += jerk * between;
        seen.q.0 -= seen.qdd * between;
        seen.q.1 += seen.qdd * between;
        seen
    }
}

struct Extremes {
    q: (f64, f64),
    qd: f64,
    qdd: f64,
}

impl Excitation {
    /// Best of many random candidates: the one whose stacked base regressor has the smallest condition number.
    ///
    /// Every candidate starts and ends at rest and is scaled radially into the limits, so that all are feasible.
    /// `progress` is called after every candidate.
    ///
    /// Errors: [`ExcitationError::Infeasible`], or [`ExcitationError::Shape`] when the robot has not `N` joints.
    pub fn search<const N: usize>(
        robot: &Robot,
        seed: u64,
        config: &SearchConfig,
        mut progress: impl FnMut(),
    ) -> Result<Self, ExcitationError> {
        let model = ReferenceModel::<N>::new(robot).ok_or_else(|| ExcitationError::Shape {
            problem: format!("{} joints where {N} are expected", robot.joint_count()),
        })?;
        let columns = robot.base_map().columns;
        let omega = TAU / config.period_s;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut best: Option<(f64, Self)> = None;
        for _ in 0..config.candidates.max(1) {
            let mut joints = Vec::with_capacity(N);
            for (index, joint) in robot.joints.iter().enumerate() {
                let series = random_series(&joint.limits, config, &mut random)
                    .ok_or(ExcitationError::Infeasible { joint: index + 1 })?;
                joints.push(series);
            }
            let mut candidate = Self {
                robot: robot.name.clone(),
                period_s: config.period_s,
                order: ORDER,
                seed,
                certificate: certify(&joints, omega, config.candidates),
                joints,
            };
            let condition = candidate.condition_number(&model, &columns);
            candidate.certificate.condition_number = condition;
            if best.as_ref().is_none_or(|(lowest, _)| condition < *lowest) {
                best = Some((condition, candidate));
            }
            progress();
        }
        best.map(|(_, excitation)| excitation)
            .ok_or(ExcitationError::Infeasible { joint: 1 })
    }

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

    /// Condition number of the base regressor stacked over 100 instants of the period.
    fn condition_number<const N: usize>(
        &self,
        model: &ReferenceModel<N>,
        columns: &[usize],
    ) -> f64 {
        const INSTANTS: usize = 100;
        let mut standard = DMatrix::zeros(INSTANTS * N, 11 * N);
        for k in 0..INSTANTS {
            let state = self.at::<N>(self.period_s * k as f64 / INSTANTS as f64);
            model.regressor_into(&state, &mut standard, k * N);
        }
        let base = standard.select_columns(columns);
        let values = (base.transpose() * base).symmetric_eigenvalues();
        (values.max() / values.min().max(f64::MIN_POSITIVE)).sqrt()
    }
}

/// A random series inside the limits; `None` where they leave no room.
///
/// Rest at t = 0, and so at the period's end: Σ a_l = 0 and Σ l b_l = 0.
fn random_series(
    limits: &Limits,
    config: &SearchConfig,
    random: &mut ChaCha8Rng,
) -> Option<JointSeries> {
    let low = limits.position.0.max(-config.range_rad) * config.limit_share;
    let high = limits.position.1.min(config.range_rad) * config.limit_share;
    if low.partial_cmp(&high) != Some(std::cmp::Ordering::Less) {
        return None;
    }
    let omega = TAU / config.period_s;
    let mut normal = || random.sample::<f64, _>(StandardNormal);
    let mut a: [f64; ORDER] = std::array::from_fn(|_| normal());
    let mut b: [f64; ORDER] = std::array::from_fn(|_| normal());
    let a_mean = a.iter().sum::<f64>() / ORDER as f64;
    let weight = |l: usize| (l + 1) as f64;
    let b_mean = (0..ORDER).map(|l| weight(l) * b[l]).sum::<f64>()
        / (0..ORDER).map(|l| weight(l).powi(2)).sum::<f64>();
    for l in 0..ORDER {
        a[l] -= a_mean;
        b[l] -= b_mean * weight(l);
    }
    let mut series = JointSeries {
        q0_rad: 0.0,
        a_rad_s: a,
        b_rad_s: b,
    };
    let seen = series.extremes(omega);
    let scale = (limits.velocity * config.limit_share / seen.qd)
        .min(limits.acceleration * config.limit_share / seen.qdd)
        .min((high - low) / (seen.q.1 - seen.q.0));
    for value in series.a_rad_s.iter_mut().chain(&mut series.b_rad_s) {
        *value *= scale;
    }
    // The offset is drawn from the room that the swing leaves.
    let (q_low, q_high) = (seen.q.0 * scale, seen.q.1 * scale);
    let room = ((high - low) - (q_high - q_low)).max(0.0);
    series.q0_rad = low - q_low + room * random.random::<f64>();
    Some(series)
}

fn certify(joints: &[JointSeries], omega: f64, candidates: usize) -> Certificate {
    let mut certificate = Certificate {
        points: CHECK_POINTS,
        peak_q_rad: 0.0,
        peak_qd_rad_s: 0.0,
        peak_qdd_rad_s2: 0.0,
        condition_number: f64::INFINITY,
        candidates,
    };
    for series in joints {
        let seen = series.extremes(omega);
        let farthest = seen.q.1.max(-seen.q.0);
        certificate.peak_q_rad = certificate.peak_q_rad.max(farthest);
        certificate.peak_qd_rad_s = certificate.peak_qd_rad_s.max(seen.qd);
        certificate.peak_qdd_rad_s2 = certificate.peak_qdd_rad_s2.max(seen.qdd);
    }
    certificate
}

#[cfg(test)]
mod tests {
    use super::*;

    fn searched(seed: u64) -> (Robot, Excitation) {
        let robot = Robot::load("ur5").expect("built in");
        let config = SearchConfig {
            candidates: 3,
            ..SearchConfig::default()
        };
        let excitation = Excitation::search::<6>(&robot, seed, &config, || {}).expect("feasible");
        (robot, excitation)
    }

    #[test]
    fn limits_hold_on_a_grid_finer_than_the_checked_one() {
        for seed in 0..10 {
            let (robot, excitation) = searched(seed);
            for k in 0..20_011 {
                let state = excitation.at::<6>(10.0 * f64::from(k) / 20_011.0);
                for (j, joint) in robot.joints.iter().enumerate() {
                    assert!(state.q[j].abs() <= PI, "seed {seed}, joint {j}");
                    assert!(
                        state.qd[j].abs() <= joint.limits.velocity,
                        "seed {seed}, joint {j}"
                    );
                    assert!(
                        state.qdd[j].abs() <= joint.limits.acceleration,
                        "seed {seed}, joint {j}"
                    );
                }
            }
        }
    }

    #[test]
    fn every_joint_uses_some_limit_and_rests_at_both_ends() {
        let (_, excitation) = searched(1);
        for t_s in [0.0, 10.0] {
            let state = excitation.at::<6>(t_s);
            assert!(state.qd.amax() < 1e-9 && state.qdd.amax() < 1e-9);
        }
        let omega = TAU / excitation.period_s;
        for series in &excitation.joints {
            let seen = series.extremes(omega);
            let used = (seen.qd / PI)
                .max(seen.qdd / 10.0)
                .max((seen.q.1 - seen.q.0) / (2.0 * PI));
            assert!((0.94..=0.9501).contains(&used), "{used}");
        }
    }

    #[test]
    fn velocity_and_acceleration_are_derivatives_of_the_position_line() {
        let (_, excitation) = searched(2);
        let h = 1e-4;
        for k in 0..50 {
            let t_s = 0.2 * f64::from(k);
            let (before, here, after) = (
                excitation.at::<6>(t_s - h),
                excitation.at::<6>(t_s),
                excitation.at::<6>(t_s + h),
            );
            let qd = (after.q - before.q) / (2.0 * h);
            let qdd = (after.qd - before.qd) / (2.0 * h);
            // Central differences are off by jerk · h² / 6 and snap · h² / 6.
            assert!((qd - here.qd).amax() < 1e-6);
            assert!((qdd - here.qdd).amax() < 1e-5);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_file_and_another_seed_another() {
        let text = |seed| serde_json::to_string(&searched(seed).1).expect("serialises");
        assert_eq!(text(7), text(7));
        assert_ne!(text(7), text(8));
        let back: Excitation = serde_json::from_str(&text(7)).expect("parses");
        assert_eq!(back, searched(7).1);
    }
}
