use super::arm::{RobotOptions, with_rotors};
use super::disturbances::{DisturbanceArguments, FaultArguments};
use super::motion_log::MotionLog;
use super::terminal::{Bar, keep_stdout_for, show};
use super::{Failure, at_most, bail, duration, not_negative, not_over, unsupported};
use clap::Args;
use foretorque_workbench::closed_loop::{ClosedLoop, PdConfig};
use foretorque_workbench::dynamics::{Joints, ReferenceModel};
use foretorque_workbench::joints;
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::report::closed_loop::ClosedLoopLog;
use foretorque_workbench::robot::{Joint, Robot};
use foretorque_workbench::trajectory::Trajectory;
use std::path::PathBuf;

/// Let the simulated arm play a trajectory under PD control, and log its sensors
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    robot: RobotOptions,
    #[command(flatten)]
    motion: MotionArguments,
    /// Write motor currents, torque over drive gain, in the place of torques
    #[arg(long)]
    current: bool,
    #[command(flatten)]
    verdict: Verdict,
    /// Write the log as MCAP beside the CSV, too; --out FILE.mcap writes MCAP alone
    #[arg(long)]
    mcap: bool,
    /// Log to write: t_s, measured q with its slopes qd and qdd, measured torque, desired position
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Arguments that `simulate` and `run` share.
#[derive(Debug, Args)]
pub(super) struct MotionArguments {
    /// A table with t_s, q, qd, qdd; an excitation (.json); a path of the tool (.toml, see docs/identification.md); or
    /// `validation`, a seeded path through via points
    #[arg(long, value_name = "FILE|validation")]
    trajectory: String,
    /// Seed of plant, noise and validation path
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Play this long, s, at most 100000; an excitation repeats, a validation path is made as long, everything else
    /// ends by itself
    #[arg(long, value_parser = duration)]
    duration_s: Option<f64>,
    /// Bandwidth of the PD controller, Hz; at most 30
    #[arg(long, default_value_t = 6.0, value_parser = bandwidth)]
    pd_bandwidth_hz: f64,
    /// Standard deviation of the torque noise, share of the torque limit
    #[arg(long, default_value_t = 0.01, value_parser = not_negative)]
    torque_noise: f64,
    #[command(flatten)]
    disturbances: DisturbanceArguments,
    #[command(flatten)]
    faults: FaultArguments,
    /// The plant is the description itself, not a variation of it by up to 20 %
    #[arg(long)]
    exact: bool,
}

pub(super) const PERIOD_S: f64 = 1e-3;

/// Largest bandwidth of the PD controller, Hz: half of that of its speed filter. A faster loop shakes the arm where its inertia is a
/// third of the mean one.
const MOST_BANDWIDTH_HZ: f64 = 30.0;

fn bandwidth(text: &str) -> Result<f64, String> {
    at_most(text, MOST_BANDWIDTH_HZ)
}

/// Argument for runs in trouble.
#[derive(Debug, Args)]
pub(super) struct Verdict {
    /// Exit with success although the board latched a fault, was unarmed, clipped or saturated for more than 5 % of the run,
    /// or a joint hardly moved
    #[arg(long)]
    keep_going: bool,
}

impl Verdict {
    /// Names the troubles before everything else.
    pub(super) fn show(&self, troubles: &[String]) -> Result<(), Failure> {
        let mut lines = troubles.iter();
        lines.try_for_each(|trouble| show!("TROUBLE: {trouble}"))
    }

    /// Errors: a run in trouble, unless it was to keep going.
    pub(super) fn judge(&self, troubles: &[String]) -> Result<(), Failure> {
        if !troubles.is_empty() && !self.keep_going {
            bail!("{} (--keep-going accepts it)", troubles.join("; "));
        }
        Ok(())
    }
}

/// Everything a closed loop needs besides a board.
pub(super) struct Scene<const N: usize> {
    /// The described robot, with assumed rotors.
    pub(super) robot: Robot,
    pub(super) plant: Plant<N>,
    pub(super) pd: PdConfig<N>,
    pub(super) trajectory: Trajectory<N>,
    pub(super) ticks: usize,
}

