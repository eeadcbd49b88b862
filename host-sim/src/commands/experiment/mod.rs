//! The studies, each a command of its own.

mod campaign;
mod demo;
mod efficiency;
mod learning;
mod real_ur5;
mod replay_real;
mod soak;

use super::boards::BoardChoice;
use super::terminal::say;
use super::{Failure, unusable};
use clap::{Args, Command, Subcommand};
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::feedforward::ParameterSet;
use foretorque_link::bank::ParameterBank;
use foretorque_workbench::board::{BoardError, Client};
use std::path::PathBuf;

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
    Demo(demo::Arguments),
    Efficiency(efficiency::Arguments),
    Excitation(campaign::ExcitationArguments),
    Learning(learning::Arguments),
    Paper(campaign::PaperArguments),
    /// Identify a real UR5 on some paths, validate on the others, every path held out in turn
    RealUr5(OfLogs),
    /// The board learns a real UR5 from its logs, row by row, against batch least squares
    ReplayReal(OfLogs),
    Soak(soak::Arguments),
}

/// Where a study writes to.
#[derive(Debug, Args)]
struct Out {
    /// Directory for report.json and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// The board that native runs are compared with.
#[derive(Debug, Args)]
struct Beside {
    /// Board that a part is compared with bit for bit: qemu, or native for none
    #[arg(long, default_value = "qemu")]
    board: BoardChoice,
}

/// What the studies of the real UR5 take.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
struct OfLogs {
    #[command(flatten)]
    out: Out,
    /// Directory of the logs
    #[arg(long, value_name = "DIR", default_value = "tests/data/ur5-real")]
    logs: PathBuf,
    /// Seed of random starts
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.study {
        _ if arguments.list => list(),
        Some(Study::Demo(arguments)) => demo::run(arguments),
        Some(Study::Efficiency(arguments)) => efficiency::run(arguments),
        Some(Study::Excitation(arguments)) => campaign::run_excitation(arguments),
        Some(Study::Learning(arguments)) => learning::run(arguments),
        Some(Study::Paper(arguments)) => campaign::run_paper(arguments),
        Some(Study::RealUr5(arguments)) => real_ur5::run(arguments),
        Some(Study::ReplayReal(arguments)) => replay_real::run(arguments),
        Some(Study::Soak(arguments)) => soak::run(arguments),
        None => Err(unusable("which experiment? `experiment --list` shows them")),
    }
}

/// Names of the studies, each with one line on what it shows.
fn list() -> Result<(), Failure> {
    let studies = Study::augment_subcommands(Command::new("experiment"));
    for study in studies.get_subcommands() {
        let shows = study.get_about().map(ToString::to_string);
        let shows = shows.unwrap_or_default();
        say(format_args!("{:<12} {shows}", study.get_name()))?;
    }
    Ok(())
}

impl Beside {
    /// Its client; none if it would be the native one.
    ///
    /// Errors: of the board, also that it does not take a bank of this program: said now, not after the native runs.
    fn connect(&self) -> Result<Option<Client<JOINTS>>, Failure> {
        if self.board == BoardChoice::Native {
            return Ok(None);
        }
        let mut board = self.board.connect::<Ur5, JOINTS, PARAMETERS>(None)?;
        let set = ParameterSet::<JOINTS, PARAMETERS>::nominal::<Ur5>(1);
        let bank = ParameterBank::from_set::<Ur5, JOINTS, PARAMETERS>(&set);
        match board.upload_bank(&bank) {
            Err(BoardError::Refused(reason)) => Err(unusable(format!(
                "board {} does not take this program's bank ({reason}): its firmware is of another source, build it \
                 with `cargo firmware`",
                self.board
            ))),
            taken => Ok(taken.map(|()| Some(board))?),
        }
    }
}
