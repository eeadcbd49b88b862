//! The commands: arguments in, files out.

mod arm;
mod attended;
mod bank;
mod boards;
mod commission;
mod compare;
mod describe;
mod disturbances;
#[cfg(test)]
mod documented;
mod drive;
mod excite;
mod experiment;
mod faults;
mod generate;
mod identify;
mod motion_log;
mod record;
mod replay;
mod run;
mod simulate;
mod terminal;
mod torque;
mod wiring;

use clap::CommandFactory as _;
use terminal::show;
pub(crate) use terminal::show_failure;

use clap::error::ErrorKind;
use clap::{Args, Parser, Subcommand};
use foretorque_workbench::identification::{Finding, Judgement};
use foretorque_workbench::snapshot;
use std::error::Error;
use std::path::{Path, PathBuf};

/// Whatever stopped a command, as one line.
pub(crate) type Failure = Box<dyn Error>;

/// Why a command cannot do what its arguments ask.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Unusable(String);

impl std::fmt::Display for Unusable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl Error for Unusable {}

/// Exit code of a failure: 2 for a wrong command line, of which an option is named first, 1 for all else.
pub(crate) fn exit_code(failure: &Failure) -> u8 {
    let wrong = failure.downcast_ref::<Unusable>();
    let wrong = wrong
        .is_some_and(|Unusable(text)| text.starts_with("--") || text.ends_with("(see --help)"));
    1 + u8::from(wrong)
}

fn unusable(reason: impl Into<String>) -> Failure {
    Box::new(Unusable(reason.into()))
}

/// Success for logs without a finding that refuses.
///
/// Errors: the first such finding, with the `way` out.
fn sound(judgement: &Judgement, logs: &[PathBuf], way: &str) -> Result<(), Failure> {
    let refused = judgement.findings.iter().find(|finding| finding.refuses);
    refused.map_or(Ok(()), |Finding { text, .. }| {
        let names: Vec<String> = logs.iter().map(|log| log.display().to_string()).collect();
        Err(unusable(format!("{}: {text} ({way})", names.join(", "))))
    })
}

/// A finite number, as the value of an option.
fn finite(text: &str) -> Result<f64, String> {
    let wrong = format!("'{text}' is no number");
    fitting(text, |value| value.is_finite(), &wrong)
}

/// A number that fits, as the value of an option.
fn fitting(text: &str, fits: fn(f64) -> bool, wrong: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().ok();
    let value = value.filter(|value| value.is_finite() && fits(*value));
    value.ok_or_else(|| wrong.to_owned())
}

fn positive(text: &str) -> Result<f64, String> {
    fitting(text, |value| value > 0.0, "must be positive")
}

fn not_negative(text: &str) -> Result<f64, String> {
    fitting(text, |value| value >= 0.0, "must not be negative")
}

fn share(text: &str) -> Result<f64, String> {
    let fits = |value| (0.0..=1.0).contains(&value);
    fitting(text, fits, "must lie between 0 and 1")
}

/// Arguments of a command as `words` give them, the others as without an option.
fn arguments<A: clap::Args>(words: &[&str]) -> Result<A, Failure> {
    let command = A::augment_args(clap::Command::new("host-sim").no_binary_name(true));
    Ok(A::from_arg_matches(&command.try_get_matches_from(words)?)?)
}

/// Refuses a robot of so many joints.
fn unsupported(joints: usize) -> Failure {
    unusable(format!("robots of {joints} joints are not supported"))
}

/// Refuses to write over what is read.
fn not_over(input: &Path, out: &Path) -> Result<(), Failure> {
    let one = |path: &Path| std::fs::canonicalize(path).ok();
    if one(input).is_some_and(|input| one(out) == Some(input)) {
        let name = out.display();
        return Err(unusable(format!("--out {name} is the file that is read")));
    }
    Ok(())
}

/// A snapshot of the figures.
#[derive(Debug, Args)]
struct Snapshot {
    /// Compare the figures with this file, and fail where one differs
    #[arg(long = "snapshot", value_name = "FILE")]
    file: Option<PathBuf>,
    /// Write the figures to that file instead
    #[arg(long, requires = "file")]
    accept: bool,
}

