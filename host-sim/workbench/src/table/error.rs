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
    /// Column and time that does not come after the time of the row before, both in the unit of the column.
    #[error("column {0}: {1} does not come after {2}")]
    Time(String, f64, f64),
    /// There is a header at most.
    #[error("no rows")]
    Empty,
    /// So many rows, too few for a motion.
    #[error("{0} rows, a motion needs 3 at least")]
    Short(usize),
    /// The first row holds so many numbers instead of names.
    #[error("no header row, {0} numbers: name the columns by --names t_s,q1_rad,…")]
    NoHeader(usize),
    /// The columns found, and lines of a map to be completed.
    #[error(
        "no columns for time, positions and torques (t_s, q1_rad…, tau1_nm…) and none of a known source\n{0}"
    )]
    NoColumns(String),
    /// The joints of the log, and of the robot.
    #[error("the log has joints {0}, the robot {1}: name the columns by --columns-from FILE")]
    OtherJoints(String, String),
    /// Column, value and size beyond which no joint is.
    #[error("column {0}: {1:e} is no measurement of a joint")]
    Implausible(String, f64),
    /// Column and angle, rad, of a jump that a joint with ends in its range cannot make.
    #[error(
        "column {0}: a jump of {1:.3} rad, a wrap that this joint with ends in its range cannot make: a torque in the place of the position, or other units (--units)?"
    )]
    Wrap(String, f64),
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
