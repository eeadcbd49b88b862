//! Faults of a table, as one line.

use std::io;
use std::path::{Path, PathBuf};

/// A table that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file cannot be opened or read.
    #[error(transparent)]
    File(#[from] io::Error),
    /// The table is damaged.
    #[error("{path}{}: {problem}", line.map_or(String::new(), |line| format!(":{line}")))]
    Table {
        /// The file.
        path: PathBuf,
        /// Line, from 1, if the problem has one.
        line: Option<u64>,
        /// The problem.
        problem: TableProblem,
    },
}

/// A problem of a table.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TableProblem {
    /// The file is no CSV (wrong encoding, broken compression); message of the reader.
    #[error("{0}")]
    Unreadable(String),
    /// The header lacks this column.
    #[error("column {0} is missing")]
    MissingColumn(String),
    /// The header names this column twice.
    #[error("column {0} appears twice")]
    RepeatedColumn(String),
    /// The header names a column of a joint that a robot of so many joints does not have.
    #[error("column {0} is one too many: the robot has {1} joints")]
    ExtraColumn(String, usize),
    /// Number of fields of the row, and of the header.
    #[error("{0} fields where the header has {1}")]
    Ragged(usize, usize),
    /// Column and text of a field that is no finite number.
    #[error("column {0}: {1:?} is not a finite number")]
    NotANumber(String, String),
    /// Time that does not come after the time of the row before, s.
    #[error("column t_s: {0} does not come after {1}")]
    Time(f64, f64),
    /// There is a header at most.
    #[error("no rows")]
    Empty,
}

impl TableProblem {
    /// The error in a line of a file, or in the file as a whole.
    pub fn at(self, path: &Path, line: impl Into<Option<u64>>) -> TableError {
        TableError::Table {
            path: path.to_owned(),
            line: line.into(),
            problem: self,
        }
    }
}
