//! Joint states of ROS 2 bags: `.db3` (SQLite) and `.mcap`, one row a message, by the stamps of their headers.
//!
//! Columns: `t_s` since the first message, then `NAME/position`, `NAME/velocity` and `NAME/effort` of every joint. An MCAP
//! that this program wrote gives the columns of its topic `/measured`.

use super::TableError;
use crate::files::at;
use mcap::read::Options;
use rusqlite::{Connection, OpenFlags};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Type of the messages that are read.
const JOINT_STATE: &str = "sensor_msgs/msg/JointState";
/// Schema of the measurements that this program writes.
const MEASURED: &str = "foretorque.measured";
/// Messages looked at to find the joints: a gripper may publish on the same topic.
const LOOK_AHEAD: usize = 64;
/// Messages read ahead.
const QUEUE: usize = 1024;

struct JointState {
    /// Stamp of the header, ns.
    stamp_ns: i64,
    /// Names are those of columns, each with one value.
    plain: bool,
    names: Vec<String>,
    /// Positions, velocities, efforts; empty where the message has none.
    values: [Vec<f64>; 3],
}

type Item = Result<JointState, TableError>;

/// Header, rows and notes of a bag.
pub(super) type Bag = (Vec<String>, Messages, Vec<String>);

pub(super) struct Messages {
    seen: std::vec::IntoIter<JointState>,
    rest: Receiver<Item>,
    names: Vec<String>,
    /// Which of positions, velocities and efforts there are.
    kinds: [bool; 3],
    start_ns: i64,
    path: PathBuf,
    count: u64,
}

impl Iterator for Messages {
    type Item = Result<Vec<f64>, TableError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let state = match self.seen.next() {
                Some(state) => state,
                None => match self.rest.recv().ok()? {
                    Ok(state) => state,
                    Err(error) => return Some(Err(error)),
                },
            };
            self.count += 1;
            // Other joints on the same topic: the messages of a gripper.
            if state.names.len() < self.names.len() {
                continue;
            }
            return Some(self.row(&state));
        }
    }
}

impl Messages {
    fn row(&self, state: &JointState) -> Result<Vec<f64>, TableError> {
        let broken = |problem: String| TableError::at(&self.path, self.count, problem);
        let mut row = vec![1e-9 * (state.stamp_ns - self.start_ns) as f64];
        for name in &self.names {
            let place = state.names.iter().position(|own| own == name);
            let place = place.ok_or_else(|| broken(format!("no joint {name}")))?;
            for (values, _) in state.values.iter().zip(self.kinds).filter(|own| own.1) {
                let value = values.get(place);
                let value = value.ok_or_else(|| broken(format!("joint {name} lacks a value")))?;
                row.push(*value);
            }
        }
        Ok(row)
    }
}

