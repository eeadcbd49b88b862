//! The commands: arguments in, files out.

mod bank;
mod boards;
mod excite;
mod experiment;
mod generate;
mod identify;
mod progress;
mod run;
mod simulate;
mod torque;

use clap::{Parser, Subcommand};
use std::error::Error;

/// Whatever stopped a command, as one line.
pub type Failure = Box<dyn Error>;

/// Why a command cannot do what its arguments ask.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Unusable(String);

impl std::fmt::Display for Unusable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl Error for Unusable {}

fn unusable(reason: impl Into<String>) -> Failure {
    Box::new(Unusable(reason.into()))
}

/// Simulator and workbench of foretorque: torque feed-forward that learns on the microcontroller.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110)]
struct CommandLine {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Torque(torque::Arguments),
    Excite(excite::Arguments),
    Simulate(simulate::Arguments),
    Run(run::Arguments),
    Identify(identify::Arguments),
    Generate(generate::Arguments),
    Bank(bank::Arguments),
    Experiment(experiment::Arguments),
}

/// Reads the command line and does what it says. Help and usage errors end the process as clap sees fit.
///
/// Errors: whatever stopped the command.
pub fn run() -> Result<(), Failure> {
    match CommandLine::parse().command {
        Command::Torque(arguments) => torque::run(&arguments),
        Command::Excite(arguments) => excite::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
        Command::Generate(arguments) => generate::run(&arguments),
        Command::Bank(arguments) => bank::run(&arguments),
        Command::Experiment(arguments) => experiment::run(&arguments),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_has_no_contradictions() {
        CommandLine::command().debug_assert();
    }
}
