//! A quick excitation: the best of many random series, without the time of a search.

use super::error::ExcitationError;
use super::path::Excitation;
use super::rows::{Frames, Rows};
use super::series::{Extremes, JointSeries, ORDER};
use crate::robot::Robot;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Points of one period on which the limits are checked.
const CHECK_POINTS: usize = 4000;

/// Configuration of a quick search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuickConfig {
    /// Period of the fundamental, s.
    pub period_s: f64,
    /// Random candidates.
    pub candidates: usize,
    /// Share of every limit that is used.
    pub limit_share: f64,
    /// Range of every joint around zero, rad, on top of the robot's own.
    pub range_rad: f64,
}

impl Default for QuickConfig {
    fn default() -> Self {
        Self {
            period_s: 10.0,
            candidates: 200,
            limit_share: 0.95,
            range_rad: PI,
        }
    }
}

impl Excitation {
    /// Best of many random candidates: the one whose stacked base regressor, in the frames of the board, has the smallest
    /// condition number. Keeps limits of position, speed and acceleration, and ignores table and links.
    ///
    /// Every candidate starts and ends at rest and is scaled radially into the limits, so that all are feasible.
    /// `progress` is called after every candidate.
    ///
    /// Errors: [`ExcitationError::Infeasible`].
    pub fn quick(
        robot: &Robot,
        seed: u64,
        config: &QuickConfig,
        mut progress: impl FnMut(),
    ) -> Result<Self, ExcitationError> {
        let rows = Rows::new(robot, Frames::Board);
        let limits = Extremes::of_limits(robot, config.range_rad, config.limit_share)?;
        let omega = TAU / config.period_s;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut best: Option<(f64, Self)> = None;
        for _ in 0..config.candidates.max(1) {
            let joints: Vec<JointSeries> = limits
                .iter()
                .map(|limits| JointSeries::random(limits, omega, CHECK_POINTS, 1.0, &mut random))
                .collect();
            let candidate = Self {
                robot: robot.name.clone(),
                period_s: config.period_s,
                order: ORDER,
                seed,
                joints,
                certificate: None,
            };
            let condition = candidate.condition_number(&rows);
            if best.as_ref().is_none_or(|(lowest, _)| condition < *lowest) {
                best = Some((condition, candidate));
            }
            progress();
        }
        best.map(|(_, excitation)| excitation)
            .ok_or(ExcitationError::Infeasible { joint: 1 })
    }

    /// Condition number of the rigid base regressor, rotors included, stacked over 100 instants of the period.
    fn condition_number(&self, rows: &Rows) -> f64 {
        const INSTANTS: usize = 100;
        let rigid = rows.count() - 2 * rows.joints();
        let instants =
            (0..INSTANTS).map(|k| self.motion(self.period_s * k as f64 / INSTANTS as f64));
        let stacked = rows.stacked(&instants.collect::<Vec<_>>());
        let stacked = stacked.columns(0, rigid).into_owned();
        let values = stacked.tr_mul(&stacked).symmetric_eigenvalues();
        (values.max() / values.min().max(f64::MIN_POSITIVE)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quick(seed: u64) -> (Robot, Excitation) {
        let robot = Robot::load("ur5").expect("built in");
        let config = QuickConfig {
            candidates: 3,
            ..QuickConfig::default()
        };
        let excitation = Excitation::quick(&robot, seed, &config, || {}).expect("feasible");
        (robot, excitation)
    }

    #[test]
    fn limits_hold_on_a_grid_finer_than_the_checked_one() {
        for seed in 0..10 {
            let (robot, excitation) = quick(seed);
            for k in 0..20_011 {
                let state = excitation.at::<6>(10.0 * f64::from(k) / 20_011.0);
                for (j, joint) in robot.joints.iter().enumerate() {
                    assert!(state.q[j].abs() <= PI, "seed {seed}, joint {j}");
                    let limits = &joint.limits;
                    assert!(
                        state.qd[j].abs() <= limits.velocity,
                        "seed {seed}, joint {j}"
                    );
                    assert!(
                        state.qdd[j].abs() <= limits.acceleration,
                        "seed {seed}, joint {j}"
                    );
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
    fn velocity_and_acceleration_are_derivatives_of_position() {
        let (_, excitation) = quick(2);
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
        let text = |seed| serde_json::to_string(&quick(seed).1).expect("serialises");
        assert_eq!(text(7), text(7));
        assert_ne!(text(7), text(8));
        let back: Excitation = serde_json::from_str(&text(7)).expect("parses");
        assert_eq!(back, quick(7).1);
    }
}
