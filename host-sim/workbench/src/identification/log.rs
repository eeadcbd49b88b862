//! Logs: the project's own columns, or foreign ones through the map of the robot description.

use crate::files::at;
use crate::robot::{LogColumns, Robot};
use crate::table::{TableError, is_compressed, unreadable};
use flate2::read::MultiGzDecoder;
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// One instant of a log, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogRow<const N: usize> {
    /// Line of the file, from 1.
    pub line: u64,
    /// Time, s.
    pub t_s: f64,
    /// Positions, rad.
    pub q: [f64; N],
    /// Velocities, rad/s; zero where the log has none.
    pub qd: [f64; N],
    /// Accelerations, rad/s²; zero where the log has none.
    pub qdd: [f64; N],
    /// Torques, N·m: logged, or drive gain × current.
    pub tau: [f64; N],
}

/// Reads a log row by row, in constant memory.
pub(super) struct LogReader<const N: usize> {
    path: PathBuf,
    reader: csv::Reader<Box<dyn Read + Send>>,
    record: csv::ByteRecord,
    header: Vec<String>,
    time: usize,
    q: [usize; N],
    qd: Option<[usize; N]>,
    qdd: Option<[usize; N]>,
    tau: [usize; N],
    /// Torque of one unit of the torque column: the drive gain where it is a current, N·m/A, else 1.
    gain: [f64; N],
    from_current: bool,
    mapped: bool,
    previous_s: Option<f64>,
}

impl<const N: usize> LogReader<N> {
    /// Opens a log. Own column names win over those of the map; time, position and torque (or current) are required.
    ///
    /// Errors: [`TableError`] of the header.
    pub(super) fn open(path: &Path, robot: &Robot) -> Result<Self, TableError> {
        let file = File::open(path).map_err(|error| TableError::File(at(path, error)))?;
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
        let header: Vec<String> = header.iter().map(str::to_owned).collect();
        let columns = Header::of(path, &header)?;
        let none = LogColumns::default();
        let map = robot.log_columns.as_ref().unwrap_or(&none);
        let time = columns.place("t_s");
        let time = time.or_else(|| columns.place(map.t_s.as_deref()?));
        let time = time.ok_or_else(|| columns.missing("t_s"))?;
        let q = columns.joints(("q", "rad"), map.q_rad.as_deref())?;
        let q = q.ok_or_else(|| columns.missing("q1_rad"))?;
        let qd = columns.joints(("qd", "rad_s"), map.qd_rad_s.as_deref())?;
        let qdd = columns.joints(("qdd", "rad_s2"), map.qdd_rad_s2.as_deref())?;
        let mut gain = [1.0; N];
        let logged = columns.joints(("tau", "nm"), map.tau_nm.as_deref())?;
        let from_current = logged.is_none();
        let tau = if from_current {
            for (gain, joint) in gain.iter_mut().zip(&robot.joints) {
                *gain = joint.drive.gain;
            }
            columns.joints(("i", "a"), map.i_a.as_deref())?
        } else {
            logged
        };
        Ok(Self {
            tau: tau.ok_or_else(|| columns.missing("tau1_nm"))?,
            mapped: columns.place("q1_rad").is_none(),
            path: path.to_owned(),
            reader,
            record: csv::ByteRecord::new(),
            time,
            q,
            qd,
            qdd,
            gain,
            from_current,
            previous_s: None,
            header,
        })
    }

    /// The log has velocities.
    pub(super) fn has_velocity(&self) -> bool {
        self.qd.is_some()
    }

    /// The log has accelerations.
    pub(super) fn has_acceleration(&self) -> bool {
        self.qdd.is_some()
    }

    /// Torque is drive gain × motor current.
    pub(super) fn has_currents(&self) -> bool {
        self.from_current
    }

    /// The columns were found through the map of the description.
    pub(super) fn is_mapped(&self) -> bool {
        self.mapped
    }

