//! Joint states of ROS 2 bags: `.db3` (SQLite) and `.mcap`, one row a message, by the stamps of their headers, else by
//! their receipt.
//!
//! Columns: `t_s` since the first message, then `NAME/position`, `NAME/velocity` and `NAME/effort` of every joint. An MCAP
//! that this program wrote gives the columns of its topic `/measured`.

use super::{TableError, bag_files, extension};
use crate::files::at;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use mcap::{McapError, Message};
use rusqlite::{Connection, OpenFlags};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

const JOINT_STATE: &str = "sensor_msgs/msg/JointState";
/// Schema of the measurements that this program writes.
const MEASURED: &str = "foretorque.measured";
/// Messages looked at to find the joints, and as long as none is of the arm: a gripper may publish on the same topic.
const LOOK_AHEAD: usize = 64;
const LONGEST_LOOK_AHEAD: usize = 1 << 16;
/// Bytes of a record that a file shorter than it may hold compressed; a longer one is a damaged length.
const LONG_RECORD: usize = 1 << 26;
/// Messages read ahead.
const QUEUE: usize = 1024;

struct JointState {
    /// Stamp of the header, ns, or time of the receipt where it has none.
    stamp_ns: i64,
    is_stamped: bool,
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
            if is_of(&self.names, &state) {
                return Some(self.row(&state));
            }
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
            let quantities = state.values.iter().zip(["position", "velocity", "effort"]);
            for ((values, quantity), _) in quantities.zip(self.kinds).filter(|own| own.1) {
                let value = values.get(place).ok_or_else(|| {
                    broken(format!(
                        "joint {name} has no {quantity} there: record messages of one publisher alone, or without {quantity}"
                    ))
                })?;
                row.push(*value);
            }
        }
        Ok(row)
    }
}

/// The message has the joints of `names`; others on the same topic are those of a gripper or a hand.
fn is_of(names: &[String], state: &JointState) -> bool {
    let is_there = |name: &String| state.names.contains(name);
    state.names.len() >= names.len() && (names.is_empty() || names.iter().any(is_there))
}

/// Choice of one topic with joint states among several.
pub(crate) struct Topics<'a> {
    pub(crate) named: Option<&'a str>,
    /// Likeness of the joints of a message to those of the arm; 0 is none.
    pub(crate) likeness: &'a dyn Fn(&[String]) -> usize,
}

impl Topics<'_> {
    /// The only topic there is.
    pub(super) const ANY: Self = Self {
        named: None,
        likeness: &|_| 0,
    };
}

