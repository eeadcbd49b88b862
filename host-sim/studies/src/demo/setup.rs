//! Size and setup of the main job, arm, controller, paths and the wrong prior of every board; and its stages.

use super::{N, P, Ur5};
use crate::{Progress, StudyError, bank_of};
use foretorque::arm::Arm;
use foretorque::feedforward::Torque;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::board::{BoardError, Client};
use foretorque_workbench::closed_loop::{ClosedLoop, PdConfig, motion_f32};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::excitation::{Excitation, QuickConfig};
use foretorque_workbench::metrics::{TorqueError, TrackingError};
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
use foretorque_workbench::trajectory::Trajectory;

/// Period of the tick, s.
pub(super) const PERIOD_S: f64 = 1e-3;
/// Bandwidth of the PD controller, Hz.
pub(super) const PD_BANDWIDTH_HZ: f64 = 6.0;

/// The setup of every board of the job.
pub(super) struct Setup {
    pub(super) series: Excitation,
    pub(super) excitation: Trajectory<N>,
    pub(super) validation: Trajectory<N>,
    pub(super) plant: Plant<N>,
    pub(super) pd: PdConfig<N>,
    pub(super) prior: ParameterBank,
}

impl Setup {
    pub(super) fn new(config: &DemoConfig, progress: Progress<'_>) -> Result<Self, StudyError> {
        let robot = &Robot::load(Ur5::NAME)?;
        let other_size = || StudyError::Joints(N);
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
            pd: PdConfig::tuned(&nominal, PD_BANDWIDTH_HZ, PERIOD_S),
            prior: bank_of::<Ur5, N, P>(&wrong),
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
    /// Arm time with learning on, long run, s.
    pub learning_s: f64,
    /// Arm time with learning on, flashable firmware, s.
    pub usart_learning_s: f64,
    /// Length of the unseen path that is played, s.
    pub validation_s: f64,
    /// Random candidates of the excitation.
    pub excitation_candidates: usize,
}

impl Default for DemoConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            learning_s: 80.0,
            usart_learning_s: 5.0,
            validation_s: 30.0,
            excitation_candidates: 100,
        }
    }
}

/// Number of ticks in `duration_s`.
pub(super) fn ticks_in(duration_s: f64) -> usize {
    (duration_s / PERIOD_S).round() as usize
}

/// Time between two looks at the error while learning goes on, s.
const WATCH_EVERY_S: f64 = 1.0;

/// Position error over time: s and mrad.
pub(super) type ErrorCurve = Vec<(f64, Joints<N>)>;

/// Plays the unseen path in closed loop; the error in figures, and as a thinned curve.
pub(super) fn track(
    plant: &mut Plant<N>,
    setup: &Setup,
    ticks: usize,
    mut board: Option<&mut Client<N>>,
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<(TrackingError<N>, ErrorCurve), BoardError> {
    let (mut error, mut curve) = (TrackingError::default(), Vec::new());
    let every = (ticks / PAGE_POINTS).max(1);
    let mut run = ClosedLoop::new(
        plant,
        &setup.pd,
        &setup.validation,
        PERIOD_S,
        board.as_deref_mut(),
    )?;
    for tick in 0..ticks {
        let seen = run.tick(plant, board.as_deref_mut())?;
        let distance = seen.desired.q - seen.q;
        error.add(&distance);
        if tick % every == 0 {
            curve.push((seen.t_s, distance * 1e3));
        }
        report_every(progress, stage, tick, ticks);
    }
    if let Some(board) = board {
        board.disarm()?;
    }
    Ok((error, curve))
}

/// Bits of one reply: torques and flags.
pub(super) type ReplyBits = ([u32; N], u16);

/// From the wrong prior on: plays the excitation with learning on, then freezes. Returns the bits of the replies.
///
/// The board starts as after boot, so that every board goes through the very same ticks. `watch` is called every second
/// of the arm's time, and at the end.
pub(super) fn learn(
    board: &mut Client<N>,
    setup: &Setup,
    plant: &mut Plant<N>,
    ticks: usize,
    mut watch: impl FnMut(&mut Client<N>, &Plant<N>, f64) -> Result<(), StudyError>,
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<Vec<ReplyBits>, StudyError> {
    board.reset()?;
    board.upload_bank(&setup.prior)?;
    let mut replies = Vec::with_capacity(ticks);
    let mut run = ClosedLoop::new(
        plant,
        &setup.pd,
        &setup.excitation,
        PERIOD_S,
        Some(&mut *board),
    )?;
    board.learning(true)?;
    let watch_every = ticks_in(WATCH_EVERY_S).max(1);
    for tick in 0..ticks {
        if tick % watch_every == 0 {
            watch(board, plant, tick as f64 * PERIOD_S)?;
        }
        let seen = run.tick(plant, Some(&mut *board))?;
        let bits: [f32; N] = seen.feed_forward.into();
        replies.push((bits.map(f32::to_bits), seen.flags));
        report_every(progress, stage, tick, ticks);
    }
    board.learning(false)?;
    board.disarm()?;
    watch(board, plant, ticks as f64 * PERIOD_S)?;
    Ok(replies)
}

/// Torques that the board predicts along `path`.
pub(super) fn predictions(
    board: &mut Client<N>,
    path: &[(f64, State<N>)],
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<Vec<Torque<N>>, BoardError> {
    path.iter()
        .enumerate()
        .map(|(k, (_, state))| {
            report_every(progress, stage, k, path.len());
            board.evaluate(&motion_f32(state))
        })
        .collect()
}

/// Error of these torques against what the motion takes at the arm's present age.
pub(super) fn error_of(
    plant: &Plant<N>,
    path: &[(f64, State<N>)],
    torques: &[Torque<N>],
) -> TorqueError<N> {
    let mut error = TorqueError::default();
    for ((_, state), torque) in path.iter().zip(torques) {
        error.add(&plant.true_torque(state), &torque.total.cast(), &state.qd);
    }
    error
}

fn report_every(progress: Progress<'_>, stage: &'static str, done: usize, all: usize) {
    if (done + 1).is_multiple_of(256) || done + 1 == all {
        progress(stage, done + 1, all);
    }
}
