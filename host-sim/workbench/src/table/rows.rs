//! Checked rows of a CSV file: as wide as the header, finite numbers, time ascending.

use super::{TableError, TableProblem, is_compressed};
use crate::files::at;
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// Reads a CSV file row by row, in constant memory. A name that ends in `.gz` is decompressed.
pub(crate) struct Rows {
    path: PathBuf,
    reader: csv::Reader<Box<dyn Read + Send>>,
    record: csv::ByteRecord,
    header: Vec<String>,
    previous_s: Option<f64>,
}

impl Rows {
    pub(crate) fn open(path: &Path) -> Result<Self, TableError> {
        let file = File::open(path).map_err(|error| at(path, error))?;
        let bytes: Box<dyn Read + Send> = if is_compressed(path) {
            Box::new(MultiGzDecoder::new(BufReader::new(file)))
        } else {
            Box::new(file)
        };
        let mut reader = csv::ReaderBuilder::new()
            .flexible(true)
            .trim(csv::Trim::Headers)
            .buffer_capacity(1 << 18)
            .from_reader(bytes);
        let header = reader.headers().map_err(|error| unreadable(path, &error))?;
        Ok(Self {
            path: path.to_owned(),
            header: header.iter().map(str::to_owned).collect(),
            reader,
            record: csv::ByteRecord::new(),
            previous_s: None,
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Place of a column; `None` if the table does not have it.
    pub(crate) fn find(&self, column: &str) -> Result<Option<usize>, TableError> {
        let names = self.header.iter().enumerate();
        let mut places = names.filter(|(_, name)| *name == column).map(|(k, _)| k);
        match (places.next(), places.next()) {
            (_, Some(_)) => Err(self.header_error(TableProblem::RepeatedColumn, column)),
            (first, None) => Ok(first),
        }
    }

    /// Place of a column that must be there.
    pub(crate) fn require(&self, column: &str) -> Result<usize, TableError> {
        self.find(column)?
            .ok_or_else(|| self.header_error(TableProblem::MissingColumn, column))
    }

    /// Refuses the column of a joint that a robot of `joints` joints does not have.
    pub(crate) fn refuse(&self, column: &str, joints: usize) -> Result<(), TableError> {
        match self.find(column)? {
            Some(_) => {
                let extra = |column| TableProblem::ExtraColumn(column, joints);
                Err(self.header_error(extra, column))
            }
            None => Ok(()),
        }
    }

    fn header_error(&self, problem: impl Fn(String) -> TableProblem, column: &str) -> TableError {
        problem(column.to_owned()).at(&self.path, 1)
    }

    /// Reads the next row; false at the end.
    pub(crate) fn advance(&mut self) -> Result<bool, TableError> {
        let more = self.reader.read_byte_record(&mut self.record);
        if !more.map_err(|error| unreadable(&self.path, &error))? {
            return Ok(false);
        }
        if self.record.len() != self.header.len() {
            let problem = TableProblem::Ragged(self.record.len(), self.header.len());
            return Err(problem.at(&self.path, self.line()));
        }
        Ok(true)
    }

    /// Line of the row, from 1.
    pub(crate) fn line(&self) -> u64 {
        self.record.position().map_or(0, csv::Position::line)
    }

    /// The number in a column of the row.
    pub(crate) fn number(&self, column: usize) -> Result<f64, TableError> {
        let field = self.record.get(column).unwrap_or_default();
        let number = std::str::from_utf8(field).ok();
        let number = number.and_then(|text| text.trim().parse::<f64>().ok());
        number.filter(|value| value.is_finite()).ok_or_else(|| {
            let text = String::from_utf8_lossy(field).trim().to_owned();
            TableProblem::NotANumber(self.header[column].clone(), text).at(&self.path, self.line())
        })
    }

    /// The time in a column of the row, after that of the row before.
    pub(crate) fn time(&mut self, column: usize) -> Result<f64, TableError> {
        let t_s = self.number(column)?;
        match self.previous_s.replace(t_s) {
            Some(previous_s) if t_s <= previous_s => {
                Err(TableProblem::Time(t_s, previous_s).at(&self.path, self.line()))
            }
            _ => Ok(t_s),
        }
    }
}

fn unreadable(path: &Path, error: &csv::Error) -> TableError {
    TableProblem::Unreadable(error.to_string()).at(path, None)
}
