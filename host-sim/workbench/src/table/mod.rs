//! Tables of joint states as CSV: a header row with units in the names, one row an instant.
//!
//! `t_s`, then `q1_rad…`, `qd1_rad_s…`, `qdd1_rad_s2…`, `tau1_nm…`; further columns are ignored on reading. A name that
//! ends in `.gz` is compressed. Every error names file, line and column.

mod bag;
mod rows;
mod writer;

pub(crate) use rows::Rows;
pub use writer::TableWriter;

use crate::dynamics::{Joints, State};
use std::io;
use std::path::{Path, PathBuf};

/// One row of a table of states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateRow<const N: usize> {
    /// Time, s, where the table has it.
    pub t_s: Option<f64>,
    /// The motion of all joints.
    pub motion: State<N>,
}

/// Whether a table must have the times of its rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeColumn {
    /// `t_s` is checked where present.
    Optional,
    /// `t_s` must be there.
    Required,
}

/// Reads a table of the states of `N` joints row by row, in constant memory.
pub struct StateReader<const N: usize> {
    rows: Rows,
    time: Option<usize>,
    /// Places of q1…qn, qd1…qdn, qdd1…qddn.
    places: Vec<usize>,
}

impl<const N: usize> StateReader<N> {
    /// Opens a table that holds position, velocity and acceleration of all joints.
    ///
    /// Errors: [`TableError`] of the header.
    pub fn open(path: &Path, time: TimeColumn) -> Result<Self, TableError> {
        let rows = Rows::open(path)?;
        let columns = state_columns(N);
        let places = columns.iter().map(|column| rows.require(column));
        let places = places.collect::<Result<_, _>>()?;
        // The table of a larger arm also has the columns of this one.
        for (name, unit) in STATE {
            rows.refuse(&format!("{name}{}_{unit}", N + 1), N)?;
        }
        let time = match time {
            TimeColumn::Required => Some(rows.require("t_s")?),
            TimeColumn::Optional => rows.find("t_s")?,
        };
        Ok(Self { rows, time, places })
    }

    /// The table has the times of its rows.
    pub fn has_time(&self) -> bool {
        self.time.is_some()
    }

    /// All rows at once.
    ///
    /// Errors: [`TableError`] of the first bad row, or of a table without rows.
    pub fn read_all(mut self) -> Result<Vec<StateRow<N>>, TableError> {
        let rows = self.by_ref().collect::<Result<Vec<_>, _>>()?;
        if rows.is_empty() {
            return Err(TableError::empty(&self.rows.path));
        }
        Ok(rows)
    }

    fn row(&mut self) -> Result<Option<StateRow<N>>, TableError> {
        if !self.rows.advance()? {
            return Ok(None);
        }
        let t_s = self.time.map(|column| self.rows.time(column)).transpose()?;
        let mut motion = State::<N>::rest(Joints::zeros());
        let values = motion.q.iter_mut().chain(&mut motion.qd);
        for (value, column) in values.chain(&mut motion.qdd).zip(&self.places) {
            *value = self.rows.number(*column)?;
        }
        Ok(Some(StateRow { t_s, motion }))
    }
}

impl<const N: usize> Iterator for StateReader<N> {
    type Item = Result<StateRow<N>, TableError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.row().transpose()
    }
}

/// Names and units of a state's columns.
const STATE: [(&str, &str); 3] = [("q", "rad"), ("qd", "rad_s"), ("qdd", "rad_s2")];

/// `q1_rad…, qd1_rad_s…, qdd1_rad_s2…`
pub fn state_columns(joints: usize) -> Vec<String> {
    let columns = STATE.map(|(name, unit)| joint_columns(name, unit, joints));
    columns.concat()
}

/// One column a joint: `name1_unit…`.
pub fn joint_columns(name: &str, unit: &str, joints: usize) -> Vec<String> {
    (1..=joints)
        .map(|joint| format!("{name}{joint}_{unit}"))
        .collect()
}

/// Writes the motion of an arm and its torques, N·m, as a table: `t_s`, the state's columns, and one a joint of each of
/// the names of `torques`.
///
/// Errors: the file system's.
pub fn write_motion<const N: usize, const T: usize>(
    path: &Path,
    torques: [&str; T],
    rows: impl IntoIterator<Item = (f64, State<N>, [Joints<N>; T])>,
) -> io::Result<()> {
    let mut header = vec!["t_s".to_owned()];
    header.extend(state_columns(N));
    header.extend(torques.iter().flat_map(|name| joint_columns(name, "nm", N)));
    let mut table = TableWriter::create(path, &header)?;
    for (t_s, state, torques) in rows {
        let joints = [&state.q, &state.qd, &state.qdd]
            .into_iter()
            .chain(&torques);
        table.row(std::iter::once(&t_s).chain(joints.flatten()))?;
    }
    table.finish()
}

