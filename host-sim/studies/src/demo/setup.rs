//! Size and setup of the main job: arm, controller, paths and the wrong prior of every board.

use crate::prior::bank_of;
use crate::{Progress, StudyError};
use foretorque::arm::Arm;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::closed_loop::control::PdConfig;
use foretorque_workbench::dynamics::{ReferenceModel, State};
use foretorque_workbench::excitation::{Excitation, QuickConfig};
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
use foretorque_workbench::trajectory::Trajectory;

/// The setup of every board of the job.
pub(super) struct Setup<const N: usize> {
    pub(super) series: Excitation,
    pub(super) excitation: Trajectory<N>,
    pub(super) validation: Trajectory<N>,
    pub(super) plant: Plant<N>,
    pub(super) pd: PdConfig<N>,
    pub(super) prior: ParameterBank,
    pub(super) period_s: f64,
}

impl<const N: usize> Setup<N> {
    pub(super) fn new<A: Arm<N, P>, const P: usize>(
        robot: &Robot,
        config: &DemoConfig,
        progress: Progress<'_>,
    ) -> Result<Self, StudyError> {
        let other_size = || StudyError::Joints(robot.joint_count());
        let truth = robot.perturbed(config.seed, &Perturbation::PLANT);
        let wrong = truth.perturbed(config.seed.wrapping_add(1), &Perturbation::WRONG_PRIOR);
        let search = QuickConfig {
            candidates: config.excitation_candidates,
            ..QuickConfig::default()
        };
        let mut done = 0;
        let series = Excitation::quick(robot, config.seed, &search, || {
            done += 1;
            progress("excitation", done, search.candidates);
        })?;
        let nominal = ReferenceModel::<N>::new(robot).ok_or_else(other_size)?;
        Ok(Self {
            excitation: Trajectory::Excitation {
                series: series.clone(),
                duration_s: config.learning_s,
            },
            series,
            validation: Trajectory::validation(robot, config.seed.wrapping_add(2)),
            plant: Plant::new(&truth, PlantConfig::default(), config.seed)
                .ok_or_else(other_size)?,
            pd: PdConfig::tuned(&nominal, config.pd_bandwidth_hz, config.period_s),
            prior: bank_of::<A, N, P>(&wrong),
            period_s: config.period_s,
        })
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

/// Points of curves that the page shows.
pub(super) const PAGE_POINTS: usize = 3000;

/// Size of the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DemoConfig {
    /// Seed of plant, prior, paths and noise.
    pub seed: u64,
    /// Period of the tick, s.
    pub period_s: f64,
    /// Arm time with learning on, long run, s.
    pub learning_s: f64,
    /// Arm time with learning on, flashable firmware, s.
    pub usart_learning_s: f64,
    /// Length of the unseen path that is played, s.
    pub validation_s: f64,
    /// Bandwidth of the PD controller, Hz.
    pub pd_bandwidth_hz: f64,
    /// Random candidates of the excitation.
    pub excitation_candidates: usize,
}

impl Default for DemoConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            period_s: 1e-3,
            learning_s: 80.0,
            usart_learning_s: 5.0,
            validation_s: 30.0,
            pd_bandwidth_hz: 6.0,
            excitation_candidates: 100,
        }
    }
}

impl DemoConfig {
    /// Number of ticks in `duration_s`.
    pub(super) fn ticks(&self, duration_s: f64) -> usize {
        (duration_s / self.period_s).round() as usize
    }
}
