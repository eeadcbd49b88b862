//! Progress on the error stream, so that no output is disturbed: a bar on a terminal, one line a minute elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two lines where there is no terminal.
const MINUTE: Duration = Duration::from_secs(60);

/// A bar for one counted stage after the other.
pub(super) struct Bar {
    bar: ProgressBar,
    lines: Lines,
    /// Begin of the stage.
    begin: Mutex<Instant>,
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
            // Nobody who listens is no failure.
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
        if let Ok(style) =
            ProgressStyle::with_template("{msg:>22} [{bar:32}] {pos}/{len} {per_sec}, {eta} left")
        {
            bar.set_style(style.progress_chars("=> "));
        }
        Self {
            bar,
            lines: Lines::new(),
            begin: Mutex::new(Instant::now()),
        }
    }

    /// `done` of `all` in `stage`.
    pub(super) fn show(&self, stage: &'static str, done: usize, all: usize) {
        let mut begin = self.begin.lock().unwrap_or_else(PoisonError::into_inner);
        if self.bar.message() != stage {
            self.bar.reset();
            self.bar.set_message(stage);
            *begin = Instant::now();
        }
        self.bar.set_length(all as u64);
        self.bar.set_position(done as u64);
        self.lines
            .show(|| remaining(stage, done, all, begin.elapsed()));
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
    fn the_time_that_is_left_is_that_of_the_rest_at_the_pace_so_far() {
        let line = remaining("run", 300, 1200, Duration::from_secs(15));
        assert_eq!(line, "run 300/1200, 45 s left");
    }
}
