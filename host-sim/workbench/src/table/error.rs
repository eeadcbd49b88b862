//! What is wrong with a table, as one line.

use std::fmt;
use std::io;
use std::path::PathBuf;

/// What is wrong with a table.
#[derive(Debug)]
pub enum TableError {
    /// The file cannot be opened or read.
    File(io::Error),
    /// The file is no CSV (wrong encoding, broken compression).
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        reason: String,
    },
    /// The header lacks a column.
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The first column that is missing.
        column: String,
    },
    /// The header names a column twice.
    RepeatedColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// The header names a column of a joint the robot does not have.
    ExtraColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// Joints of the robot.
        joints: usize,
    },
    /// A row has more or fewer fields than the header.
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
    Empty {
        /// The file.
        path: PathBuf,
    },
}

impl fmt::Display for TableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(error) => write!(f, "{error}"),
            Self::Unreadable { path, reason } => write!(f, "{}: {reason}", path.display()),
            Self::MissingColumn { path, column } => {
                write!(f, "{}:1: column {column} is missing", path.display())
            }
            Self::RepeatedColumn { path, column } => {
                write!(f, "{}:1: column {column} appears twice", path.display())
            }
            Self::ExtraColumn {
                path,
                column,
                joints,
            } => write!(
                f,
                "{}:1: column {column} is one too many: the robot has {joints} joints",
                path.display()
            ),
            Self::Ragged {
                path,
                line,
                found,
                expected,
            } => write!(
                f,
                "{}:{line}: {found} fields where the header has {expected}",
                path.display()
            ),
            Self::NotANumber {
                path,
                line,
                column,
                text,
            } => write!(
                f,
                "{}:{line}: column {column}: {text:?} is not a finite number",
                path.display()
            ),
            Self::Time {
                path,
                line,
                t_s,
                previous_s,
            } => write!(
                f,
                "{}:{line}: column t_s: {t_s} does not come after {previous_s}",
                path.display()
            ),
            Self::Empty { path } => write!(f, "{}: no rows", path.display()),
        }
    }
}

impl std::error::Error for TableError {}
