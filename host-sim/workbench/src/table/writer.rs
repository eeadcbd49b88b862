//! Writing a table.

use super::is_compressed;
use crate::files::WholeFile;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fmt;
use std::io::{self, Write};
use std::path::Path;

/// Writes a table that is whole or absent.
pub struct TableWriter {
    writer: csv::Writer<Sink>,
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
        let file = WholeFile::create(path)?;
        let sink = if is_compressed(path) {
            Sink::Compressed(GzEncoder::new(file, Compression::default()))
        } else {
            Sink::Plain(file)
        };
        let mut writer = csv::Writer::from_writer(sink);
        writer.write_record(header)?;
        Ok(Self { writer })
    }

    /// Adds a row. Numbers are written with as many digits as bring back the same value.
    ///
    /// Errors: the file system's, or a row of another width than the header.
    pub fn row<T: fmt::Display>(&mut self, values: impl IntoIterator<Item = T>) -> io::Result<()> {
        self.writer
            .write_record(values.into_iter().map(|value| value.to_string()))?;
        Ok(())
    }

    /// Completes the table and gives it its name.
    ///
    /// Errors: the file system's.
    pub fn finish(self) -> io::Result<()> {
        let sink = self
            .writer
            .into_inner()
            .map_err(|error| io::Error::other(error.to_string()))?;
        match sink {
            Sink::Plain(file) => file.finish(),
            Sink::Compressed(encoder) => encoder.finish()?.finish(),
        }
    }
}