    /// The next row, `None` at the end.
    ///
    /// Errors: [`TableError`] of that row, naming line and column.
    pub(super) fn next_row(&mut self) -> Result<Option<LogRow<N>>, TableError> {
        let more = self.reader.read_byte_record(&mut self.record);
        if !more.map_err(|error| unreadable(&self.path, &error))? {
            return Ok(None);
        }
        let line = self.record.position().map_or(0, csv::Position::line);
        if self.record.len() != self.header.len() {
            return Err(TableError::Ragged {
                path: self.path.clone(),
                line,
                found: self.record.len(),
                expected: self.header.len(),
            });
        }
        let t_s = self.number(line, self.time)?;
        if let Some(previous_s) = self.previous_s.filter(|&previous| t_s <= previous) {
            return Err(TableError::Time {
                path: self.path.clone(),
                line,
                t_s,
                previous_s,
            });
        }
        self.previous_s = Some(t_s);
        let optional = |columns: &Option<[usize; N]>| match columns {
            Some(columns) => self.numbers(line, columns),
            None => Ok([0.0; N]),
        };
        let mut row = LogRow {
            line,
            t_s,
            q: self.numbers(line, &self.q)?,
            qd: optional(&self.qd)?,
            qdd: optional(&self.qdd)?,
            tau: self.numbers(line, &self.tau)?,
        };
        for (tau, gain) in row.tau.iter_mut().zip(&self.gain) {
            *tau *= gain;
        }
        Ok(Some(row))
    }

    fn numbers(&self, line: u64, columns: &[usize; N]) -> Result<[f64; N], TableError> {
        let mut values = [0.0; N];
        for (value, column) in values.iter_mut().zip(columns) {
            *value = self.number(line, *column)?;
        }
        Ok(values)
    }

    fn number(&self, line: u64, column: usize) -> Result<f64, TableError> {
        let field = self.record.get(column).unwrap_or_default();
        let text = std::str::from_utf8(field).ok();
        text.and_then(|text| text.trim().parse::<f64>().ok())
            .filter(|value| value.is_finite())
            .ok_or_else(|| TableError::NotANumber {
                path: self.path.clone(),
                line,
                column: self.header[column].clone(),
                text: String::from_utf8_lossy(field).into_owned(),
            })
    }
}

/// The header row of a log.
struct Header<'a> {
    path: &'a Path,
    names: &'a [String],
}

impl<'a> Header<'a> {
    fn of(path: &'a Path, names: &'a [String]) -> Result<Self, TableError> {
        let mut known = HashSet::new();
        match names.iter().find(|name| !known.insert(*name)) {
            None => Ok(Self { path, names }),
            Some(twice) => Err(TableError::RepeatedColumn {
                path: path.to_owned(),
                column: twice.clone(),
            }),
        }
    }

    fn place(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|own| own == name)
    }

    fn missing(&self, column: &str) -> TableError {
        TableError::MissingColumn {
            path: self.path.to_owned(),
            column: column.to_owned(),
        }
    }

    /// Columns of one quantity for all joints, by the project's name (symbol, unit) or the pattern of the map; `None` without
    /// such a column.
    fn joints<const N: usize>(
        &self,
        (symbol, unit): (&str, &str),
        pattern: Option<&str>,
    ) -> Result<Option<[usize; N]>, TableError> {
        let own = |joint: usize| format!("{symbol}{joint}_{unit}");
        let mapped = |joint: usize| Some(pattern?.replace("{}", &joint.to_string()));
        let is_own = (1..=N + 1).any(|joint| self.place(&own(joint)).is_some());
        let name = |joint: usize| {
            mapped(joint)
                .filter(|_| !is_own)
                .unwrap_or_else(|| own(joint))
        };
        if !(1..=N + 1).any(|joint| self.place(&name(joint)).is_some()) {
            return Ok(None);
        }
        // One joint more: the log of another robot.
        let extra = name(N + 1);
        if self.place(&extra).is_some() {
            return Err(TableError::ExtraColumn {
                path: self.path.to_owned(),
                column: extra,
                joints: N,
            });
        }
        let mut columns = [0; N];
        for (index, column) in columns.iter_mut().enumerate() {
            let name = name(index + 1);
            *column = self.place(&name).ok_or_else(|| self.missing(&name))?;
        }
        Ok(Some(columns))
    }
}
