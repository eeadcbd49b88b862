//! The long run, everything that is asked of one board before, while and after it learns; and its first seconds again on the
//! flashable firmware, over its USART.

use super::{
    BeforeAfter, DemoCurves, DemoReport, LearningPoint, LinkFigures, N, P, TickPhases, Tracking,
    Ur5, UsartFigures, ValidationPoint,
};
use crate::{Progress, StudyError, bank_of, unsupported};
use foretorque::arm::Arm;
use foretorque::feedforward::Torque;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::board::{BoardError, Client};
use foretorque_workbench::closed_loop::{ClosedLoop, PdConfig, motion_f32};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::metrics::{TorqueError, TrackingError};
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory::Trajectory;

const PERIOD_S: f64 = 1e-3;
const PD_BANDWIDTH_HZ: f64 = 6.0;
/// Period of the fundamental of the excitation, s.
const EXCITATION_PERIOD_S: f64 = 10.0;

/// The setup of every board of the job.
pub(super) struct Setup<'p> {
    config: DemoConfig,
    progress: Progress<'p>,
    pub(super) series: Excitation,
    excitation: Trajectory<N>,
    validation: Trajectory<N>,
    plant: Plant<N>,
    pd: PdConfig<N>,
    prior: ParameterBank,
}

impl<'p> Setup<'p> {
    pub(super) fn new(config: &DemoConfig, progress: Progress<'p>) -> Result<Self, StudyError> {
        let robot = &Robot::load(Ur5::NAME)?;
        let other_size = || unsupported(N);
        let truth = robot.perturbed(config.seed);
        let wrong = truth.wrong_prior(config.seed.wrapping_add(1));
        let (mut done, candidates) = (0, config.excitation_candidates);
        let series =
            Excitation::quick(robot, config.seed, EXCITATION_PERIOD_S, candidates, || {
                done += 1;
                progress("excitation", done, candidates);
            })?;
        let nominal = ReferenceModel::<N>::new(robot).ok_or_else(other_size)?;
        Ok(Self {
            config: *config,
            progress,
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
    fn grid(&self, points: usize) -> Vec<(f64, State<N>)> {
        let times = (0..points).map(|k| self.config.validation_s * k as f64 / points as f64);
        times.map(|t_s| (t_s, self.validation.at(t_s))).collect()
    }

    /// Plays the unseen path in closed loop; the error in figures, and as a thinned curve.
    fn track(
        &self,
        plant: &mut Plant<N>,
        mut board: Option<&mut Client<N>>,
        stage: &'static str,
    ) -> Result<(TrackingError<N>, ErrorCurve), BoardError> {
        let ticks = ticks_in(self.config.validation_s);
        let (mut error, mut curve) = (TrackingError::default(), Vec::new());
        let every = (ticks / PAGE_POINTS).max(1);
        let (pd, path) = (&self.pd, &self.validation);
        let mut run = ClosedLoop::new(plant, pd, path, PERIOD_S, board.as_deref_mut())?;
        for tick in 0..ticks {
            let seen = run.tick(plant, board.as_deref_mut())?;
            let distance = seen.desired.q - seen.q;
            error.add(&distance);
            if tick % every == 0 {
                curve.push((seen.t_s, distance * 1e3));
            }
            report_every(self.progress, stage, tick, ticks);
        }
        if let Some(board) = board {
            board.disarm()?;
        }
        Ok((error, curve))
    }

    /// From the wrong prior on: plays the excitation with learning on, then freezes. Returns the bits of the replies.
    ///
    /// The board starts as after boot, so that every board goes through the very same ticks. `watch` is called every second
    /// of the arm's time, and at the end.
    fn learn(
        &self,
        board: &mut Client<N>,
        plant: &mut Plant<N>,
        ticks: usize,
        stage: &'static str,
        mut watch: impl FnMut(&mut Client<N>, &Plant<N>, f64) -> Result<(), StudyError>,
    ) -> Result<Vec<ReplyBits>, StudyError> {
        board.reset()?;
        board.upload_bank(&self.prior)?;
        let mut replies = Vec::with_capacity(ticks);
        let (pd, path) = (&self.pd, &self.excitation);
        let mut run = ClosedLoop::new(plant, pd, path, PERIOD_S, Some(&mut *board))?;
        board.learning(true)?;
        let watch_every = ticks_in(WATCH_EVERY_S).max(1);
        for tick in 0..ticks {
            if tick % watch_every == 0 {
                watch(board, plant, tick as f64 * PERIOD_S)?;
            }
            let seen = run.tick(plant, Some(&mut *board))?;
            let bits: [f32; N] = seen.feed_forward.into();
            replies.push((bits.map(f32::to_bits), seen.flags));
            report_every(self.progress, stage, tick, ticks);
        }
        board.learning(false)?;
        board.disarm()?;
        watch(board, plant, ticks as f64 * PERIOD_S)?;
        Ok(replies)
    }
}

const PAGE_POINTS: usize = 3000;

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

fn ticks_in(duration_s: f64) -> usize {
    (duration_s / PERIOD_S).round() as usize
}

/// Time between two looks at the error while learning goes on, s.
const WATCH_EVERY_S: f64 = 1.0;

/// Position error over time: s and mrad.
pub(super) type ErrorCurve = Vec<(f64, Joints<N>)>;

/// Bits of one reply: torques and flags.
type ReplyBits = ([u32; N], u16);

/// Torques that the board predicts along `path`.
fn predictions(
    board: &mut Client<N>,
    path: &[(f64, State<N>)],
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<Vec<Torque<N>>, BoardError> {
    let evaluate = |(k, (_, state)): (usize, &(f64, State<N>))| {
        report_every(progress, stage, k, path.len());
        board.evaluate(&motion_f32(state))
    };
    path.iter().enumerate().map(evaluate).collect()
}

/// Error of these torques against what the motion takes at the arm's present age.
fn error_of(plant: &Plant<N>, path: &[(f64, State<N>)], torques: &[Torque<N>]) -> TorqueError<N> {
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

/// Points of the unseen path on which the error is watched while learning goes on.
pub(super) const WATCH_POINTS: usize = 250;

/// Takes `bulk` through the whole job: the report, the curves, and the bits of every reply while learning was on.
///
/// * `board`, `toolchain` names of the board and of the compiler of its code
///
/// Errors: the board's.
pub(super) fn long_run(
    bulk: &mut Client<N>,
    setup: &Setup<'_>,
    (board, toolchain): (String, String),
) -> Result<(DemoReport, DemoCurves, Vec<ReplyBits>), StudyError> {
    let (config, progress) = (&setup.config, setup.progress);
    let samples = ticks_in(config.validation_s);
    let path = setup.grid(samples);
    bulk.reset()?;
    bulk.upload_bank(&setup.prior)?;
    let before = predictions(bulk, &path, "torque before", progress)?;
    // Both kinds of control meet the arm as it is when learning begins: same age, same noise.
    let pd_only = setup.track(&mut setup.plant.clone(), None, "PD alone")?;
    let wrong = setup.track(&mut setup.plant.clone(), Some(bulk), "wrong model")?;
    let frozen = bulk.statistics()?;

    let mut plant = setup.plant.clone();
    let watched = setup.grid(WATCH_POINTS);
    let mut learning_curve = Vec::new();
    let watch = |board: &mut Client<N>, plant: &Plant<N>, t_s| {
        let seen = predictions(board, &watched, "learning", &|_, _, _| {})?;
        let torque_nrmse = error_of(plant, &watched, &seen).nrmse();
        learning_curve.push(LearningPoint { t_s, torque_nrmse });
        Ok(())
    };
    let ticks = ticks_in(config.learning_s);
    let replies = setup.learn(bulk, &mut plant, ticks, "learning", watch)?;
    let learning = bulk.statistics()?;
    let after = predictions(bulk, &path, "torque after", progress)?;
    let errors = [&before, &after].map(|torques| error_of(&plant, &path, torques));
    let validation = (0..path.len())
        .step_by((path.len() / PAGE_POINTS).max(1))
        .map(|k| ValidationPoint {
            t_s: path[k].0,
            truth: plant.true_torque(&path[k].1),
            before: before[k].total.cast(),
            after: after[k].total.cast(),
            rigid: after[k].shares.rigid.cast(),
            friction: after[k].shares.friction.cast(),
            network: after[k].shares.network.cast(),
        })
        .collect();
    let tracking = Tracking {
        pd_only,
        before: wrong,
        after: setup.track(&mut plant, Some(bulk), "learnt model")?,
    };
    let statistics = bulk.statistics()?;
    let curves = DemoCurves {
        validation_samples: samples,
        validation,
        tracking: tracking.map(|(_, curve)| curve.clone()),
    };
    let [before, after] = errors;
    let report = DemoReport {
        robot: Ur5::NAME.to_owned(),
        board,
        seed: config.seed,
        ticks,
        period_s: PERIOD_S,
        toolchain,
        torque_nrmse_before: before.nrmse(),
        torque_nrmse_after: after.nrmse(),
        torque_nrmse_moving_before: before.nrmse_moving(),
        torque_nrmse_moving_after: after.nrmse_moving(),
        torque_rmse_nm: BeforeAfter {
            before: before.rmse_nm(),
            after: after.rmse_nm(),
        },
        tracking_rms_mrad: tracking.map(|(error, _)| error.mean_rms_mrad()),
        tracking_rms_joint_mrad: tracking.map(|(error, _)| error.rms_mrad()),
        pd_bandwidth_hz: PD_BANDWIDTH_HZ,
        learning_curve,
        tick_instructions: statistics.tick_cost.into(),
        tick_instructions_by_phase: TickPhases {
            frozen: frozen.tick_cost.into(),
            learning: learning.tick_cost.into(),
        },
        learning_instructions: statistics.learn_cost.into(),
        link: LinkFigures::of(&[frozen, statistics]),
        usart: None,
    };
    Ok((report, curves, replies))
}

/// Points of the unseen path for the USART, whose link carries a few hundred frames a second.
const USART_POINTS: usize = 300;

/// The shorter job on the flashable firmware: the first seconds of the long run again, bit for bit.
pub(super) fn usart_run(
    board: &mut Client<N>,
    setup: &Setup<'_>,
    long_run: &[ReplyBits],
) -> Result<UsartFigures, StudyError> {
    let (ticks, progress) = (ticks_in(setup.config.usart_learning_s), setup.progress);
    let grid = setup.grid(USART_POINTS);
    let mut plant = setup.plant.clone();
    // Counters from here on: how often a booting board was greeted is a matter of the clock on the wall.
    board.reset()?;
    board.upload_bank(&setup.prior)?;
    let before = predictions(board, &grid, "USART: torque before", progress)?;
    let earlier = board.statistics()?;
    let unwatched = |_: &mut Client<N>, _: &Plant<N>, _| Ok(());
    let replies = setup.learn(board, &mut plant, ticks, "USART: learning", unwatched)?;
    let after = predictions(board, &grid, "USART: torque after", progress)?;
    let statistics = board.statistics()?;
    let pairs = replies.iter().zip(long_run);
    let equal = pairs.take_while(|(here, there)| here == there);
    Ok(UsartFigures {
        ticks,
        torque_nrmse_before: error_of(&plant, &grid, &before).nrmse(),
        torque_nrmse_after: error_of(&plant, &grid, &after).nrmse(),
        grid_points: grid.len(),
        ticks_with_equal_bits: equal.count(),
        tick_instructions: statistics.tick_cost.into(),
        learning_instructions: statistics.learn_cost.into(),
        link: LinkFigures::of(&[earlier, statistics]),
    })
}
