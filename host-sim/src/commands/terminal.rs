//! All output to the terminal.

use std::fmt::{Arguments, Display};
use std::io::{self, Write};
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;

/// Results go to stdout, so lines about them go to stderr.
static RESULTS_ON_STDOUT: AtomicBool = AtomicBool::new(false);

/// Sends the lines of [`show!`](show) to stderr if `out` is `-`.
pub(super) fn keep_stdout_for(out: &Path) {
    RESULTS_ON_STDOUT.store(out == Path::new("-"), Ordering::Relaxed);
}

/// Writes a formatted line to stdout; see [`write_line`].
macro_rules! show {
    ($($argument:tt)*) => {
        $crate::commands::terminal::write_line(format_args!($($argument)*))
            .map_err($crate::commands::Failure::from)
    };
}
pub(super) use show;

/// Writes a line to stdout. A closed pipe (`host-sim … | head -1`) is no failure: the files are the result.
///
/// Errors: any other of the system, such as a full disk.
pub(super) fn write_line(line: Arguments<'_>) -> io::Result<()> {
    if RESULTS_ON_STDOUT.load(Ordering::Relaxed) {
        return received(writeln!(io::stderr(), "{line}"));
    }
    received(writeln!(io::stdout(), "{line}"))
}

/// Writes the line that a command failed with to stderr.
pub(crate) fn show_failure(failure: impl Display) {
    // A closed stderr leaves no place for an error message.
    let _ = writeln!(io::stderr(), "error: {failure}");
}

/// Set by the first signal to a command that ends by itself.
static INTERRUPTED: OnceLock<AtomicBool> = OnceLock::new();

/// Removes unfinished files on SIGINT, SIGTERM or SIGHUP, and ends by that signal; a command that has called
/// [`interrupted`] only after a second one.
///
/// Errors: a system that lets no handler be set.
pub(super) fn clean_up_when_interrupted() -> io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    std::thread::spawn(move || {
        for signal in signals.forever() {
            let orderly = INTERRUPTED.get();
            if orderly.is_some_and(|flag| !flag.swap(true, Ordering::Relaxed)) {
                continue;
            }
            foretorque_workbench::files::remove_unfinished();
            let _ = emulate_default_handler(signal);
        }
    });
    Ok(())
}

/// True after the first signal, which does not end the program any more: the command has a torque to switch off.
pub(super) fn interrupted() -> &'static AtomicBool {
    INTERRUPTED.get_or_init(AtomicBool::default)
}

/// The command that is running, to be typed again from the workspace's root.
pub(super) fn command_line() -> String {
    std::env::args_os().skip(1).fold(
        "cargo run --release -p host-sim --".to_owned(),
        |line, word| line + " " + &quoted(&word.to_string_lossy()),
    )
}

/// A word as a shell reads it back.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

fn received(written: io::Result<()>) -> io::Result<()> {
    match written {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(io::Error::new(error.kind(), format!("stdout: {error}"))),
        Ok(()) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_survive_the_shell() {
        for (word, written) in [
            ("--seed", "--seed"),
            ("a b", "'a b'"),
            ("", "''"),
            ("it's", r"'it'\''s'"),
            ("$x", "'$x'"),
        ] {
            assert_eq!(quoted(word), written);
        }
    }

    #[test]
    fn a_closed_pipe_is_no_failure_and_a_full_disk_is_one() {
        assert!(received(Err(io::ErrorKind::BrokenPipe.into())).is_ok());
        let full = received(Err(io::ErrorKind::StorageFull.into())).expect_err("not silenced");
        assert!(full.to_string().starts_with("stdout: "), "{full}");
    }
}
