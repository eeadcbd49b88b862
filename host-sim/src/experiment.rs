//! The studies, each a command of its own.

use super::arm::ArmOptions;
use super::boards::BoardChoice;
use super::terminal::{Bar, show};
use super::{Failure, Snapshot, bail, duration, identification, unusable};
use clap::{Args, Command, Subcommand};
use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::feedforward::ParameterSet;
use foretorque_link::bank::ParameterBank;
use foretorque_studies::demo::{self, DemoConfig};
use foretorque_studies::excitation::{self, ExcitationConfig};
use foretorque_studies::learning::soak::{self, SoakConfig};
use foretorque_studies::learning::{self, LearningConfig};
use foretorque_studies::paper::{self, PaperConfig};
use foretorque_studies::{Outcome, Progress, Records, efficiency, real_ur5, replay};
use foretorque_workbench::board::BoardError;
use foretorque_workbench::report::ReportFiles;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory;
use serde::Serialize;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// Run one of the reproducible studies
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
#[command(subcommand_value_name = "NAME", subcommand_help_heading = "Studies")]
#[command(disable_help_subcommand = true)]
pub(super) struct Arguments {
    /// List the studies
    #[arg(long)]
    list: bool,
    #[command(subcommand)]
    study: Option<Study>,
}

#[derive(Debug, Subcommand)]
enum Study {
    Demo(Demo),
    Efficiency(Efficiency),
    Excitation(Excitation),
    Identification(Identification),
    Learning(Learning),
    Paper(Paper),
    /// Identify a real UR5 on some paths, validate on the others, every path held out in turn
    RealUr5(OfLogs),
    /// The board learns a real UR5 from its logs, row by row, against batch least squares
    ReplayReal(OfLogs),
    Soak(Soak),
}