pub(crate) fn is_compressed(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "gz")
}

/// A table that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file cannot be opened or read.
    #[error(transparent)]
    File(#[from] io::Error),
    /// The table is damaged: file, line, from 1, if the problem has one, and the problem, with the column.
    #[error("{}{}: {}", .0.display(), .1.map_or(String::new(), |line| format!(":{line}")), .2)]
    Table(PathBuf, Option<u64>, String),
}

impl TableError {
    /// The problem in a line of a file, or in the file as a whole.
    pub fn at(path: &Path, line: impl Into<Option<u64>>, problem: impl Into<String>) -> Self {
        Self::Table(path.to_owned(), line.into(), problem.into())
    }

    /// There is a header at most.
    pub fn empty(path: &Path) -> Self {
        Self::at(path, None, "no rows")
    }

    pub(crate) fn missing(path: &Path, column: &str) -> Self {
        Self::at(path, 1, format!("column {column} is missing"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use tempfile::tempdir;

    #[test]
    fn errors_name_file_line_and_column() {
        let directory = tempdir().expect("creates");
        // Lines of the table behind each other, and the message behind the name of the file.
        let cases = "\
t_s,q1_rad,qd1_rad_s | :1: column qdd1_rad_s2 is missing
q1_rad,qd1_rad_s,qdd1_rad_s2 0,0,0 | :1: column t_s is missing
t_s,q1_rad,q1_rad,qd1_rad_s,qdd1_rad_s2 | :1: column q1_rad appears twice
t_s,q1_rad,q2_rad,qd1_rad_s,qdd1_rad_s2 | :1: column q2_rad is one too many: the robot has 1 joints
SOUND 0,0,0,0 1,2,3 | :3: 3 fields where the header has 4
SOUND 0,0,0,0 1,2,x,4 | :3: column qd1_rad_s: \"x\" is not a finite number
SOUND 0,0,0,NaN | :2: column qdd1_rad_s2: \"NaN\" is not a finite number
SOUND 0,0,0, | :2: column qdd1_rad_s2: \"\" is not a finite number
SOUND 1,0,0,0 2,0,0,0 2,0,0,0 | :4: column t_s: 2 does not come after 2
SOUND | : no rows
 | : no rows";
        for case in cases.lines() {
            let (table, expected) = case.split_once(" | ").expect("a table and a message");
            let path = directory.path().join("states.csv");
            let sound = "t_s,q1_rad,qd1_rad_s,qdd1_rad_s2";
            let text = table.replace("SOUND", sound).replace(' ', "\n");
            fs::write(&path, text + "\n").expect("writes");
            let error = StateReader::<1>::open(&path, TimeColumn::Required)
                .and_then(StateReader::read_all)
                .expect_err(case);
            assert_eq!(error.to_string(), format!("{}{expected}", path.display()));
        }
        let path = directory.path().join("book.xlsx");
        fs::write(&path, b"PK\x03\x04\xff\xfe").expect("writes");
        let error = StateReader::<1>::open(&path, TimeColumn::Required).err();
        let error = error.expect("no text").to_string();
        assert!(error.contains("no text in UTF-8: write CSV"), "{error}");
    }

    #[test]
    fn a_table_comes_back_to_the_last_bit_plain_and_compressed() {
        let directory = tempdir().expect("creates");
        for name in ["round.csv", "round.csv.gz"] {
            let path = directory.path().join(name);
            let mut header = vec!["t_s".to_owned(), "tau1_nm".to_owned()];
            header.extend(state_columns(1));
            let mut writer = TableWriter::create(&path, &header).expect("creates");
            for row in [
                [0.0, 9.0, 0.1, -1.0 / 3.0, 1e-17],
                [0.1 + 0.2, 9.0, 2.0, 3.0, 4.0],
            ] {
                writer.row(row).expect("writes");
            }
            writer.finish().expect("finishes");
            let rows = StateReader::<1>::open(&path, TimeColumn::Required)
                .and_then(StateReader::read_all)
                .expect("reads");
            assert_eq!(rows[0].motion.qd[0], -1.0 / 3.0);
            assert_eq!(rows[0].motion.qdd[0], 1e-17);
            assert_eq!(rows[1].t_s, Some(0.1 + 0.2));
        }
    }

    #[test]
    fn a_table_that_is_not_finished_does_not_appear() {
        let directory = tempdir().expect("creates");
        let path = directory.path().join("half.csv");
        let mut writer = TableWriter::create(&path, &["a".to_owned()]).expect("creates");
        writer.row([1.0]).expect("writes");
        drop(writer);
        assert!(!path.exists());
    }
}
