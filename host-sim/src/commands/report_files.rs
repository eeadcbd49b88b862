//! What a study leaves: `report.json`, and `report.html` beside it.

use super::Failure;
use foretorque_workbench::files::{WholeFile, write_whole};
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A report that is being made. Dropped before [`finish`](Self::finish) it leaves nothing behind.
pub(super) struct ReportFiles {
    json: WholeFile,
    page: PathBuf,
}

impl ReportFiles {
    /// The report in the directory `out`.
    ///
    /// Errors: a directory that cannot be written, which is so said before the work.
    pub(super) fn create(out: &Path) -> io::Result<Self> {
        Ok(Self {
            json: WholeFile::create(&out.join("report.json"))?,
            page: out.join("report.html"),
        })
    }

    /// Writes both; returns where the page is.
    ///
    /// Errors: the file system's.
    pub(super) fn finish(
        mut self,
        report: &impl Serialize,
        page: &str,
    ) -> Result<PathBuf, Failure> {
        serde_json::to_writer_pretty(&mut self.json, report)?;
        self.json.write_all(b"\n")?;
        write_whole(&self.page, page.as_bytes())?;
        self.json.finish()?;
        Ok(self.page)
    }
}
