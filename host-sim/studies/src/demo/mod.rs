//! The main job: start from a wrong prior, learn on the board in closed loop, freeze, play a path nobody has seen.

mod long_run;
mod page;

pub use long_run::DemoConfig;

use crate::{Outcome, Progress, StudyError};
use foretorque::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
use foretorque_link::telemetry::Statistics;
use foretorque_workbench::board::Client;
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::report::closed_loop::{BoardCost, LinkReport};
use foretorque_workbench::report::page::percent;
use long_run::{ErrorCurve, Setup};
use serde::Serialize;

/// Runs the job on the first board, and its shorter part on the flashable firmware that the second connects to.
///
/// * `names` of the board and of the compiler of its code
///
/// Errors: the boards', and those of an excitation that the limits do not allow.
pub fn run(
    config: &DemoConfig,
    names: (String, String),
    (bulk, usart): (&mut Client<N>, Option<&mut Client<N>>),
    progress: Progress<'_>,
) -> Result<Outcome<DemoReport>, StudyError> {
    let setup = Setup::new(config, progress)?;
    let (mut report, curves, replies) = long_run::long_run(bulk, &setup, names)?;
    let usart = usart.map(|board| long_run::usart_run(board, &setup, &replies));
    report.usart = usart.transpose()?;
    Ok(Outcome {
        page: page::page(&report, &curves, &setup.series),
        text: report.summary(),
        broken: report.broken(),
        report,
    })
}

/// The figures of `report.json`. Nothing in it depends on the clock on the wall: equal runs give equal files.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DemoReport {
    /// Name of the robot.
    pub robot: String,
    /// Board of the long run: `qemu` or `native`.
    pub board: String,
    /// Seed of plant, prior, paths and noise.
    pub seed: u64,
    /// Ticks with learning on, long run.
    pub ticks: usize,
    /// Period of the tick, s.
    pub period_s: f64,
    /// Compiler of the board's code.
    pub toolchain: String,
    /// NRMSE of the torque on the unseen path before learning, all samples, a ratio.
    pub torque_nrmse_before: f64,
    /// NRMSE of the torque after learning.
    pub torque_nrmse_after: f64,
    /// NRMSE before learning, only samples in which the joint moves.
    pub torque_nrmse_moving_before: f64,
    /// NRMSE after learning, only samples in which the joint moves.
    pub torque_nrmse_moving_after: f64,
    /// RMS torque error of every joint on the unseen path, N·m.
    pub torque_rmse_nm: BeforeAfter<Vec<f64>>,
    /// RMS position error on the unseen path, mean of the joints, mrad.
    pub tracking_rms_mrad: Tracking<f64>,
    /// RMS tracking error of each joint, mrad.
    pub tracking_rms_joint_mrad: Tracking<Vec<f64>>,
    /// Bandwidth of the PD controller, Hz.
    pub pd_bandwidth_hz: f64,
    /// Torque error on the unseen path while learning goes on.
    pub learning_curve: Vec<LearningPoint>,
    /// Instructions of a tick, from the request's last byte to the reply.
    pub tick_instructions: BoardCost,
    /// Instructions of a tick by phase of the board.
    pub tick_instructions_by_phase: TickPhases,
    /// Instructions of learning from one tick.
    pub learning_instructions: BoardCost,
    /// Frames of the long run's link.
    pub link: LinkFigures,
    /// Figures of the shorter run on the flashable firmware over its USART.
    pub usart: Option<UsartFigures>,
}

impl DemoReport {
    /// Arm time with learning on, long run, s.
    fn learning_s(&self) -> f64 {
        self.ticks as f64 * self.period_s
    }

    /// Frames that were lost or damaged, and ticks of the two boards that differ.
    fn broken(&self) -> Option<String> {
        let usart = self.usart.as_ref();
        let errors = self.link.errors + usart.map_or(0, |usart| usart.link.errors);
        let differ = usart.map_or(0, |usart| usart.ticks - usart.ticks_with_equal_bits);
        let broken = errors > 0 || differ > 0;
        broken.then(|| format!("{errors} errors of the link, {differ} ticks differ in bits"))
    }

