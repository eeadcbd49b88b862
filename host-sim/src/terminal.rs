//! All output to the terminal; progress goes to the error stream, so that no output is disturbed: a bar on a terminal, one line
//! a minute elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;
use std::fmt::{Arguments, Display};
use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Results go to stdout, so lines about them go to stderr.
static RESULTS_ON_STDOUT: AtomicBool = AtomicBool::new(false);

/// Sends the lines of [`show!`](show) to stderr if `out` is `-`.
pub(super) fn keep_stdout_for(out: &Path) {
    RESULTS_ON_STDOUT.store(out == Path::new("-"), Ordering::Relaxed);
}

/// Writes a formatted line to stdout; see [`write_line`].
macro_rules! show {
    ($($argument:tt)*) => {
        $crate::terminal::write_line(format_args!($($argument)*))
            .map_err($crate::Failure::from)
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

/// A part of the command ends by itself after a signal.
static ENDS_ITSELF: AtomicBool = AtomicBool::new(false);
/// Set by the first signal to such a part.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Removes unfinished files on SIGINT, SIGTERM or SIGHUP, and ends by that signal; while there is a [`SignalGuard`] only after
/// a second one.
///
/// Errors: a system that lets no handler be set.
pub(super) fn clean_up_when_interrupted() -> io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    std::thread::spawn(move || {
        for signal in signals.forever() {
            if ENDS_ITSELF.load(Ordering::Relaxed) && !INTERRUPTED.swap(true, Ordering::Relaxed) {
                continue;
            }
            foretorque_workbench::files::remove_unfinished(|| {
                let _ = emulate_default_handler(signal);
            });
        }
    });
    Ok(())
}

/// Part of a command that the first signal does not end: there is a torque to switch off, or a file to finish.
pub(super) struct SignalGuard;

impl SignalGuard {
    pub(super) fn begin() -> Self {
        ENDS_ITSELF.store(true, Ordering::Relaxed);
        Self
    }

    pub(super) fn interrupted(&self) -> bool {
        INTERRUPTED.load(Ordering::Relaxed)
    }
}

impl Drop for SignalGuard {
    fn drop(&mut self) {
        ENDS_ITSELF.store(false, Ordering::Relaxed);
    }
}

/// The command that is running, to be typed again from the workspace's root.
pub(super) fn command_line() -> String {
    let words = std::env::args_os().skip(1);
    let words: Vec<String> = words.map(|word| word.to_string_lossy().into()).collect();
    // No argument has the zero byte that no shell takes.
    let words = shlex::try_join(words.iter().map(String::as_str)).unwrap_or_default();
    format!("cargo run --release -p host-sim -- {words}")
}

fn received(written: io::Result<()>) -> io::Result<()> {
    match written {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(io::Error::new(error.kind(), format!("stdout: {error}"))),
        Ok(()) => Ok(()),
    }
}

/// Time between two lines where there is no terminal.
const MINUTE: Duration = Duration::from_secs(60);

/// A bar for one counted stage after the other.
pub(super) struct Bar {
    bar: ProgressBar,
    lines: Lines,
}

/// Lines at most once a minute.
pub(super) struct Lines(Mutex<Instant>);

impl Lines {
    pub(super) fn new() -> Self {
        Self(Mutex::new(Instant::now()))
    }

    /// Writes a line if the last one is a minute old and there is no terminal.
    pub(super) fn show(&self, line: impl FnOnce() -> String) {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if last.elapsed() >= MINUTE && !console_is_terminal() {
            *last = Instant::now();
            // A closed pipe is no failure.
            let _ = writeln!(std::io::stderr(), "{}", line());
        }
    }
}

fn console_is_terminal() -> bool {
    std::io::IsTerminal::is_terminal(&std::io::stderr())
}

impl Bar {
    pub(super) fn new() -> Self {
        let bar = ProgressBar::new(0);
        // A template that does not parse would only cost the bar its looks.
        let template = "{msg:>22} [{bar:32}] {pos}/{len} {per_sec}, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        Self {
            bar,
            lines: Lines::new(),
        }
    }

    /// `done` of `all` in `stage`.
    pub(super) fn show(&self, stage: &'static str, done: usize, all: usize) {
        if self.bar.message() != stage {
            self.bar.reset();
            self.bar.set_message(stage);
        }
        self.bar.set_length(all as u64);
        self.bar.set_position(done as u64);
        self.lines
            .show(|| remaining(stage, done, all, self.bar.elapsed()));
    }
}

/// `stage 300/1200, 45 s left`.
fn remaining(stage: &str, done: usize, all: usize, elapsed: Duration) -> String {
    let left_s = elapsed.as_secs_f64() * all.saturating_sub(done) as f64 / done.max(1) as f64;
    format!("{stage} {done}/{all}, {left_s:.0} s left")
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_pipe_is_no_failure_and_a_full_disk_is_one() {
        assert!(received(Err(io::ErrorKind::BrokenPipe.into())).is_ok());
        let full = received(Err(io::ErrorKind::StorageFull.into())).expect_err("not silenced");
        assert!(full.to_string().starts_with("stdout: "), "{full}");
    }

    #[test]
    fn the_time_that_is_left_is_that_of_the_rest_at_the_pace_so_far() {
        let line = remaining("run", 300, 1200, Duration::from_secs(15));
        assert_eq!(line, "run 300/1200, 45 s left");
    }
}