/// Opens a bag, a file or its directory; `None` for a file of another kind. Returns header, rows and notes.
///
/// Errors: a file that is no bag, has no joint states, or ends in the middle of a record.
pub(super) fn open(path: &Path) -> Result<Option<Bag>, TableError> {
    let inside = |directory: &Path| {
        let files = fs::read_dir(directory).ok()?.flatten();
        let mut bags: Vec<PathBuf> = files.map(|file| file.path()).collect();
        bags.retain(|path| matches!(extension(path), Some("db3" | "mcap")));
        bags.sort();
        bags.into_iter().next()
    };
    let file = if path.is_dir() {
        inside(path).ok_or_else(|| refused(path, "a directory without .db3 or .mcap"))?
    } else {
        path.to_owned()
    };
    let work = match extension(&file) {
        Some("db3") => read_sqlite,
        Some("mcap") => read_mcap,
        Some("parquet") => {
            let way = "parquet is not read; write CSV: python3 -c \"import pandas as p; p.read_parquet('F').to_csv('F.csv')\"";
            return Err(refused(path, way));
        }
        Some("bag") => {
            let way = "a bag of ROS 1 is not read; convert it: rosbags-convert --src F.bag --dst F";
            return Err(refused(path, way));
        }
        _ => return Ok(None),
    };
    drop(fs::File::open(&file).map_err(|error| at(&file, error))?);
    let (sender, rest) = sync_channel(QUEUE);
    std::thread::spawn(move || {
        if let Err(error) = work(&file, &sender) {
            // Nobody reads any more.
            let _ = sender.send(Err(error));
        }
    });
    let mut seen = Vec::new();
    while seen.len() < LOOK_AHEAD
        && let Ok(state) = rest.recv()
    {
        seen.push(state?);
    }
    let Some(most) = seen.iter().max_by_key(|state| state.names.len()) else {
        return Err(TableError::empty(path));
    };
    let names = most.names.clone();
    let kinds = [0, 1, 2].map(|kind| most.values[kind].len() == names.len() && !names.is_empty());
    let own = seen.iter().filter(|state| state.names.len() == names.len());
    let start_ns = own.map(|state| state.stamp_ns).next().unwrap_or(0);
    let mut header = vec!["t_s".to_owned()];
    for name in &names {
        if most.plain {
            header.push(name.clone());
            continue;
        }
        let quantities = ["position", "velocity", "effort"].into_iter().zip(kinds);
        let quantities = quantities.filter(|(_, kind)| *kind);
        header.extend(quantities.map(|(quantity, _)| format!("{name}/{quantity}")));
    }
    let name = path.display();
    let note = format!("{name}: joint states by name, time by the stamps of their headers");
    let notes = if most.plain { Vec::new() } else { vec![note] };
    let messages = Messages {
        seen: seen.into_iter(),
        rest,
        names,
        kinds,
        start_ns,
        path: path.to_owned(),
        count: 0,
    };
    Ok(Some((header, messages, notes)))
}

fn extension(path: &Path) -> Option<&str> {
    path.extension().and_then(|extension| extension.to_str())
}

fn refused(path: &Path, problem: impl Into<String>) -> TableError {
    TableError::at(path, None, problem)
}

/// The topic with joint states: `/joint_states` before others.
///
/// * `topics` name and type
fn chosen(path: &Path, topics: &[(String, String)]) -> Result<String, TableError> {
    let names = topics.iter().filter(|(_, kind)| kind == JOINT_STATE);
    let mut names: Vec<&String> = names.map(|(name, _)| name).collect();
    let own = topics.iter().filter(|(_, kind)| kind == MEASURED);
    names.extend(own.map(|(name, _)| name));
    names.sort_by_key(|name| (*name != "/joint_states", *name));
    names.first().map(|name| (*name).clone()).ok_or_else(|| {
        let found = topics.iter().map(|(name, kind)| format!("{name} ({kind})"));
        let found = found.collect::<Vec<_>>().join(", ");
        refused(path, format!("no topic of {JOINT_STATE}, only {found}"))
    })
}

/// Sends a message, with the time of its receipt where its header has no stamp; false if nobody reads any more.
fn send(
    path: &Path,
    to: &SyncSender<Item>,
    data: &[u8],
    received_ns: i64,
    count: u64,
) -> Result<bool, TableError> {
    let mut state = decode(data)
        .or_else(|| columns(data))
        .ok_or_else(|| TableError::at(path, count, format!("no {JOINT_STATE} in plain CDR")))?;
    if state.stamp_ns == 0 && (count > 1 || state.plain) {
        state.stamp_ns = received_ns;
    }
    Ok(to.send(Ok(state)).is_ok())
}

fn read_sqlite(path: &Path, to: &SyncSender<Item>) -> Result<(), TableError> {
    let read = || -> rusqlite::Result<_> {
        let bag = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
        let topics = bag
            .prepare("SELECT name, type FROM topics")?
            .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?
            .collect::<rusqlite::Result<Vec<(String, String)>>>()?;
        Ok((bag, topics))
    };
    let wrong = |error: rusqlite::Error| refused(path, format!("no ROS 2 bag: {error}"));
    let (bag, topics) = read().map_err(wrong)?;
    let topic = chosen(path, &topics)?;
    let mut statement = bag
        .prepare(
            "SELECT messages.timestamp, messages.data FROM messages JOIN topics ON topics.id = messages.topic_id \
             WHERE topics.name = ?1 ORDER BY messages.timestamp, messages.id",
        )
        .map_err(wrong)?;
    let mut rows = statement.query([topic]).map_err(wrong)?;
    let mut count = 0;
    while let Some(row) = rows.next().map_err(wrong)? {
        count += 1;
        let received_ns: i64 = row.get(0).map_err(wrong)?;
        let data = row.get_ref(1).map_err(wrong)?.as_blob();
        let data = data.map_err(|error| refused(path, error.to_string()))?;
        if !send(path, to, data, received_ns, count)? {
            break;
        }
    }
    Ok(())
}

