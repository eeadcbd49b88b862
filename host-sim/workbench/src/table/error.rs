//! What is wrong with a table, as one line.

use std::io;
use std::path::PathBuf;

/// What is wrong with a table.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file cannot be opened or read.
    #[error("{0}")]
    File(io::Error),
    /// The file is no CSV (wrong encoding, broken compression).
    #[error("{path}: {reason}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        reason: String,
    },
    /// The header lacks a column.
    #[error("{path}:1: column {column} is missing")]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The first column that is missing.
        column: String,
    },
    /// The header names a column twice.
    #[error("{path}:1: column {column} appears twice")]
    RepeatedColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// The header names a column of a joint the robot does not have.
    #[error("{path}:1: column {column} is one too many: the robot has {joints} joints")]
    ExtraColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// Joints of the robot.
        joints: usize,
    },
    /// A row has more or fewer fields than the header.
    #[error("{path}:{line}: {found} fields where the header has {expected}")]
    Ragged {
        /// The file.
        path: PathBuf,
        /// Line of the row, from 1.
        line: u64,
        /// Fields of the row.
        found: usize,
        /// Fields of the header.
        expected: usize,
    },
    /// A field is no finite number.
    #[error("{path}:{line}: column {column}: {text:?} is not a finite number")]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// Line of the row, from 1.
        line: u64,
        /// Column of the field.
        column: String,
        /// What stands there.
        text: String,
    },
    /// Time stands still or runs backwards.
    #[error("{path}:{line}: column t_s: {t_s} does not come after {previous_s}")]
    Time {
        /// The file.
        path: PathBuf,
        /// Line of the row, from 1.
        line: u64,
        /// Time of the row, s.
        t_s: f64,
        /// Time of the row before, s.
        previous_s: f64,
    },
    /// There is a header at most.
    #[error("{path}: no rows")]
    Empty {
        /// The file.
        path: PathBuf,
    },
}
