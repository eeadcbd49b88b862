//! The main job: start from a wrong prior, learn on the board in closed loop, freeze, play a path nobody has seen.

use super::closed_loop::{ClosedLoop, motion_f32};
use super::demo_page;
use super::demo_record::{
    BeforeAfter, DemoCurves, DemoReport, LearningPoint, LinkFigures, TickInstructions, Tracking,
    UsartFigures, ValidationPoint,
};
use super::prior::bank_of;
use crate::board::{BoardError, Client};
use crate::control::PdConfig;
use crate::dynamics::{Joints, ReferenceModel, State};
use crate::excitation::{Excitation, QuickConfig};
use crate::metrics::{TorqueError, TrackingError};
use crate::plant::{Plant, PlantConfig};
use crate::robot::{Perturbation, Robot};
use crate::trajectory::Trajectory;
use foretorque::arm::Arm;
use foretorque::edge::bank::ParameterBank;
use foretorque::edge::telemetry::{Cost, Statistics};
use foretorque::feedforward::Torque;
use std::error::Error;

/// How large the job is.
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

/// A stage of the job, as the progress bar shows it: name, ticks done, ticks in all.
pub type Progress<'p> = &'p dyn Fn(&'static str, usize, usize);

/// What the job leaves: figures, and the page that shows them.
#[derive(Clone, Debug, PartialEq)]
pub struct DemoOutcome {
    /// Figures.
    pub report: DemoReport,
    /// The page.
    pub html: String,
}

/// Points of the unseen path on which the error is watched while learning goes on.
const WATCH_POINTS: usize = 250;
/// Time between two looks at that error, s.
const WATCH_EVERY_S: f64 = 1.0;
/// Points of the unseen path for the USART, whose link carries a few hundred frames a second.
const USART_POINTS: usize = 300;
/// Points of curves that the page shows.
const PAGE_POINTS: usize = 3000;

/// The world of the job: the same for every board that is put into it.
struct World<const N: usize> {
    excitation: Trajectory<N>,
    validation: Trajectory<N>,
    plant: Plant<N>,
    pd: PdConfig<N>,
    prior: ParameterBank,
    period_s: f64,
}

impl<const N: usize> World<N> {
    fn new<A: Arm<N, P>, const P: usize>(
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
    fn one_period(&self) -> Vec<(f64, State<N>)> {
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
    fn grid(&self, points: usize, duration_s: f64) -> Vec<(f64, State<N>)> {
        (0..points)
            .map(|k| {
                let t_s = duration_s * k as f64 / points as f64;
                (t_s, self.validation.at(t_s))
            })
            .collect()
    }
}

/// Runs the job on `bulk`, and its shorter part on the flashable firmware that `usart` connects to.
///
/// Errors: the boards', and those of an excitation that the limits do not allow.
pub fn run<A: Arm<N, P>, const N: usize, const P: usize>(
    robot: &Robot,
    config: &DemoConfig,
    board: &str,
    toolchain: &str,
    bulk: &mut Client<N>,
    usart: Option<&mut Client<N>>,
    progress: Progress<'_>,
) -> Result<DemoOutcome, Box<dyn Error>> {
    let world = World::<N>::new::<A, P>(robot, config, progress)?;
    let ticks = |duration_s: f64| (duration_s / config.period_s).round() as usize;
    let (validation_ticks, learning_ticks) = (ticks(config.validation_s), ticks(config.learning_s));
    let path = world.grid(validation_ticks, config.validation_s);

    bulk.reset()?;
    bulk.upload_bank(&world.prior)?;
    let before = predictions(bulk, &path, "torque before", progress)?;
    // Both kinds of control meet the arm as it is when learning begins: same age, same noise.
    let (pd_only, pd_only_curve) = track(
        &mut world.plant.clone(),
        &world,
        validation_ticks,
        None,
        "PD alone",
        progress,
    )?;
    let (wrong, wrong_curve) = track(
        &mut world.plant.clone(),
        &world,
        validation_ticks,
        Some(bulk),
        "wrong model",
        progress,
    )?;
    let earlier = bulk.statistics()?;

    let mut plant = world.plant.clone();
    let watched = world.grid(WATCH_POINTS, config.validation_s);
    let mut learning_curve = Vec::new();
    let replies = learn(
        bulk,
        &world,
        &mut plant,
        learning_ticks,
        |board, plant, t_s| {
            let seen = predictions(board, &watched, "learning", &|_, _, _| {})?;
            learning_curve.push(LearningPoint {
                t_s,
                torque_nrmse: error_of(plant, &watched, &seen).nrmse(),
            });
            Ok(())
        },
        "learning",
        progress,
    )?;
    let after = predictions(bulk, &path, "torque after", progress)?;
    let before_error = error_of(&plant, &path, &before);
    let after_error = error_of(&plant, &path, &after);
    let every = (path.len() / PAGE_POINTS).max(1);
    let validation = (0..path.len())
        .step_by(every)
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
    let (learnt, learnt_curve) = track(
        &mut plant,
        &world,
        validation_ticks,
        Some(bulk),
        "learnt model",
        progress,
    )?;
    let statistics = bulk.statistics()?;
    let usart = usart
        .map(|board| on_usart(board, &world, config, &replies, progress))
        .transpose()?;

    let report = DemoReport {
        robot: robot.name.clone(),
        board: board.to_owned(),
        seed: config.seed,
        ticks: learning_ticks,
        period_s: config.period_s,
        toolchain: toolchain.to_owned(),
        torque_nrmse_before: before_error.nrmse(),
        torque_nrmse_after: after_error.nrmse(),
        torque_nrmse_moving_before: before_error.nrmse_moving(),
        torque_nrmse_moving_after: after_error.nrmse_moving(),
        torque_rmse_nm: BeforeAfter {
            before: before_error.rmse_nm(),
            after: after_error.rmse_nm(),
        },
        tracking_rms_mrad: Tracking {
            pd_only: pd_only.mean_rms_mrad(),
            before: wrong.mean_rms_mrad(),
            after: learnt.mean_rms_mrad(),
        },
        tracking_rms_joint_mrad: Tracking {
            pd_only: pd_only.rms_mrad(),
            before: wrong.rms_mrad(),
            after: learnt.rms_mrad(),
        },
        pd_bandwidth_hz: config.pd_bandwidth_hz,
        learning_curve,
        tick_instructions: instructions(statistics.tick_cost),
        learning_instructions: instructions(statistics.learn_cost),
        link: link_figures(&[earlier, statistics]),
        usart,
    };
    let curves = DemoCurves {
        excitation: world.one_period(),
        validation,
        tracking: Tracking {
            pd_only: pd_only_curve,
            before: wrong_curve,
            after: learnt_curve,
        },
    };
    let html = demo_page::html(&report, &curves)?;
    Ok(DemoOutcome { report, html })
}

/// Position error over time: s and mrad.
type ErrorCurve<const N: usize> = Vec<(f64, Joints<N>)>;

/// Plays the unseen path in closed loop; the error in figures, and as a thinned curve.
fn track<const N: usize>(
    plant: &mut Plant<N>,
    world: &World<N>,
    ticks: usize,
    mut board: Option<&mut Client<N>>,
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<(TrackingError<N>, ErrorCurve<N>), BoardError> {
    let (mut error, mut curve) = (TrackingError::default(), Vec::new());
    let every = (ticks / PAGE_POINTS).max(1);
    let mut run = ClosedLoop::new(
        plant,
        &world.pd,
        &world.validation,
        world.period_s,
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
    Ok((error, curve))
}

/// Bits of one reply: torques and flags.
type ReplyBits<const N: usize> = ([u32; N], u16);

/// From the wrong prior on: plays the excitation with learning on, then freezes. Returns the bits of the replies.
///
/// The board starts as after boot, so that every board goes through the very same ticks. `watch` is called every second
/// of the arm's time, and at the end.
fn learn<const N: usize>(
    board: &mut Client<N>,
    world: &World<N>,
    plant: &mut Plant<N>,
    ticks: usize,
    mut watch: impl FnMut(&mut Client<N>, &Plant<N>, f64) -> Result<(), Box<dyn Error>>,
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<Vec<ReplyBits<N>>, Box<dyn Error>> {
    board.reset()?;
    board.upload_bank(&world.prior)?;
    board.learning(true)?;
    let mut replies = Vec::with_capacity(ticks);
    let mut run = ClosedLoop::new(
        plant,
        &world.pd,
        &world.excitation,
        world.period_s,
        Some(&mut *board),
    )?;
    let watch_every = ((WATCH_EVERY_S / world.period_s).round() as usize).max(1);
    for tick in 0..ticks {
        if tick % watch_every == 0 {
            watch(board, plant, tick as f64 * world.period_s)?;
        }
        let seen = run.tick(plant, Some(&mut *board))?;
        let bits: [f32; N] = seen.feed_forward.into();
        replies.push((bits.map(f32::to_bits), seen.flags));
        report_every(progress, stage, tick, ticks);
    }
    board.learning(false)?;
    watch(board, plant, ticks as f64 * world.period_s)?;
    Ok(replies)
}

/// The shorter job on the flashable firmware: the first seconds of the long run again, bit for bit.
fn on_usart<const N: usize>(
    board: &mut Client<N>,
    world: &World<N>,
    config: &DemoConfig,
    long_run: &[ReplyBits<N>],
    progress: Progress<'_>,
) -> Result<UsartFigures, Box<dyn Error>> {
    let ticks = (config.usart_learning_s / config.period_s).round() as usize;
    let grid = world.grid(USART_POINTS, config.validation_s);
    let mut plant = world.plant.clone();
    // Counters from here on: how often a booting board was greeted is a matter of the clock on the wall.
    board.reset()?;
    board.upload_bank(&world.prior)?;
    let before = predictions(board, &grid, "USART: torque before", progress)?;
    let earlier = board.statistics()?;
    let replies = learn(
        board,
        world,
        &mut plant,
        ticks,
        |_, _, _| Ok(()),
        "USART: learning",
        progress,
    )?;
    let after = predictions(board, &grid, "USART: torque after", progress)?;
    let statistics = board.statistics()?;
    let equal = replies
        .iter()
        .zip(long_run)
        .take_while(|(here, there)| here == there);
    Ok(UsartFigures {
        ticks,
        torque_nrmse_before: error_of(&plant, &grid, &before).nrmse(),
        torque_nrmse_after: error_of(&plant, &grid, &after).nrmse(),
        grid_points: grid.len(),
        ticks_with_equal_bits: equal.count(),
        tick_instructions: instructions(statistics.tick_cost),
        link: link_figures(&[earlier, statistics]),
    })
}

/// What the board would answer along `path`.
fn predictions<const N: usize>(
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
fn error_of<const N: usize>(
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

fn instructions(cost: Cost) -> TickInstructions {
    TickInstructions {
        mean: cost.mean,
        max: cost.max,
    }
}

/// Sums the counters of several stretches between resets.
fn link_figures(stretches: &[Statistics]) -> LinkFigures {
    let errors = |s: &Statistics| {
        [
            s.crc_errors,
            s.framing_errors,
            s.foreign_version,
            s.unknown,
            s.missed,
            s.repeated,
            s.overruns,
            s.replies_lost,
        ]
        .into_iter()
        .sum::<u32>()
    };
    LinkFigures {
        frames: stretches.iter().map(|s| s.frames).sum(),
        errors: stretches.iter().map(errors).sum(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Native;
    use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
    use std::time::Duration;

    fn board() -> Client<JOINTS> {
        let native = Native::<Ur5, JOINTS, PARAMETERS>::new().expect("boots");
        Client::connect::<Ur5, PARAMETERS>(Box::new(native), Duration::from_secs(1)).expect("hello")
    }

    fn in_small() -> DemoOutcome {
        let config = DemoConfig {
            learning_s: 6.0,
            usart_learning_s: 1.0,
            validation_s: 10.0,
            excitation_candidates: 5,
            ..DemoConfig::default()
        };
        let robot = Robot::load("ur5").expect("built in");
        run::<Ur5, JOINTS, PARAMETERS>(
            &robot,
            &config,
            "native",
            "test",
            &mut board(),
            Some(&mut board()),
            &|_, _, _| {},
        )
        .expect("runs")
    }

    #[test]
    fn six_seconds_of_learning_halve_the_torque_error_and_runs_repeat() {
        let outcome = in_small();
        let report = &outcome.report;
        assert!(
            report.torque_nrmse_before > 0.2,
            "{}",
            report.torque_nrmse_before
        );
        assert!(report.torque_nrmse_after < 0.5 * report.torque_nrmse_before);
        let tracking = &report.tracking_rms_mrad;
        assert!(tracking.after < tracking.before && tracking.before < tracking.pd_only);
        assert_eq!(report.link.errors, 0);
        let usart = report.usart.as_ref().expect("a second board was given");
        assert_eq!(usart.ticks_with_equal_bits, usart.ticks);
        assert!(usart.torque_nrmse_after < usart.torque_nrmse_before);
        assert!(outcome.html.len() < 3_000_000);
        assert_eq!(outcome, in_small());
    }
}
