//! Command line of foretorque: arguments in, files out.

mod arm;
mod bank;
mod boards;
mod bus;
mod commission;
mod compare;
mod describe;
mod disturbances;
mod drive;
mod excite;
mod experiment;
mod faults;
mod identification;
mod identify;
mod logs;
mod motion_log;
mod run;
mod simulate;
mod terminal;
mod torque;

use clap::error::ErrorKind;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use foretorque_workbench::Refusal;
use foretorque_workbench::files::text_of;
use foretorque_workbench::identification::{Finding, Judgement, joined};
use foretorque_workbench::snapshot;
use foretorque_workbench::trajectory::MOST_DURATION_S;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use terminal::show;

/// Whatever stopped a command, as one line.
type Failure = Box<dyn Error + Send + Sync>;

/// Exit code of a failure: 2 for a wrong command line, of which an option is named first, 1 for all else.
fn exit_code(failure: &Failure) -> u8 {
    let wrong = failure.downcast_ref::<Refusal>();
    let wrong =
        wrong.is_some_and(|Refusal(text)| text.starts_with("--") || text.ends_with("(see --help)"));
    1 + u8::from(wrong)
}

/// Refuses arguments without effect on a command.
fn unusable(reason: impl Into<String>) -> Failure {
    Box::new(Refusal(reason.into()))
}

/// Ends the function with a refusal, given as a format.
macro_rules! bail {
    ($($text:tt)*) => {
        return Err($crate::unusable(format!($($text)*)))
    };
}

use bail;

/// Success for logs without a finding that refuses.
///
/// Errors: the first such finding, with the `way` out.
fn sound(judgement: &Judgement, logs: &[PathBuf], way: &str) -> Result<(), Failure> {
    if let Some(Finding { text, .. }) = judgement.findings.iter().find(|own| own.refuses) {
        bail!("{}: {text} ({way})", joined(logs));
    }
    Ok(())
}

fn finite(text: &str) -> Result<f64, String> {
    fitting(text, |_| true, &format!("'{text}' is no number"))
}

/// A number that fits, as the value of an option.
fn fitting(text: &str, fits: impl Fn(f64) -> bool, wrong: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().map_err(|_| "not a number")?;
    let sound = (value.is_finite() && fits(value)).then_some(value);
    sound.ok_or_else(|| wrong.to_owned())
}

fn positive(text: &str) -> Result<f64, String> {
    fitting(text, |value| value > 0.0, "must be positive")
}

/// A positive number of at most `most`.
fn at_most(text: &str, most: f64) -> Result<f64, String> {
    let wrong = format!("must be positive and at most {most}");
    fitting(text, |value| value > 0.0 && value <= most, &wrong)
}

/// Time of a motion, s.
fn duration(text: &str) -> Result<f64, String> {
    at_most(text, MOST_DURATION_S)
}

fn not_negative(text: &str) -> Result<f64, String> {
    fitting(text, |value| value >= 0.0, "must not be negative")
}

fn share(text: &str) -> Result<f64, String> {
    fitting(
        text,
        |value| (0.0..=1.0).contains(&value),
        "must lie between 0 and 1",
    )
}

/// Arguments of a command as `words` give them, the others as without an option.
fn arguments<A: clap::Args>(words: &[&str]) -> Result<A, Failure> {
    let command = A::augment_args(clap::Command::new("host-sim").no_binary_name(true));
    Ok(A::from_arg_matches(&command.try_get_matches_from(words)?)?)
}

fn unsupported(joints: usize) -> Failure {
    unusable(format!("robots of {joints} joints are not supported"))
}

/// Refuses to write a file of `out` over one that is read.
fn not_over(
    read: impl IntoIterator<Item = PathBuf>,
    out: impl IntoIterator<Item = PathBuf>,
) -> Result<(), Failure> {
    let one = |path: &PathBuf| fs::canonicalize(path).ok();
    let read: Vec<PathBuf> = read.into_iter().filter_map(|path| one(&path)).collect();
    let is_read = |path: &PathBuf| one(path).is_some_and(|path| read.contains(&path));
    if let Some(path) = out.into_iter().find(is_read) {
        bail!("--out {} is the file that is read", path.display());
    }
    Ok(())
}