    fn summary(&self) -> String {
        let (tracking, tick) = (&self.tracking_rms_mrad, &self.tick_instructions);
        let (before, after) = (self.torque_nrmse_before, self.torque_nrmse_after);
        let mut text = format!(
            "torque error     {} → {} NRMSE on the unseen path ({:.2} of before), {} ticks of learning\n\
             tracking error   {:.2} mrad PD alone, {:.2} with the wrong model, {:.2} with the learnt one\n\
             cost of a tick   {} instructions mean, {} largest\n\
             link             {} frames, {} errors\n",
            percent(before),
            percent(after),
            after / before,
            self.ticks,
            tracking.pd_only,
            tracking.before,
            tracking.after,
            tick.mean,
            tick.max,
            self.link.frames,
            self.link.errors
        );
        if let Some(usart) = &self.usart {
            text += &format!(
                "flashable ELF    {} → {} in {} ticks over its USART, {} of them with the same bits\n",
                percent(usart.torque_nrmse_before),
                percent(usart.torque_nrmse_after),
                usart.ticks,
                usart.ticks_with_equal_bits
            );
        }
        text
    }
}

/// A figure before and after learning.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BeforeAfter<T> {
    /// With the wrong prior.
    pub before: T,
    /// With what was learnt, frozen.
    pub after: T,
}

/// A figure for the three kinds of control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Tracking<T> {
    /// PD alone.
    pub pd_only: T,
    /// With the feed-forward of the wrong prior.
    pub before: T,
    /// With the learnt feed-forward, frozen.
    pub after: T,
}

impl<T> Tracking<T> {
    /// Maps the figure of all three runs.
    fn map<U>(&self, figure: impl Fn(&T) -> U) -> Tracking<U> {
        Tracking {
            pd_only: figure(&self.pd_only),
            before: figure(&self.before),
            after: figure(&self.after),
        }
    }
}

/// One point of the learning curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LearningPoint {
    /// Time of learning, s of the arm's time.
    pub t_s: f64,
    /// NRMSE of the torque on a coarse grid of the unseen path, a ratio.
    pub torque_nrmse: f64,
}

/// Instructions of a tick by what the board was doing in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct TickPhases {
    /// Learning off.
    pub frozen: BoardCost,
    /// Learning on: the tick also hands its learning sample over and adopts learnt sets.
    pub learning: BoardCost,
}

/// Frames of a link, counted on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LinkFigures {
    /// Good frames received.
    pub frames: u32,
    /// Damaged, foreign, missed and lost ones.
    pub errors: u32,
}

impl LinkFigures {
    /// Sums the counters of several stretches between resets.
    fn of(stretches: &[Statistics]) -> Self {
        let errors = |s: &Statistics| LinkReport::from(s).errors() + s.replies_lost;
        Self {
            frames: stretches.iter().map(|s| s.frames).sum(),
            errors: stretches.iter().map(errors).sum(),
        }
    }
}

/// The part on the flashable firmware.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UsartFigures {
    /// Ticks with learning on.
    pub ticks: usize,
    /// NRMSE on a grid of the unseen path before learning, a ratio.
    pub torque_nrmse_before: f64,
    /// NRMSE of the torque after these ticks.
    pub torque_nrmse_after: f64,
    /// Points of that grid.
    pub grid_points: usize,
    /// Ticks whose reply has the very bits of the long run's.
    pub ticks_with_equal_bits: usize,
    /// Instructions of a tick.
    pub tick_instructions: BoardCost,
    /// Instructions of learning from one tick.
    pub learning_instructions: BoardCost,
    /// Frames of its link.
    pub link: LinkFigures,
}

#[derive(Clone, Debug, Default)]
struct DemoCurves {
    /// Samples of the unseen path that the figures count; the curves show some of them.
    validation_samples: usize,
    /// The unseen path.
    validation: Vec<ValidationPoint>,
    /// Position error on the unseen path for every kind of control: time, s, and error, mrad.
    tracking: Tracking<ErrorCurve>,
}

/// One instant of the unseen path, torques in N·m.
#[derive(Clone, Copy, Debug)]
struct ValidationPoint {
    t_s: f64,
    truth: Joints<N>,
    before: Joints<N>,
    after: Joints<N>,
    rigid: Joints<N>,
    friction: Joints<N>,
    network: Joints<N>,
}
