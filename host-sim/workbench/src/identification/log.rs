//! Logs: the project's own columns, or foreign ones through the map of the robot description.

use crate::files::at;
use crate::robot::{LogColumns, Robot};
use crate::table::{TableError, is_compressed, unreadable};
use flate2::read::MultiGzDecoder;
use std::collections::HashMap;
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
pub struct LogReader<const N: usize> {
    path: PathBuf,
    reader: csv::Reader<Box<dyn Read + Send>>,
    record: csv::ByteRecord,
    header: Vec<String>,
    time: usize,
    q: [usize; N],
    qd: Option<[usize; N]>,
    qdd: Option<[usize; N]>,
    tau: [usize; N],
    /// Torque a unit of the torque column stands for: the drive gain where it is a current, N·m/A, else 1.
    gain: [f64; N],
    from_current: bool,
    mapped: bool,
    previous_s: Option<f64>,
}

/// Names of one quantity: this project's own, and the description's.
struct Names<'a> {
    own: (&'a str, &'a str),
    foreign: Option<&'a str>,
}

impl<const N: usize> LogReader<N> {
    /// Opens a log. Own column names win over those of the map; time, position and torque (or current) must be there.
    ///
    /// Errors: [`TableError`] of the header.
    pub fn open(path: &Path, robot: &Robot) -> Result<Self, TableError> {
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
        let header: Vec<String> = reader
            .headers()
            .map_err(|error| unreadable(path, &error))?
            .iter()
            .map(str::to_owned)
            .collect();
        let mut places = HashMap::new();
        for (index, name) in header.iter().enumerate() {
            if places.insert(name.as_str(), index).is_some() {
                return Err(TableError::RepeatedColumn {
                    path: path.to_owned(),
                    column: name.clone(),
                });
            }
        }
        let none = LogColumns::default();
        let map = robot.log_columns.as_ref().unwrap_or(&none);
        let names = |own, foreign: &'static str| Names {
            own,
            foreign: match foreign {
                "q" => map.q_rad.as_deref(),
                "qd" => map.qd_rad_s.as_deref(),
                "qdd" => map.qdd_rad_s2.as_deref(),
                "tau" => map.tau_nm.as_deref(),
                _ => map.i_a.as_deref(),
            },
        };
        let header_of = Header { path, places };
        let mapped_time = map
            .t_s
            .as_deref()
            .and_then(|name| header_of.places.get(name));
        let time = header_of.places.get("t_s").or(mapped_time).copied();
        let time = time.ok_or_else(|| header_of.missing("t_s".to_owned()))?;
        let q_names = names(("q", "rad"), "q");
        let q = header_of.joints(&q_names)?;
        let q = q.ok_or_else(|| header_of.missing("q1_rad".to_owned()))?;
        let qd = header_of.joints(&names(("qd", "rad_s"), "qd"))?;
        let qdd = header_of.joints(&names(("qdd", "rad_s2"), "qdd"))?;
        let mut gain = [1.0; N];
        let (tau, from_current) = match header_of.joints(&names(("tau", "nm"), "tau"))? {
            Some(tau) => (tau, false),
            None => {
                for (gain, joint) in gain.iter_mut().zip(&robot.joints) {
                    *gain = joint.drive.gain;
                }
                let current = header_of.joints(&names(("i", "a"), "i"))?;
                (
                    current.ok_or_else(|| header_of.missing("tau1_nm".to_owned()))?,
                    true,
                )
            }
        };
        let mapped = !header_of.places.contains_key("q1_rad");
        Ok(Self {
            path: path.to_owned(),
            reader,
            record: csv::ByteRecord::new(),
            time,
            q,
            qd,
            qdd,
            tau,
            gain,
            from_current,
            mapped,
            previous_s: None,
            header,
        })
    }

    /// The log has velocities.
    pub fn has_velocity(&self) -> bool {
        self.qd.is_some()
    }

    /// The log has accelerations.
    pub fn has_acceleration(&self) -> bool {
        self.qdd.is_some()
    }

    /// Torque is drive gain × motor current.
    pub fn from_current(&self) -> bool {
        self.from_current
    }

    /// The columns were found through the map of the description.
    pub fn is_mapped(&self) -> bool {
        self.mapped
    }

    /// The next row, `None` at the end.
    ///
    /// Errors: [`TableError`] of that row, naming line and column.
    pub fn next_row(&mut self) -> Result<Option<LogRow<N>>, TableError> {
        let more = self
            .reader
            .read_byte_record(&mut self.record)
            .map_err(|error| unreadable(&self.path, &error))?;
        if !more {
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
        let zero = [0.0; N];
        let mut row = LogRow {
            line,
            t_s,
            q: self.numbers(line, &self.q)?,
            qd: match &self.qd {
                Some(columns) => self.numbers(line, columns)?,
                None => zero,
            },
            qdd: match &self.qdd {
                Some(columns) => self.numbers(line, columns)?,
                None => zero,
            },
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
        std::str::from_utf8(field)
            .ok()
            .and_then(|text| text.trim().parse::<f64>().ok())
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
    places: HashMap<&'a str, usize>,
}

impl Header<'_> {
    fn missing(&self, column: String) -> TableError {
        TableError::MissingColumn {
            path: self.path.to_owned(),
            column,
        }
    }

    /// Columns of one quantity for all joints; `None` when not even the first joint's is there.
    fn joints<const N: usize>(&self, names: &Names<'_>) -> Result<Option<[usize; N]>, TableError> {
        let own = |joint: usize| format!("{}{joint}_{}", names.own.0, names.own.1);
        let foreign = |joint: usize| {
            let pattern = names.foreign?;
            Some(pattern.replace("{}", &joint.to_string()))
        };
        let there = |name: &String| self.places.contains_key(name.as_str());
        let is_own = (1..=N + 1).any(|joint| there(&own(joint)));
        let is_foreign = (1..=N + 1).any(|joint| foreign(joint).is_some_and(|name| there(&name)));
        if !is_own && !is_foreign {
            return Ok(None);
        }
        let name = |joint: usize| match foreign(joint) {
            Some(name) if !is_own => name,
            _ => own(joint),
        };
        // A seventh joint in the log of an arm with six is a log of another robot.
        let extra = name(N + 1);
        if there(&extra) {
            return Err(TableError::ExtraColumn {
                path: self.path.to_owned(),
                column: extra,
                joints: N,
            });
        }
        let mut columns = [0; N];
        for (index, column) in columns.iter_mut().enumerate() {
            let name = name(index + 1);
            *column = *self
                .places
                .get(name.as_str())
                .ok_or_else(|| self.missing(name))?;
        }
        Ok(Some(columns))
    }
}
