//! Progress bars: on a terminal only, on the error stream, so that no output is disturbed.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar for one counted stage after the other.
pub(super) struct Bar(ProgressBar);

impl Bar {
    pub(super) fn new() -> Self {
        let bar = ProgressBar::new(0);
        // A template that does not parse would only cost the bar its looks.
        if let Ok(style) =
            ProgressStyle::with_template("{msg:>22} [{bar:32}] {pos}/{len} {per_sec}")
        {
            bar.set_style(style.progress_chars("=> "));
        }
        Self(bar)
    }

    /// `done` of `all` in `stage`.
    pub(super) fn show(&self, stage: &'static str, done: usize, all: usize) {
        if self.0.message() != stage {
            self.0.reset();
            self.0.set_message(stage);
        }
        self.0.set_length(all as u64);
        self.0.set_position(done as u64);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
