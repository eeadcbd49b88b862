//! Other programs, without a standard input: shown, captured, or bounded in time; and cargo as it compiles for the board.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;
use std::{env, fmt};

use anyhow::{Context as _, Result, bail};

pub(crate) fn root() -> PathBuf {
    let manifest_dir = Path::new(env!("CARGO_MANIFEST_DIR"));
    manifest_dir.parent().unwrap_or(manifest_dir).to_path_buf()
}

/// A command as one types it, with single words between blanks; it runs in the workspace's root.
pub(crate) fn command(line: &str) -> Command {
    let mut words = line.split_whitespace();
    let mut command = Command::new(words.next().unwrap_or_default());
    command.args(words);
    // `cargo run` exports the cargo it is; a toolchain of another name must find its own. What is built is looked for in the
    // workspace.
    let foreign = ["CARGO", "CARGO_TARGET_DIR", "CARGO_BUILD_TARGET_DIR"];
    foreign.iter().for_each(|name| _ = command.env_remove(name));
    command.current_dir(root());
    command.stdin(Stdio::null());
    command
}

/// The command as one would type it, without its environment.
pub(crate) fn line(command: &Command) -> String {
    let mut line = command.get_program().to_string_lossy().into_owned();
    for arg in command.get_args() {
        let _ = write!(line, " {}", arg.to_string_lossy());
    }
    line
}

/// Runs with the output shown; an exit code other than zero is an error.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    let status = command.status();
    let status = status.with_context(|| format!("cannot start `{}`", line(command)))?;
    if !status.success() {
        bail!("`{}` failed ({status})", line(command));
    }
    Ok(())
}

/// Standard output of a command that succeeds in silence; `None` when it cannot start or fails.
pub(crate) fn capture(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    let text = || String::from_utf8_lossy(&output.stdout).into_owned();
    output.status.success().then(text)
}

/// Runs a command in silence for at most `limit` seconds; the error carries the program's own first `error` line.
pub(crate) fn run_bounded(of: &str, limit: u32) -> Result<()> {
    let mut bounded = command(&format!("timeout {limit} {of}"));
    let output = bounded.env_remove("RUST_BACKTRACE").output();
    let output = output.with_context(|| format!("cannot start `{}`", line(&bounded)))?;
    let text = String::from_utf8_lossy(&output.stderr);
    let reason = match output.status.code() {
        Some(0) => return Ok(()),
        Some(124) => "was ended",
        _ => first_error(&text),
    };
    // rustup writes its whole chain of causes on that line.
    let reason: String = reason.chars().take(160).collect();
    bail!("`{}`: {reason}", line(&bounded))
}

fn first_error(text: &str) -> &str {
    let error = text.lines().find(|line| line.starts_with("error"));
    error.unwrap_or("no reason given")
}

pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Writes a file, and the directories that it needs.
pub(crate) fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let written = path.parent().map_or(Ok(()), fs::create_dir_all);
    let written = written.and_then(|()| fs::write(path, content));
    written.with_context(|| format!("cannot write {}", path.display()))
}

/// A path as one types it in the workspace's root.
pub(crate) fn shown(path: &Path) -> String {
    let short = path.strip_prefix(root());
    short.unwrap_or(path).display().to_string()
}

/// Does a task; prints its name before, its result and its time after.
pub(crate) fn timed<T>(task: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
    println!("set-up: {task}");
    let start = Instant::now();
    let outcome = work();
    let verdict = if outcome.is_ok() { "done" } else { "failed" };
    let seconds = start.elapsed().as_secs_f64();
    println!("set-up: {verdict} after {seconds:.1} s");
    outcome
}

/// The board's Rust target: Cortex-M4 with its single-precision FPU.
pub(crate) const TARGET: &str = "thumbv7em-none-eabihf";

/// The board's cargo profile.
pub(crate) const PROFILE: &str = "firmware";

/// Name under which set-up links the toolchain it builds.
pub(crate) const LINKED_NAME: &str = "foretorque-arm";

/// The linked ELF of a binary of the board.
pub(crate) fn elf(binary: &str) -> PathBuf {
    elf_dir().join(binary)
}

/// Directory of the linked ELF files of the board.
pub(crate) fn elf_dir() -> PathBuf {
    root().join("target").join(TARGET).join(PROFILE)
}

/// A Rust toolchain that set-up found or made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Toolchain {
    /// The one `cargo xtask` itself runs in.
    Host,
    /// The one set-up built from Debian's packages.
    Linked,
}

/// The cargo command as one types it.
impl fmt::Display for Toolchain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Toolchain::Host => write!(f, "cargo"),
            Toolchain::Linked => write!(f, "cargo +{LINKED_NAME}"),
        }
    }
}

impl Toolchain {
    /// A command of one of its programs.
    pub(crate) fn tool(self, line: &str) -> Command {
        match self {
            Toolchain::Host => command(line),
            Toolchain::Linked => command(&format!("rustup run {LINKED_NAME} {line}")),
        }
    }

    /// `cargo SUBCOMMAND` for the board and every image, in target and profile of the board.
    pub(crate) fn board_cargo(self, subcommand: &str) -> Command {
        self.tool(&format!(
            "cargo {subcommand} --profile {PROFILE} --target {TARGET} -p foretorque-f405 -p foretorque-images"
        ))
    }
}

/// Which toolchain does what in this workspace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tools {
    /// Compiles, links and lints for the board.
    pub(crate) board: Toolchain,
    /// Lints the host's code and formats everything.
    pub(crate) host: Toolchain,
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_child_that_hangs_is_ended_at_its_limit() {
        let start = Instant::now();
        let error = run_bounded("sleep 600", 1).unwrap_err();
        assert!(start.elapsed() < Duration::from_secs(60));
        assert!(error.to_string().contains("was ended"), "{error}");
    }

    #[test]
    fn the_first_error_is_the_reason() {
        let text = "noise\nerror: no route\nerror: later";
        assert_eq!(first_error(text), "error: no route");
        assert_eq!(first_error("noise"), "no reason given");
    }

    #[test]
    fn a_failing_child_is_quoted_with_its_reason() {
        let error = run_bounded("cargo no-such-thing", 60).unwrap_err();
        let reason = "`timeout 60 cargo no-such-thing`: error: no such command";
        assert!(error.to_string().starts_with(reason), "{error}");
    }
}