/// Reads to the last whole chunk of a file that was cut.
fn read_mcap(path: &Path, to: &SyncSender<Item>) -> Result<(), TableError> {
    let bytes = fs::read(path).map_err(|error| at(path, error))?;
    let open = || {
        mcap::MessageStream::new_with_options(&bytes, Options::IgnoreEndMagic.into())
            .map_err(|error| refused(path, format!("no MCAP: {error}")))
    };
    let mut topics: Vec<(String, String)> = Vec::new();
    let mut joint_states = 0;
    for message in open()? {
        let message = match message {
            Ok(message) => message,
            Err(error) if topics.is_empty() => {
                return Err(refused(path, format!("no MCAP: {error}")));
            }
            // The file was cut.
            Err(_) => break,
        };
        let channel = &message.channel;
        if !topics.iter().any(|(name, _)| *name == channel.topic) {
            let kind = channel.schema.as_ref().map_or("?", |schema| &schema.name);
            topics.push((channel.topic.clone(), kind.to_owned()));
            joint_states += usize::from(kind == JOINT_STATE || kind == MEASURED);
        }
        if joint_states > 0 && topics.len() >= 64 {
            break;
        }
    }
    let topic = chosen(path, &topics)?;
    let own = open()?
        .map_while(Result::ok)
        .filter(|message| message.channel.topic == topic);
    for (count, message) in (1..).zip(own) {
        if !send(path, to, &message.data, message.log_time as i64, count)? {
            break;
        }
    }
    Ok(())
}

/// Columns of a JSON object of numbers.
fn columns(data: &[u8]) -> Option<JointState> {
    let fields: std::collections::BTreeMap<String, f64> = serde_json::from_slice(data).ok()?;
    let (names, values) = fields.into_iter().unzip();
    Some(JointState {
        stamp_ns: 0,
        plain: true,
        names,
        values: [values, Vec::new(), Vec::new()],
    })
}

/// `sensor_msgs/JointState` in plain CDR, little or big endian          [OMG formal/02-06-51, chapter 15.3]
fn decode(data: &[u8]) -> Option<JointState> {
    let little = match data.get(..2)? {
        [0, 0] => false,
        [0, 1] => true,
        _ => return None,
    };
    let mut cdr = Cdr {
        data: data.get(4..)?,
        at: 0,
        little,
    };
    let (seconds, nanoseconds) = (cdr.word()?, cdr.word()?);
    cdr.text()?;
    let count = cdr.word()?;
    let names = (0..count).map(|_| cdr.text()).collect::<Option<_>>()?;
    let values = [cdr.doubles()?, cdr.doubles()?, cdr.doubles()?];
    Some(JointState {
        plain: false,
        stamp_ns: i64::from(seconds.cast_signed()) * 1_000_000_000 + i64::from(nanoseconds),
        names,
        values,
    })
}

/// Place in a CDR stream.
struct Cdr<'a> {
    data: &'a [u8],
    at: usize,
    little: bool,
}

impl Cdr<'_> {
    /// The next `SIZE` bytes, aligned to their number, the lowest first.
    fn take<const SIZE: usize>(&mut self) -> Option<[u8; SIZE]> {
        let begin = self.at.next_multiple_of(SIZE);
        let mut bytes: [u8; SIZE] = self.data.get(begin..begin + SIZE)?.try_into().ok()?;
        self.at = begin + SIZE;
        if !self.little {
            bytes.reverse();
        }
        Some(bytes)
    }

    fn word(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn text(&mut self) -> Option<String> {
        let length = self.word()? as usize;
        let bytes = self.data.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Some(String::from_utf8_lossy(text).into_owned())
    }

    fn doubles(&mut self) -> Option<Vec<f64>> {
        let count = self.word()?;
        // A length that the data cannot hold ends the loop early.
        (0..count)
            .map(|_| self.take().map(f64::from_le_bytes))
            .collect()
    }
}