impl Snapshot {
    /// Errors: a snapshot to compare with that cannot be read.
    fn check(&self) -> Result<(), Failure> {
        match &self.file {
            Some(file) if !self.accept => {
                std::fs::read(file)
                    .map_err(|error| foretorque_workbench::files::at(file, error))?;
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Errors: figures that differ.
    fn keep(&self, text: &str) -> Result<(), Failure> {
        match &self.file {
            Some(file) => Ok(snapshot::keep(file, text, self.accept)?),
            None => Ok(()),
        }
    }
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
    Drive(drive::Arguments),
    Commission(commission::Arguments),
    Wiring(wiring::Arguments),
    Record(record::Arguments),
    Replay(replay::Arguments),
    Compare(compare::Arguments),
    Identify(identify::Arguments),
    Describe(describe::Arguments),
    Generate(generate::Arguments),
    Bank(bank::Arguments),
    Experiment(experiment::Arguments),
    Faults(faults::Arguments),
    /// Print the completions of a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// Reads the command line and executes it. Asking for help or the version ends the process.
///
/// Errors: whatever stopped the command.
pub(crate) fn run() -> Result<(), Failure> {
    let command = parsed(std::env::args_os())?.command;
    terminal::clean_up_when_interrupted()?;
    match command {
        Command::Torque(arguments) => torque::run(&arguments),
        Command::Excite(arguments) => excite::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Drive(arguments) => drive::run(&arguments),
        Command::Commission(arguments) => commission::run(&arguments),
        Command::Wiring(arguments) => wiring::run(&arguments),
        Command::Record(arguments) => record::run(&arguments),
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
        Command::Describe(arguments) => describe::run(&arguments),
        Command::Generate(arguments) => generate::run(&arguments),
        Command::Bank(arguments) => bank::run(&arguments),
        Command::Experiment(arguments) => experiment::run(&arguments),
        Command::Faults(arguments) => faults::run(&arguments),
        Command::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut CommandLine::command(), "host-sim", &mut text);
            show!("{}", String::from_utf8_lossy(&text).trim_end())
        }
    }
}

/// The command line; what is wrong with it as one line, without the usage that clap adds.
fn parsed(arguments: impl IntoIterator<Item = std::ffi::OsString>) -> Result<CommandLine, Failure> {
    CommandLine::try_parse_from(arguments).map_err(|error| {
        if !error.use_stderr()
            || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
        {
            error.exit();
        }
        let text = error.to_string();
        // What is wrong comes first, what was perhaps meant follows; the usage does not fit a line.
        let mut paragraphs = text.split("\n\n").map(str::trim);
        let wrong = paragraphs.next().unwrap_or_default();
        // An option is mistyped far more often than a value begins with two dashes.
        let helps = |tip: &&str| tip.starts_with("tip:") && !tip.contains(" as a value");
        let tip = paragraphs.find(helps);
        let wrong = wrong.trim_start_matches("error: ");
        let tip = tip.map(|tip| tip.trim_start_matches("tip:"));
        let parts = [Some(wrong), tip].into_iter().flatten();
        let parts = parts.map(|part| part.split_whitespace().collect::<Vec<_>>().join(" "));
        unusable(parts.collect::<Vec<_>>().join("; ") + " (see --help)")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_has_no_contradictions() {
        CommandLine::command().debug_assert();
    }

    #[test]
    fn a_wrong_command_line_is_told_in_one_line() {
        let cases = [
            ("host-sim frobnicate", "'frobnicate'"),
            (
                "host-sim torque --robot ur5 --board quemu --in a --out b",
                "'quemu'",
            ),
            ("host-sim torque", "--robot <ROBOT>"),
            ("host-sim torqe", "'torque'"),
            (
                "host-sim describe ur5 --rotor 1",
                "'--rotor' found; a similar argument exists: '--rotor-inertia' (see --help)",
            ),
            ("host-sim describe ur5 --tp hand", "'--tp' found (see"),
            (
                "host-sim describe ur5 --torque-limits -5",
                "must be positive",
            ),
        ];
        for (line, names) in cases {
            let arguments = line.split(' ').map(Into::into);
            let message = parsed(arguments).expect_err(line).to_string();
            assert_eq!(message.lines().count(), 1, "{message}");
            assert!(message.contains(names), "{message}");
        }
    }
}