/// Opens a bag, a file or its directory; `None` for a file of another kind. Returns header, rows and notes.
///
/// Errors: a file that is no bag, has no joint states or several topics of them, or ends in the middle of a record.
pub(super) fn open(path: &Path, topics: &Topics<'_>) -> Result<Option<Bag>, TableError> {
    let Some(files) = bag_files(path)? else {
        return Ok(None);
    };
    let mut notes = Vec::new();
    let (topic, Begun { seen, most, rest }) = chosen(path, &files, topics, &mut notes)?;
    let JointState { names, values, .. } = &seen[most];
    let (names, plain) = (names.clone(), seen[most].plain);
    let kinds = [0, 1, 2].map(|kind| values[kind].len() == names.len() && !names.is_empty());
    let mut lacking = [("position", 0), ("effort", 2)].into_iter();
    if let Some((field, kind)) = lacking.find(|(_, kind)| !plain && !kinds[*kind]) {
        let problem = match (values[kind].len(), names.len()) {
            (0, _) => format!("the field {field} is empty in {topic}"),
            (found, joints) => {
                format!("the field {field} has {found} values for {joints} joints in {topic}")
            }
        };
        return Err(refused(path, problem));
    }
    let own = || seen.iter().filter(|state| is_of(&names, state));
    let start_ns = own().next().map_or(0, |state| state.stamp_ns);
    let mut header = vec!["t_s".to_owned()];
    for name in &names {
        if plain {
            header.push(name.clone());
            continue;
        }
        let quantities = ["position", "velocity", "effort"].into_iter().zip(kinds);
        let quantities = quantities.filter(|(_, kind)| *kind);
        header.extend(quantities.map(|(quantity, _)| format!("{name}/{quantity}")));
    }
    if !plain {
        let name = path.display();
        let time = match own().any(|state| state.is_stamped) {
            true => "time by the stamps of their headers",
            false => "time by their receipt, for their headers have no stamps",
        };
        notes.push(format!("{name}: joint states of {topic} by name, {time}"));
    }
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

fn refused(path: &Path, problem: impl Into<String>) -> TableError {
    TableError::at(path, None, problem)
}

/// Messages of a topic that is being read.
struct Begun {
    seen: Vec<JointState>,
    /// Place in `seen` of the one with the joints of the arm, else of the one with most joints.
    most: usize,
    rest: Receiver<Item>,
}

/// Begins to read a topic; `None` where it has no message.
fn begin(
    files: &[PathBuf],
    topic: &str,
    likeness: &dyn Fn(&[String]) -> usize,
) -> Result<Option<Begun>, TableError> {
    let (sender, rest) = sync_channel(QUEUE);
    let (files, topic) = (files.to_owned(), topic.to_owned());
    std::thread::spawn(move || {
        let mut to = Sink {
            sender,
            count: 0,
            origin_ns: 0,
        };
        let mut read = files.iter().map(|file| match extension(file) {
            Some("db3") => read_sqlite(file, &topic, &mut to),
            _ => read_mcap(file, &mut Vec::new(), |message| {
                let own = message.channel.topic == topic;
                Ok(!own || to.send(file, &message.data, message.log_time as i64)?)
            }),
        });
        if let Some(Err(error)) = read.find(|more| !matches!(more, Ok(true))) {
            drop(read);
            // Nobody may read any more.
            let _ = to.sender.send(Err(error));
        }
    });
    let (mut seen, mut alike): (Vec<JointState>, _) = (Vec::new(), false);
    while seen.len() < LOOK_AHEAD || !alike && seen.len() < LONGEST_LOOK_AHEAD {
        let Ok(state) = rest.recv() else { break };
        let state = state?;
        alike |= likeness(&state.names) > 0;
        seen.push(state);
    }
    let rank = |names: &[String]| (likeness(names), names.len());
    let most = (0..seen.len()).max_by_key(|&place| rank(&seen[place].names));
    Ok(most.map(|most| Begun { seen, most, rest }))
}

/// The topic with joint states: the one that was named, the only one, or the one with the joints of the arm.
fn chosen(
    path: &Path,
    files: &[PathBuf],
    topics: &Topics<'_>,
    notes: &mut Vec<String>,
) -> Result<(String, Begun), TableError> {
    let mut there: Vec<(String, String)> = Vec::new();
    for file in files {
        there.extend(match extension(file) {
            Some("db3") => sqlite_topics(file)?,
            _ => mcap_topics(file, notes)?,
        });
    }
    there.sort();
    there.dedup();
    let of_joints = |kind: &str| kind == JOINT_STATE || kind == MEASURED;
    let is_named = |name: &str| topics.named.is_none_or(|named| named == name);
    let own = there
        .iter()
        .filter(|own| of_joints(&own.1) && is_named(&own.0));
    let own: Vec<&str> = own.map(|own| own.0.as_str()).collect();
    if own.is_empty() {
        let found = there.iter().map(|(name, kind)| format!("{name} ({kind})"));
        let found = found.collect::<Vec<_>>().join(", ");
        let named = topics.named.unwrap_or("topic");
        let problem = match found.is_empty() {
            true => "it holds no topic: was the recorder ended?".to_owned(),
            false => format!("no {named} of {JOINT_STATE}, only {found}"),
        };
        return Err(refused(path, problem));
    }
    let (mut alike, mut joints) = (Vec::new(), Vec::new());
    for &topic in &own {
        if let Some(begun) = begin(files, topic, topics.likeness)? {
            let names = &begun.seen[begun.most].names;
            joints.push(format!("{topic} ({})", names.join(", ")));
            alike.push(((topics.likeness)(names), topic, begun));
        }
    }
    let most = alike.iter().map(|own| own.0).max();
    alike.retain(|own| Some(own.0) == most);
    let problem = match alike[..] {
        _ if own.len() == 1 => None,
        [(1.., ..)] => None,
        [(1.., first, _), ..] => {
            let all: Vec<&str> = alike.iter().map(|own| own.1).collect();
            let all = all.join(", ");
            Some(format!(
                "{all} all have the joints of the arm: write `topic = \"{first}\"`, or another of them, into a file for --columns-from"
            ))
        }
        _ => {
            let joints = joints.join(", ");
            Some(format!(
                "joint states in {joints}, and no topic has all joints of the arm: record one that has"
            ))
        }
    };
    if let Some(problem) = problem {
        return Err(refused(path, problem));
    }
    let chosen = alike
        .pop()
        .map(|(_, topic, begun)| (topic.to_owned(), begun));
    chosen.ok_or_else(|| TableError::empty(path))
}

/// Messages on their way to the table.
struct Sink {
    sender: SyncSender<Item>,
    count: u64,
    /// Receipt of a first message that has no stamp, ns: in a bag without stamps it is zero of the time.
    origin_ns: i64,
}

impl Sink {
    /// Sends a message, with the time of its receipt where its header has no stamp; false if nobody reads any more.
    fn send(&mut self, path: &Path, data: &[u8], received_ns: i64) -> Result<bool, TableError> {
        self.count += 1;
        let wrong = || TableError::at(path, self.count, format!("no {JOINT_STATE} in plain CDR"));
        let mut state = decode(data).or_else(|| columns(data)).ok_or_else(wrong)?;
        if state.stamp_ns == 0 && (self.count > 1 || state.plain) {
            state.stamp_ns = received_ns - self.origin_ns;
        } else if state.stamp_ns == 0 {
            self.origin_ns = received_ns;
        }
        Ok(self.sender.send(Ok(state)).is_ok())
    }
}

fn no_bag(path: &Path) -> impl Fn(rusqlite::Error) -> TableError {
    move |error| refused(path, format!("no ROS 2 bag: {error}"))
}

fn sqlite(path: &Path) -> Result<Connection, TableError> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY;
    Connection::open_with_flags(path, flags).map_err(no_bag(path))
}