/// Errors: a result in the directory `out` in the place of which there is a file that no earlier run wrote: the last of
/// `results`, its figures, is missing.
fn not_foreign(out: &Path, results: &[&str]) -> Result<(), Failure> {
    let figures = results.last().copied().unwrap_or_default();
    if !out.join(figures).exists()
        && let Some(file) = within(out, results).find(|file| file.exists())
    {
        bail!(
            "--out: {} is there without the {figures} of an earlier run: choose another directory",
            file.display()
        );
    }
    Ok(())
}

fn within<'n>(directory: &Path, names: &'n [&str]) -> impl Iterator<Item = PathBuf> + 'n {
    let directory = directory.to_owned();
    names.iter().map(move |name| directory.join(name))
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
            Some(file) if !self.accept => Ok(text_of(file).map(drop)?),
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
    Wiring(bus::WiringArguments),
    Record(logs::Record),
    Replay(logs::Replay),
    Compare(compare::Arguments),
    Identify(identify::Arguments),
    Describe(describe::Describe),
    Generate(describe::Generate),
    Bank(bank::Arguments),
    Experiment(experiment::Arguments),
    Faults(faults::Arguments),
    /// Print the completions of a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            terminal::show_failure(&failure);
            ExitCode::from(exit_code(&failure))
        }
    }
}

/// Reads the command line and executes it. Asking for help or the version ends the process.
fn run() -> Result<(), Failure> {
    let command = parsed()?.command;
    terminal::clean_up_when_interrupted()?;
    match command {
        Command::Torque(arguments) => torque::run(&arguments),
        Command::Excite(arguments) => excite::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Drive(arguments) => drive::run(&arguments),
        Command::Commission(arguments) => commission::run(&arguments),
        Command::Wiring(arguments) => bus::write_wiring(&arguments),
        Command::Record(arguments) => arguments.run(),
        Command::Replay(arguments) => arguments.run(),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
        Command::Describe(arguments) => arguments.run(),
        Command::Generate(arguments) => arguments.run(),
        Command::Bank(arguments) => bank::run(&arguments),
        Command::Experiment(arguments) => experiment::run(&arguments),
        Command::Faults(arguments) => faults::run(&arguments),
        Command::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut program(), "host-sim", &mut text);
            let text = String::from_utf8_lossy(&text);
            // clap_complete 4.6 writes the hyphen of the name one way in its states and another way in its labels.
            show!(
                "{}",
                text.replace("host__subcmd__sim", "host__sim").trim_end()
            )
        }
    }
}

/// The program. Its options take negative numbers, which clap would refuse as unknown options.
fn program() -> clap::Command {
    let with_signs = |command: clap::Command| command.allow_negative_numbers(true);
    let commands = |command| with_signs(command).mut_subcommands(with_signs);
    CommandLine::command().mut_subcommands(commands)
}

