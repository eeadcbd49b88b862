//! Reports: figures as JSON, and one self-contained page that opens offline.

pub mod closed_loop;
mod color;
pub mod page;
pub mod plot;

use crate::files::{WholeFile, write_whole};
use page::Page;
use plot::PlotError;
use serde::Serialize;
use std::io;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A report under construction. Dropped before [`finish`](Self::finish) it leaves nothing behind.
pub struct ReportFiles {
    json: WholeFile,
    page: PathBuf,
}

/// Failure to write a report.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum ReportError {
    /// The file system's.
    File(#[from] io::Error),
    /// Figures that JSON cannot hold.
    Json(#[from] serde_json::Error),
    /// The plot library's.
    Plot(#[from] PlotError),
}

impl ReportFiles {
    /// The report in the directory `out`.
    ///
    /// Errors: a directory that cannot be written.
    pub fn create(out: &Path) -> io::Result<Self> {
        Ok(Self {
            json: WholeFile::create(&out.join("report.json"))?,
            page: out.join("report.html"),
        })
    }

    /// Writes both files; returns the path of the page.
    ///
    /// Errors: [`ReportError`].
    pub fn finish(mut self, report: &impl Serialize, page: &Page) -> Result<PathBuf, ReportError> {
        serde_json::to_writer_pretty(&mut self.json, report)?;
        self.json.write_all(b"\n")?;
        write_whole(&self.page, page.html()?.as_bytes())?;
        self.json.finish()?;
        Ok(self.page)
    }
}

/// Text made safe for HTML and SVG.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
