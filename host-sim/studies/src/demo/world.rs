//! What every board of the job meets: arm, controller, paths and the wrong prior.

use super::{DemoConfig, Progress};
use crate::prior::bank_of;
use foretorque::arm::Arm;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::closed_loop::control::PdConfig;
use foretorque_workbench::dynamics::{ReferenceModel, State};
use foretorque_workbench::excitation::{Excitation, QuickConfig};
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
use foretorque_workbench::trajectory::Trajectory;
use std::error::Error;

/// The world of the job: the same for every board that is put into it.
pub(super) struct World<const N: usize> {
    pub(super) excitation: Trajectory<N>,
    pub(super) validation: Trajectory<N>,
    pub(super) plant: Plant<N>,
    pub(super) pd: PdConfig<N>,
    pub(super) prior: ParameterBank,
    pub(super) period_s: f64,
}

impl<const N: usize> World<N> {
    pub(super) fn new<A: Arm<N, P>, const P: usize>(
        robot: &Robot,
        config: &DemoConfig,
        progress: Progress<'_>,
    ) -> Result<Self, Box<dyn Error>> {
        let other_size = || format!("robot '{}' has not {N} joints", robot.name);
        let truth = robot.perturbed(config.seed, &Perturbation::PLANT);
        let wrong = truth.perturbed(config.seed.wrapping_add(1), &Perturbation::WRONG_PRIOR);
        let search = QuickConfig {
            candidates: config.excitation_candidates,
            ..QuickConfig::default()
        };
        let mut done = 0;
        let series = Excitation::quick::<N>(robot, config.seed, &search, || {
            done += 1;
            progress("excitation", done, search.candidates);
        })?;
        let nominal = ReferenceModel::<N>::new(robot).ok_or_else(other_size)?;
        Ok(Self {
            excitation: Trajectory::Excitation {
                series,
                duration_s: config.learning_s,
            },
            validation: Trajectory::validation(robot, config.seed.wrapping_add(2)),
            plant: Plant::new(&truth, PlantConfig::default(), config.seed)
                .ok_or_else(other_size)?,
            pd: PdConfig::tuned(&nominal, config.pd_bandwidth_hz, config.period_s),
            prior: bank_of::<A, N, P>(&wrong),
            period_s: config.period_s,
        })
    }

    /// The excitation over its period: time, s, and motion.
    pub(super) fn one_period(&self) -> Vec<(f64, State<N>)> {
        const POINTS: u32 = 1000;
        let Trajectory::Excitation { series, .. } = &self.excitation else {
            return Vec::new();
        };
        (0..=POINTS)
            .map(|k| series.period_s * f64::from(k) / f64::from(POINTS))
            .map(|t_s| (t_s, series.at(t_s)))
            .collect()
    }

    /// The unseen path at `points` instants, evenly spaced.
    pub(super) fn grid(&self, points: usize, duration_s: f64) -> Vec<(f64, State<N>)> {
        (0..points)
            .map(|k| {
                let t_s = duration_s * k as f64 / points as f64;
                (t_s, self.validation.at(t_s))
            })
            .collect()
    }
}