/// The command line; what is wrong with it as one line, without the usage that clap adds.
fn parsed() -> Result<CommandLine, Failure> {
    let matches = program().try_get_matches();
    let parsed = matches.and_then(|matches| CommandLine::from_arg_matches(&matches));
    parsed.map_err(|error| {
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
        program().debug_assert();
    }

    /// README.md, CONTRIBUTING.md and the pages of docs/.
    fn pages() -> Vec<PathBuf> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let docs = fs::read_dir(root.join("docs")).expect("it is there");
        let docs = docs.map(|entry| entry.expect("it is there").path());
        let docs = docs.filter(|path| path.extension().is_some_and(|end| end == "md"));
        docs.chain(["README.md", "CONTRIBUTING.md"].map(|page| root.join(page)))
            .collect()
    }

    /// Code of a page: lines between fences, and text between two backticks, also across a line end.
    fn code(page: &str) -> Vec<String> {
        let mut found = Vec::new();
        for (index, part) in page.split("```").enumerate() {
            if index % 2 == 1 {
                found.extend(part.lines().map(str::to_owned));
            } else {
                found.extend(part.split('`').skip(1).step_by(2).map(str::to_owned));
            }
        }
        found
    }

    /// The words after the name of the program, as far as they belong to it; the name may be left out before a command with
    /// arguments.
    fn words<'c>(code: &'c str, program: &clap::Command) -> Option<Vec<&'c str>> {
        let mut words = code.split_whitespace().peekable();
        let own = |word: &&str| program.find_subcommand(word).is_some();
        if !words.peek().is_some_and(own) {
            // `cargo test -p host-sim --test …` is not the program's.
            let mut names = words
                .by_ref()
                .filter(|word| ["host-sim", "test"].contains(word));
            names.next().filter(|word| *word == "host-sim")?;
            words.next_if_eq(&"--");
        }
        let ends = |word: &&str| matches!(*word, "#" | "|" | "&&" | ";" | "…");
        Some(words.take_while(|word| !ends(word)).collect())
    }

    /// Defect of a command line of a page.
    fn wrong(words: &[&str], program: &clap::Command) -> Option<String> {
        let mut command = program;
        let mut asked = Vec::new();
        for word in words {
            let word = word.trim_matches(|c| "[]().,;:'\"".contains(c));
            if let Some(option) = word.strip_prefix("--") {
                asked.push(option.split('=').next().unwrap_or_default());
            } else if asked.is_empty() && command.has_subcommands() {
                match command.find_subcommand(word) {
                    Some(below) => command = below,
                    // `experiment NAME`: any of them.
                    None if word.chars().all(|c| c.is_ascii_uppercase()) => return None,
                    None => return Some(format!("{} has no command {word}", command.get_name())),
                }
            }
        }
        let known = |option: &&str| {
            let is_called = |argument: &clap::Arg| {
                let names = argument.get_all_aliases().unwrap_or_default();
                argument.get_long() == Some(option) || names.contains(option)
            };
            ["help", "version", ""].contains(option) || command.get_arguments().any(is_called)
        };
        let unknown = asked.into_iter().find(|option| !known(option))?;
        Some(format!("{} has no --{unknown}", command.get_name()))
    }

    #[test]
    fn every_command_of_the_pages_exists_with_its_options() {
        let mut program = CommandLine::command();
        program.build();
        let mut seen = 0;
        for path in pages() {
            for code in code(&fs::read_to_string(&path).expect("it is text")) {
                if let Some(words) = words(&code, &program) {
                    let wrong = wrong(&words, &program);
                    assert_eq!(wrong, None, "{}: `{code}`", path.display());
                    seen += 1;
                }
            }
        }
        assert!(seen > 60, "only {seen} commands were found");
    }

    #[test]
    fn a_command_that_is_none_is_noticed() {
        let mut program = CommandLine::command();
        program.build();
        let judged = |code| wrong(&words(code, &program).expect("it is a command"), &program);
        for sound in [
            "cargo run --release -p host-sim -- experiment soak --out DIR      # ten million --ticks",
            "host-sim run --board serial:PORT …",
            "experiment NAME --out DIR",
            "simulate --seed",
        ] {
            assert_eq!(judged(sound), None, "{sound}");
        }
        for (code, named) in [
            ("host-sim frobnicate", "frobnicate"),
            ("experiment learnign --out DIR", "learnign"),
            ("host-sim generate --robot FILE [--bsae LINK]", "--bsae"),
            ("experiment demo --quick", "--quick"),
        ] {
            assert!(judged(code).expect(code).contains(named), "{code}");
        }
        assert_eq!(words("cargo test -p host-sim --test cli", &program), None);
    }
}
