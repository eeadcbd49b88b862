//! The main job: start from a wrong prior, learn on the board in closed loop, freeze, play a path nobody has seen.

use super::closed_loop::{motion_f32, play};
use super::demo_page;
use super::demo_record::{
    BeforeAfter, DemoCurves, DemoReport, LearningPoint, LinkFigures, TickInstructions, Tracking,
    UsartFigures, ValidationPoint,
};
use super::prior::bank_of;
use crate::board::Client;
use crate::control::PdConfig;
use crate::dynamics::{Joints, ReferenceModel, State};
use crate::excitation::{Excitation, SearchConfig};
use crate::metrics::TorqueError;
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
pub type Progress<'p> = &'p mut dyn FnMut(&'static str, usize, usize);

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
const WATCH_EVERY_S: f64 = 2.0;
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
        let search = SearchConfig {
            candidates: config.excitation_candidates,
            ..SearchConfig::default()
        };
        let mut done = 0;
        let series = Excitation::search::<N>(robot, config.seed, &search, || {
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
            plant: Plant::new(&truth, PlantConfig::default(), config.seed).ok_or_else(other_size)?,
            pd: PdConfig::tuned(&nominal, config.pd_bandwidth_hz, config.period_s),
            prior: bank_of::<A, N, P>(&wrong),
        })
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
    bulk: &mut Client<A, N, P>,
    usart: Option<&mut Client<A, N, P>>,
    progress: Progress<'_>,
) -> Result<DemoOutcome, Box<dyn Error>> {
    let world = World::<N>::new::<A, P>(robot, config, progress)?;
    let period_s = config.period_s;
    let ticks = |duration_s: f64| (duration_s / period_s).round() as usize;
    let validation_ticks = ticks(config.validation_s);
    let learning_ticks = ticks(config.learning_s);
    let usart_ticks = ticks(config.usart_learning_s);
    let mut plant = world.plant.clone();
    let mut curves = DemoCurves::default();

    bulk.upload(&world.prior)?;
    let path = world.grid(validation_ticks, config.validation_s);
    let before = predictions(bulk, &path, "torque before", progress)?;

    // Each kind of control meets the same arm: its age and its noise are those of the learning run's beginning.
    let mut track = |plant: &mut Plant<N>,
                     stage: &'static str,
                     board: Option<&mut Client<A, N, P>>,
                     progress: Progress<'_>| {
        let mut errors = Vec::new();
        let every = (validation_ticks / PAGE_POINTS).max(1);
        let tracked = play(
            plant,
            &world.pd,
            &world.validation,
            period_s,
            validation_ticks,
            board,
            |tick| {
                if tick.tick % every == 0 {
                    let error = (tick.desired.q - tick.q) * 1e3;
                    errors.push((tick.tick as f64 * period_s, error));
                }
                report_every(progress, stage, tick.tick, validation_ticks);
            },
        );
        tracked.map(|tracked| (tracked, errors))
    };
    let (pd_only, errors) = track(&mut world.plant.clone(), "PD alone", None, progress)?;
    curves.tracking.pd_only = errors;
    let (wrong, errors) = track(&mut world.plant.clone(), "wrong model", Some(bulk), progress)?;
    curves.tracking.before = errors;

    let watched = world.grid(WATCH_POINTS, config.validation_s);
    let mut learning_curve = vec![LearningPoint {
        t_s: 0.0,
        torque_nrmse: nrmse(bulk, &plant, &watched)?,
    }];
    bulk.upload(&world.prior)?;
    let first_replies = learn(
        bulk,
        &world,
        &mut plant,
        period_s,
        learning_ticks,
        usart_ticks,
        |board, plant, t_s| {
            learning_curve.push(LearningPoint {
                t_s,
                torque_nrmse: nrmse(board, plant, &watched)?,
            });
            Ok(())
        },
        "learning",
        progress,
    )?;
    let after = predictions(bulk, &path, "torque after", progress)?;
    let mut before_error = TorqueError::<N>::default();
    let mut after_error = TorqueError::<N>::default();
    for (k, (t_s, state)) in path.iter().enumerate() {
        let truth = plant.true_torque(state);
        let (before, after) = (&before[k], &after[k]);
        let point = ValidationPoint {
            t_s: *t_s,
            truth,
            before: before.total.cast(),
            after: after.total.cast(),
            rigid: after.shares.rigid.cast(),
            friction: after.shares.friction.cast(),
            network: after.shares.network.cast(),
        };
        before_error.add(&truth, &point.before, &state.qd);
        after_error.add(&truth, &point.after, &state.qd);
        if k % (path.len() / PAGE_POINTS).max(1) == 0 {
            curves.validation.push(point);
        }
    }
    let (learnt, errors) = track(&mut plant, "learnt model", Some(bulk), progress)?;
    curves.tracking.after = errors;
    let statistics = bulk.statistics()?;

    let usart = usart
        .map(|board| {
            let figures = on_usart(board, &world, config, &first_replies, progress)?;
            Ok::<_, Box<dyn Error>>(figures)
        })
        .transpose()?;

    if let Trajectory::Excitation { series, .. } = &world.excitation {
        curves.excitation = (0..=1000)
            .map(|k| {
                let t_s = series.period_s * f64::from(k) / 1000.0;
                (t_s, series.at(t_s))
            })
            .collect();
    }
    let report = DemoReport {
        robot: robot.name.clone(),
        board: board.to_owned(),
        seed: config.seed,
        ticks: learning_ticks,
        period_s,
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
        link: link_figures(&statistics),
        usart,
    };
    let html = demo_page::html(&report, &curves)?;
    Ok(DemoOutcome { report, html })
}

/// Bits of one reply: torques and flags.
type ReplyBits<const N: usize> = ([u32; N], u16);

/// Plays the excitation with learning on, then freezes. Returns the bits of the first `kept` replies.
#[expect(clippy::too_many_arguments, reason = "one job, called twice, not an interface")]
fn learn<A: Arm<N, P>, const N: usize, const P: usize>(
    board: &mut Client<A, N, P>,
    world: &World<N>,
    plant: &mut Plant<N>,
    period_s: f64,
    ticks: usize,
    kept: usize,
    mut watch: impl FnMut(&mut Client<A, N, P>, &Plant<N>, f64) -> Result<(), Box<dyn Error>>,
    stage: &'static str,
    progress: Progress<'_>,
) -> Result<Vec<ReplyBits<N>>, Box<dyn Error>> {
    unimplemented!()
}