impl MotionArguments {
    pub(super) fn files(&self) -> impl Iterator<Item = PathBuf> {
        [PathBuf::from(&self.trajectory)]
            .into_iter()
            .chain(self.disturbances.effects.clone())
    }

    /// Plant, controller and trajectory.
    ///
    /// Errors: a file that is none, a trajectory of another robot, numbers that make no sense.
    pub(super) fn scene<const N: usize>(&self, robot: &Robot) -> Result<Scene<N>, Failure> {
        let robot = &with_rotors(robot)?;
        let other_size = || unsupported(N);
        let truth = match self.exact {
            true => robot.clone(),
            false => robot.perturbed(self.seed),
        };
        let config = PlantConfig {
            torque_noise: self.torque_noise,
            ..self.disturbances.plant_config()?
        };
        let nominal = ReferenceModel::<N>::new(robot).ok_or_else(other_size)?;
        let (name, duration_s) = (&self.trajectory, self.duration_s);
        let trajectory = Trajectory::load(name, robot, self.seed, duration_s, PERIOD_S)?;
        let asked_s = self.duration_s.unwrap_or(f64::INFINITY);
        let duration_s = match &trajectory {
            Trajectory::Excitation { duration_s, .. } => *duration_s,
            ends => asked_s.min(ends.duration_s()),
        };
        let ticks = (duration_s / PERIOD_S).round() as usize;
        if ticks == 0 {
            bail!("the motion is shorter than a period of 1 ms");
        }
        Ok(Scene {
            robot: robot.clone(),
            plant: Plant::new(&truth, config, self.seed)
                .ok_or_else(other_size)?
                .with_events(self.disturbances.events::<N>(duration_s)?)
                .with_faults(self.faults.faults()),
            pd: PdConfig::tuned(&nominal, self.pd_bandwidth_hz, PERIOD_S),
            trajectory,
            ticks,
        })
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    keep_stdout_for(&arguments.out);
    let robot = arguments.robot.load_coupled()?;
    let mut read = arguments.robot.files();
    read.extend(arguments.motion.files());
    let out = &arguments.out;
    let beside = arguments.mcap.then(|| out.with_extension("mcap"));
    not_over(read, beside.into_iter().chain([out.clone()]))?;
    joints!(robot.joint_count(), N => simulate::<N>(arguments, &robot), else Err(unsupported(robot.joint_count())))
}

fn simulate<const N: usize>(arguments: &Arguments, robot: &Robot) -> Result<(), Failure> {
    let mut scene = arguments.motion.scene::<N>(robot)?;
    let gains = robot.joints.iter().map(Joint::gain);
    let gains = arguments.current.then(|| Joints::from_iterator(gains));
    let mut seen = ClosedLoopLog::new(&scene.robot, scene.ticks);
    let mut log = MotionLog::<N>::create(&arguments.out, arguments.mcap, gains, false)?;
    let bar = Bar::new();
    let (plant, path) = (&mut scene.plant, &scene.trajectory);
    let mut play = ClosedLoop::new(plant, &scene.pd, path, PERIOD_S, None)?;
    for tick in 0..scene.ticks {
        let record = play.tick(plant, None)?;
        seen.add(&record, None, None);
        log.add(&record)?;
        if tick % 256 == 0 {
            bar.show("simulate", tick, scene.ticks);
        }
    }
    log.finish()?;
    drop(bar);
    let troubles = seen.troubles();
    arguments.verdict.show(&troubles)?;
    let errors = seen.tracking_rms_mrad();
    let errors: Vec<String> = errors.iter().map(|error| format!("{error:.3}")).collect();
    let (ticks, errors) = (scene.ticks, errors.join(", "));
    show!("{ticks} ticks, tracking errors of the joints {errors} mrad RMS")?;
    arguments.verdict.judge(&troubles)
}