/// Output of a study.
#[derive(Debug, Args)]
struct Out {
    /// Directory for report.json and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    snapshot: Snapshot,
    /// Seed of everything random: plant, prior, paths, noise, starts
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// A study of independent jobs, over a range of seeds.
#[derive(Debug, Args)]
struct Jobs {
    /// Directory for report.json and report.html
    #[arg(long, value_name = "DIR", required_unless_present = "records")]
    out: Option<PathBuf>,
    #[command(flatten)]
    snapshot: Snapshot,
    /// The short form
    #[arg(long)]
    quick: bool,
    /// First seed
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only write the records of these seeds to this file; concatenated, such files make the report
    #[arg(long, value_name = "FILE", conflicts_with_all = ["from", "out", "file", "accept"])]
    records: Option<PathBuf>,
    /// Report the records in this file instead of computing them
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
}

/// From a wrong prior, learn on the board in closed loop, freeze, play an unseen path
#[derive(Debug, Args)]
struct Demo {
    #[command(flatten)]
    out: Out,
    /// Board: native, qemu, with the flashable firmware beside it over its USART, qemu-usart or serial:PORT
    #[arg(long, default_value = "qemu")]
    board: BoardChoice,
    /// Arm time with learning on, long run, s
    #[arg(long, default_value_t = DemoConfig::default().learning_s, value_parser = duration)]
    learning_s: f64,
    /// Arm time with learning on, flashable firmware, s
    #[arg(long, default_value_t = DemoConfig::default().usart_learning_s, value_parser = duration)]
    usart_learning_s: f64,
}

/// Error of the robust fit over the Cramér-Rao bound, without and with outliers
#[derive(Debug, Args)]
struct Efficiency {
    #[command(flatten)]
    out: Out,
    /// Noise draws of each case
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    draws: u32,
}

/// One optimised excitation for every seed, every limit counted again
#[derive(Debug, Args)]
struct Excitation {
    #[command(flatten)]
    jobs: Jobs,
    /// Number of seeds
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Robot: a built-in name or a description file
    #[arg(long, default_value = "ur5")]
    robot: String,
}

/// Methods of identification over arms, lengths of the log and columns
#[derive(Debug, Args)]
struct Identification {
    #[command(flatten)]
    out: Out,
    /// Number of arms, one for each seed
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
}

/// Learning on a world of arms, in closed loop, over everything that may go wrong
#[derive(Debug, Args)]
struct Learning {
    /// List arms and scenarios
    #[arg(long)]
    list: bool,
    /// Only the arms and scenarios whose names begin so; either may be left out: panda/slow, panda, /slow, /slow-bank
    #[arg(long, value_name = "ARM/SCENARIO")]
    only: Option<String>,
    /// Arm in place of those of the list: a built-in name, or a TOML, URDF or MJCF file
    #[arg(long, conflicts_with = "list")]
    robot: Option<String>,
    /// The short form
    #[arg(long)]
    quick: bool,
    /// Directory for report.json and report.html
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    #[arg(conflicts_with = "list")]
    out: Option<PathBuf>,
    #[command(flatten)]
    snapshot: Snapshot,
    /// First seed of arms, paths, noise and events
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of seeds
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    #[command(flatten)]
    arm: ArmOptions,
}

/// The paper's experiment step by step, then every method over noise, friction and outliers
#[derive(Debug, Args)]
struct Paper {
    #[command(flatten)]
    jobs: Jobs,
    /// Noise draws of every case
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Excitation to train on, an excitation.json for the UR5 [default: a precomputed one]
    #[arg(long, value_name = "FILE")]
    excitation: Option<PathBuf>,
}

/// Arguments of the studies of the real UR5.
#[derive(Debug, Args)]
struct OfLogs {
    #[command(flatten)]
    out: Out,
    /// Directory of the logs
    #[arg(long, value_name = "DIR", default_value = "tests/data/ur5-real")]
    logs: PathBuf,
}

/// Ten million ticks of learning: finite, positive, near exact arithmetic, equal bits on the board
#[derive(Debug, Args)]
struct Soak {
    #[command(flatten)]
    out: Out,
    /// Board that a part is compared with bit for bit: qemu, or native for none
    #[arg(long, default_value = "qemu")]
    board: BoardChoice,
    /// Ticks in this process
    #[arg(long, default_value = "10000000")]
    ticks: NonZeroUsize,
    /// Ticks that are compared with the board
    #[arg(long, default_value = "1000000")]
    board_ticks: NonZeroUsize,
}

impl Study {
    /// Errors: seeds beyond the largest number.
    fn check_seeds(&self) -> Result<(), Failure> {
        let (first, count) = match self {
            Self::Excitation(own) => (own.jobs.seed, own.seeds),
            Self::Identification(own) => (own.out.seed, own.seeds),
            Self::Learning(own) => (own.seed, own.seeds),
            Self::Paper(own) => (own.jobs.seed, own.seeds),
            _ => return Ok(()),
        };
        if first.checked_add(count).is_none() {
            bail!("--seed {first}: too large for --seeds {count}");
        }
        Ok(())
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(study) = &arguments.study {
        study.check_seeds()?;
    }
    match &arguments.study {
        _ if arguments.list => list(),
        Some(Study::Demo(arguments)) => run_demo(arguments),
        Some(Study::Efficiency(Efficiency { out, draws })) => {
            out.study(|progress| efficiency::run(&out.out, out.seed, *draws as usize, progress))
        }
        Some(Study::Excitation(own)) => {
            let (quick, seed) = (own.jobs.quick, own.jobs.seed);
            let config = ExcitationConfig::new(quick, &own.robot, seed, own.seeds);
            own.jobs
                .study(|records, _, progress| excitation::run(config, records, progress))
        }
        Some(Study::Identification(Identification { out, seeds })) => {
            out.study(|progress| identification::run(&out.out, (out.seed, *seeds), progress))
        }
        Some(Study::Learning(arguments)) => run_learning(arguments),
        Some(Study::Paper(arguments)) => run_paper(arguments),
        Some(Study::RealUr5(OfLogs { out, logs })) => {
            out.study(|progress| real_ur5::run(logs, out.seed, progress))
        }
        Some(Study::ReplayReal(OfLogs { out, logs })) => {
            out.study(|progress| replay::real_ur5(logs, out.seed, progress))
        }
        Some(Study::Soak(arguments)) => run_soak(arguments),
        None => bail!("which experiment? `experiment --list` shows them"),
    }
}

fn list() -> Result<(), Failure> {
    for study in Study::augment_subcommands(Command::new("experiment")).get_subcommands() {
        let shows = study.get_about().cloned().unwrap_or_default();
        show!("{:<14} {shows}", study.get_name())?;
    }
    Ok(())
}

impl Out {
    fn study<R: Serialize>(
        &self,
        work: impl FnOnce(Progress<'_>) -> Result<Outcome<R>, Failure>,
    ) -> Result<(), Failure> {
        study(&self.out, &self.snapshot, work)
    }
}

/// Runs `work` and writes its report into `out`.
fn study<R: Serialize>(
    out: &Path,
    snapshot: &Snapshot,
    work: impl FnOnce(Progress<'_>) -> Result<Outcome<R>, Failure>,
) -> Result<(), Failure> {
    // A place that cannot be written or compared is refused before the work.
    snapshot.check()?;
    let files = ReportFiles::create(out)?;
    let bar = Bar::new();
    let outcome = work(&|stage, done, all| bar.show(stage, done, all))?;
    drop(bar);
    let page = files.finish(&outcome.report, &outcome.page)?;
    show!("{}", outcome.text.trim_end())?;
    show!("report {}", page.display())?;
    match outcome.broken {
        Some(reason) => Err(unusable(reason)),
        None => snapshot.keep(&outcome.text),
    }
}

impl Jobs {
    fn study<R: Serialize>(
        &self,
        work: impl FnOnce(&Records, &Path, Progress<'_>) -> Result<Option<Outcome<R>>, Failure>,
    ) -> Result<(), Failure> {
        let out = self.out.clone().unwrap_or_default();
        if let Some(file) = &self.records {
            let bar = Bar::new();
            let progress = |stage, done, all| bar.show(stage, done, all);
            return work(&Records::Write(file.clone()), &out, &progress).map(drop);
        }
        let records = match &self.from {
            Some(file) => Records::Read(file.clone()),
            None => Records::Compute,
        };
        study(&out, &self.snapshot, |progress| {
            work(&records, &out, progress)?.ok_or_else(|| unusable("the records are only written"))
        })
    }
}

fn run_demo(arguments: &Demo) -> Result<(), Failure> {
    let (choice, learning_s) = (&arguments.board, arguments.learning_s);
    let beside = (*choice == BoardChoice::Qemu).then_some(BoardChoice::QemuUsart);
    let usart_learning_s = beside
        .as_ref()
        .map_or(learning_s, |_| arguments.usart_learning_s);
    if learning_s.min(usart_learning_s) < 1.0 {
        bail!("times of learning must be at least 1 s");
    }
    if usart_learning_s > learning_s {
        bail!("--usart-learning-s must not exceed --learning-s");
    }
    let config = DemoConfig {
        seed: arguments.out.seed,
        learning_s,
        usart_learning_s,
        ..DemoConfig::default()
    };
    arguments.out.study(|progress| {
        let mut bulk = choice.connect::<Ur5, JOINTS, PARAMETERS>(None)?;
        let usart = beside
            .as_ref()
            .map(|board| board.connect::<Ur5, JOINTS, PARAMETERS>(None));
        let mut usart = usart.transpose()?;
        let boards = (&mut bulk, usart.as_mut());
        let names = (choice.to_string(), choice.toolchain(Ur5::NAME));
        demo::run(&config, names, boards, progress)
    })
}

fn run_learning(arguments: &Learning) -> Result<(), Failure> {
    let Some(out) = &arguments.out else {
        for (name, shows) in learning::names() {
            show!("{name:<26} {shows}")?;
        }
        return Ok(());
    };
    let robot = arguments.robot.as_ref();
    if robot.is_none() && arguments.arm != ArmOptions::default() {
        bail!("options of an arm need --robot");
    }
    let config = LearningConfig {
        robot: robot.map(|name| arguments.arm.load(name)).transpose()?,
        seeds: (arguments.seed, arguments.seeds),
        only: arguments.only.clone(),
        quick: arguments.quick,
    };
    study(out, &arguments.snapshot, |progress| {
        learning::run(&config, progress)
    })
}

fn run_paper(arguments: &Paper) -> Result<(), Failure> {
    let jobs = &arguments.jobs;
    let mut config = PaperConfig::new(jobs.quick, jobs.seed, arguments.seeds)?;
    if let Some(path) = &arguments.excitation {
        config.excitation = trajectory::excitation(path, &Robot::load("ur5")?)?;
    }
    jobs.study(|records, out, progress| paper::run(config, records, out, progress))
}

fn run_soak(arguments: &Soak) -> Result<(), Failure> {
    let config = SoakConfig {
        seed: arguments.out.seed,
        ticks: arguments.ticks.get(),
        board_ticks: arguments.board_ticks.get(),
    };
    let choice = &arguments.board;
    arguments.out.study(|progress| {
        if *choice == BoardChoice::Native {
            return soak::run(&config, None, progress);
        }
        let mut board = choice.connect::<Ur5, JOINTS, PARAMETERS>(None)?;
        let set = ParameterSet::<JOINTS, PARAMETERS>::nominal::<Ur5>(1);
        let bank = ParameterBank::from_set::<Ur5, JOINTS, PARAMETERS>(&set);
        board.upload_bank(&bank).map_err(|error| match error {
            BoardError::Refused(reason) => unusable(format!(
                "board {choice} does not take this program's bank ({reason}): its firmware is of another source, build \
                 it with `cargo firmware`"
            )),
            other => other.into(),
        })?;
        soak::run(&config, Some(&mut board), progress)
    })
}