/// Names and types of the topics.
fn sqlite_topics(path: &Path) -> Result<Vec<(String, String)>, TableError> {
    let bag = sqlite(path)?;
    let read = || {
        bag.prepare("SELECT name, type FROM topics")?
            .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?
            .collect::<rusqlite::Result<_>>()
    };
    read().map_err(no_bag(path))
}

/// Sends the messages of a topic; false if nobody reads any more.
fn read_sqlite(path: &Path, topic: &str, to: &mut Sink) -> Result<bool, TableError> {
    let wrong = no_bag(path);
    let bag = sqlite(path)?;
    let mut statement = bag
        .prepare(
            "SELECT messages.timestamp, messages.data FROM messages JOIN topics ON topics.id = messages.topic_id \
             WHERE topics.name = ?1 ORDER BY messages.timestamp, messages.id",
        )
        .map_err(&wrong)?;
    let mut rows = statement.query([topic]).map_err(&wrong)?;
    while let Some(row) = rows.next().map_err(&wrong)? {
        let received_ns: i64 = row.get(0).map_err(&wrong)?;
        let data = row.get_ref(1).map_err(&wrong)?.as_blob();
        let data = data.map_err(|error| refused(path, error.to_string()))?;
        if !to.send(path, data, received_ns)? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Gives the messages of a file to `take` until that is false, or to the last whole chunk of a file that was cut, which is
/// noted; false as `take`.
///
/// Errors: those of `take`, a damaged file.
fn read_mcap(
    path: &Path,
    notes: &mut Vec<String>,
    mut take: impl FnMut(&Message<'_>) -> Result<bool, TableError>,
) -> Result<bool, TableError> {
    let file = File::open(path).map_err(|error| at(path, error))?;
    let length = file.metadata().map_err(|error| at(path, error))?.len();
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_validate_chunk_crcs(true)
        .with_record_length_limit((length as usize).max(LONG_RECORD));
    let messages = MessageReader::new_with_options(BufReader::new(file), options);
    for (place, message) in messages.enumerate() {
        match message {
            Ok(message) if !take(&message)? => return Ok(false),
            Ok(_) => {}
            Err(error @ McapError::UnexpectedEof) if place > 0 => {
                let (name, read) = (path.display(), "what is before its end was read");
                notes.push(format!("{name}: {error}: {read}"));
                break;
            }
            Err(error) if place == 0 => return Err(refused(path, format!("no MCAP: {error}"))),
            Err(error) => {
                let way = "record it anew, or mend it by `mcap recover`";
                return Err(refused(path, format!("damaged: {error}: {way}")));
            }
        }
    }
    Ok(true)
}

/// Names and types of the topics.
fn mcap_topics(path: &Path, notes: &mut Vec<String>) -> Result<Vec<(String, String)>, TableError> {
    let mut topics: Vec<(String, String)> = Vec::new();
    read_mcap(path, notes, |Message { channel, .. }| {
        if !topics.iter().any(|(name, _)| *name == channel.topic) {
            let kind = channel.schema.as_ref().map_or("?", |schema| &schema.name);
            topics.push((channel.topic.clone(), kind.to_owned()));
        }
        Ok(true)
    })?;
    Ok(topics)
}

/// Columns of a JSON object of numbers, NaN for null.
fn columns(data: &[u8]) -> Option<JointState> {
    let fields: std::collections::BTreeMap<String, Option<f64>> =
        serde_json::from_slice(data).ok()?;
    let fields = fields.into_iter();
    let (names, values) = fields
        .map(|(name, value)| (name, value.unwrap_or(f64::NAN)))
        .unzip();
    Some(JointState {
        stamp_ns: 0,
        is_stamped: false,
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
        is_stamped: (seconds, nanoseconds) != (0, 0),
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
