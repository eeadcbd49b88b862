//! Writing a table.

use super::is_compressed;
use super::mcap::McapTable;
use crate::files::WholeFile;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fmt;
use std::io::{self, Write};
use std::path::Path;

/// Writes a table that is whole or absent: CSV, MCAP where the name ends in `.mcap`, or both.
pub struct TableWriter {
    csv: Option<Box<csv::Writer<Sink>>>,
    mcap: Option<Box<McapTable>>,
}

enum Sink {
    Plain(WholeFile),
    Compressed(GzEncoder<WholeFile>),
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Plain(file) => file.write(bytes),
            Self::Compressed(encoder) => encoder.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Plain(file) => file.flush(),
            Self::Compressed(encoder) => encoder.flush(),
        }
    }
}

impl TableWriter {
    /// Starts a table with its header row.
    ///
    /// Errors: the file system's.
    pub fn create(path: &Path, header: &[String]) -> io::Result<Self> {
        if path.extension().is_some_and(|end| end == "mcap") {
            let mcap = Some(Box::new(McapTable::create(path, header)?));
            return Ok(Self { csv: None, mcap });
        }
        let file = WholeFile::create(path)?;
        let sink = if is_compressed(path) {
            Sink::Compressed(GzEncoder::new(file, Compression::default()))
        } else {
            Sink::Plain(file)
        };
        let mut writer = csv::Writer::from_writer(sink);
        writer.write_record(header)?;
        let csv = Some(Box::new(writer));
        Ok(Self { csv, mcap: None })
    }

    /// Starts a table as CSV, and as MCAP beside it.
    ///
    /// Errors: the file system's.
    pub fn with_mcap(path: &Path, header: &[String]) -> io::Result<Self> {
        let beside = McapTable::create(&path.with_extension("mcap"), header)?;
        Ok(Self {
            mcap: Some(Box::new(beside)),
            ..Self::create(path, header)?
        })
    }

    /// Adds a row. Numbers are written with as many digits as bring back the same value.
    ///
    /// Errors: the file system's, or a row of another width than the header.
    pub fn row<T: fmt::Display>(&mut self, values: impl IntoIterator<Item = T>) -> io::Result<()> {
        let values: Vec<String> = values.into_iter().map(|value| value.to_string()).collect();
        if let Some(mcap) = &mut self.mcap {
            mcap.row(&values)?;
        }
        match &mut self.csv {
            Some(csv) => Ok(csv.write_record(&values)?),
            None => Ok(()),
        }
    }

    /// Completes the table and gives it its name.
    ///
    /// Errors: the file system's.
    pub fn finish(self) -> io::Result<()> {
        if let Some(mcap) = self.mcap {
            mcap.finish()?;
        }
        let Some(csv) = self.csv else {
            return Ok(());
        };
        let sink = csv
            .into_inner()
            .map_err(|error| io::Error::other(error.to_string()))?;
        match sink {
            Sink::Plain(file) => file.finish(),
            Sink::Compressed(encoder) => encoder.finish()?.finish(),
        }
    }
}
