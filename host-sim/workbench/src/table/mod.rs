//! Tables of joint states as CSV: a header row with units in the names, one row an instant.
//!
//! `t_s`, then `q1_rad…`, `qd1_rad_s…`, `qdd1_rad_s2…`, `tau1_nm…`; further columns are ignored on reading. A name that
//! ends in `.gz` is compressed. Every error names file, line and column.

mod bag;
mod rows;
mod writer;

pub(crate) use bag::Topics;
pub(crate) use rows::{Remedies, Rows};
pub use writer::TableWriter;

use crate::dynamics::{Joints, State};
use crate::files::at;
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Reads a table of the states of `N` joints row by row, in constant memory: time, s, where the table has it, and motion.
pub struct StateReader<const N: usize> {
    rows: Rows,
    time: Option<usize>,
    /// Places of q1…qn, qd1…qdn, qdd1…qddn.
    places: Vec<usize>,
}

impl<const N: usize> StateReader<N> {
    /// Opens a table that holds position, velocity and acceleration of all joints; `t_s` is checked where present.
    ///
    /// Errors: [`TableError`] of the header.
    pub fn open(path: &Path) -> Result<Self, TableError> {
        let rows = Rows::open(path)?;
        if rows.find("q0_rad")?.is_some() {
            let problem = "column q0_rad: joints count from 1 here, rename the columns";
            return Err(rows.header_error(problem.to_owned()));
        }
        let columns = state_columns(N);
        let places = columns.iter().map(|column| rows.require(column));
        let places = places.collect::<Result<_, _>>()?;
        // The table of a larger arm also has the columns of this one.
        for (name, unit) in STATE {
            rows.refuse(&format!("{name}{}_{unit}", N + 1), N)?;
        }
        let time = rows.find("t_s")?;
        Ok(Self { rows, time, places })
    }

    /// The table has the times of its rows.
    pub fn has_time(&self) -> bool {
        self.time.is_some()
    }

    fn row(&mut self) -> Result<Option<(Option<f64>, State<N>)>, TableError> {
        if !self.rows.advance()? {
            return Ok(None);
        }
        let t_s = self.time.map(|column| self.rows.time(column)).transpose()?;
        let mut motion = State::<N>::rest(Joints::zeros());
        let values = motion.q.iter_mut().chain(&mut motion.qd);
        for (value, column) in values.chain(&mut motion.qdd).zip(&self.places) {
            *value = self.rows.number(*column)?;
        }
        Ok(Some((t_s, motion)))
    }
}

impl<const N: usize> Iterator for StateReader<N> {
    type Item = Result<(Option<f64>, State<N>), TableError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.row().transpose()
    }
}

/// Times, s, and motions of a table that has the times of its rows.
///
/// Errors: [`TableError`] of the header, of the first bad row, or of a table without rows.
pub fn read_states<const N: usize>(path: &Path) -> Result<Vec<(f64, State<N>)>, TableError> {
    let reader = StateReader::open(path)?;
    reader.rows.require("t_s")?;
    let timed = reader.map(|row| row.map(|(t_s, motion)| (t_s.unwrap_or_default(), motion)));
    match timed.collect::<Result<Vec<_>, _>>()? {
        rows if rows.is_empty() => Err(TableError::empty(path)),
        rows => Ok(rows),
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

/// Kinds of logs that are not read, with the command that converts file F.
const CONVERSIONS: [(&str, &str); 6] = [
    (
        "parquet",
        "python3 -c \"import pandas as p; p.read_parquet('F').to_csv('F.csv', index=False)\"",
    ),
    ("bag", "rosbags-convert --src F.bag --dst F"),
    (
        "xlsx",
        "python3 -c \"import pandas as p; p.read_excel('F').to_csv('F.csv', index=False)\"",
    ),
    (
        "npy",
        "python3 -c \"import pandas as p, numpy as n; p.DataFrame(n.load('F')).to_csv('F.csv', index=False, header=False)\", and name the columns by --names",
    ),
    (
        "npz",
        "python3 -c \"import pandas as p, numpy as n; p.concat([p.DataFrame(a).add_prefix(k) for k, a in n.load('F').items()], axis=1).to_csv('F.csv', index=False)\"",
    ),
    (
        "mat",
        "in MATLAB, writematrix([t q tau], 'F.csv'), and name the columns by --names",
    ),
];

/// Files of a bag in the order of time; `None` for a file of another kind.
fn bag_files(path: &Path) -> Result<Option<Vec<PathBuf>>, TableError> {
    let files = match path.is_dir() {
        true => parts(path)?,
        false => vec![path.to_owned()],
    };
    for file in &files {
        let refused = |problem: &str| Err(TableError::at(file, None, problem));
        let kind = extension(file);
        if let Some((kind, way)) = CONVERSIONS.iter().find(|(known, _)| kind == Some(*known)) {
            return refused(&format!(".{kind} is not read; convert it: {way}"));
        }
        match kind {
            Some("db3" | "mcap") => drop(fs::File::open(file).map_err(|error| at(file, error))?),
            _ if path.is_dir() => return refused("no .db3 or .mcap: decompress it"),
            _ => return Ok(None),
        }
    }
    Ok(Some(files))
}

/// Files of a bag's directory as its metadata list them, else by the number in their names.
fn parts(path: &Path) -> Result<Vec<PathBuf>, TableError> {
    let refused = |problem: &str| Err(TableError::at(path, None, problem));
    let metadata = fs::read_to_string(path.join("metadata.yaml")).unwrap_or_default();
    let lines = metadata.lines().map(str::trim);
    let mut lines = lines.skip_while(|line| *line != "relative_file_paths:");
    lines.next();
    let listed = lines.map_while(|line| line.strip_prefix("- "));
    let listed = listed.filter_map(|name| Path::new(name.trim_matches(['"', '\''])).file_name());
    let listed: Vec<PathBuf> = listed.map(|name| path.join(name)).collect();
    if !listed.is_empty() {
        return Ok(listed);
    }
    let found = fs::read_dir(path).map_err(|error| at(path, error))?;
    let found = found.flatten().map(|file| file.path());
    let found = found.filter(|file| matches!(extension(file), Some("db3" | "mcap")));
    // Name without number, number, file.
    let numbered = found.map(|file| {
        let stem = file.with_extension("").to_string_lossy().into_owned();
        let parts = stem.rsplit_once('_');
        let parts = parts.and_then(|(name, number)| Some((name, number.parse::<u64>().ok()?)));
        let (name, number) = parts.unwrap_or((&stem, 0));
        let kind = extension(&file).unwrap_or_default();
        (format!("{name}.{kind}"), number, file)
    });
    let mut numbered: Vec<_> = numbered.collect();
    numbered.sort();
    let Some((first, .., file)) = numbered.first() else {
        return refused("a directory without .db3 or .mcap");
    };
    if let Some((.., other)) = numbered.iter().find(|(name, ..)| name != first) {
        let (file, other) = (file.display(), other.display());
        return refused(&format!("several bags, {file} and {other}: name one file"));
    }
    Ok(numbered.into_iter().map(|(.., file)| file).collect())
}

fn extension(path: &Path) -> Option<&str> {
    path.extension().and_then(|extension| extension.to_str())
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::{Compression, write::GzEncoder};
    use std::io::Write as _;
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
SOUND 0,0,0,0 1,2,3 | :3: 3 fields where the header has 4: delete such rows
SOUND 0,0,0,0 1,2,x,4 | :3: column qd1_rad_s: \"x\" is not a finite number
SOUND 0,0,0,NaN | :2: column qdd1_rad_s2: \"NaN\" is not a finite number
SOUND 0,0,0, | :2: column qdd1_rad_s2: \"\" is not a finite number
SOUND 1,0,0,0 2,0,0,0 2,0,0,0 | :4: column t_s: 2 does not come after 2: keep one row of each time
SOUND 2,0,0,0 1,0,0,0 | :3: column t_s: 1 does not come after 2: sort the rows by time
SOUND | : no rows
 | : no rows";
        for case in cases.lines() {
            let (table, expected) = case.split_once(" | ").expect("a table and a message");
            let path = directory.path().join("states.csv");
            let sound = "t_s,q1_rad,qd1_rad_s,qdd1_rad_s2";
            let text = table.replace("SOUND", sound).replace(' ', "\n");
            fs::write(&path, text + "\n").expect("writes");
            let error = read_states::<1>(&path).expect_err(case);
            assert_eq!(error.to_string(), format!("{}{expected}", path.display()));
        }
        let path = directory.path().join("book.dat");
        fs::write(&path, b"PK\x03\x04\xff\xfe").expect("writes");
        let error = read_states::<1>(&path).expect_err("no text").to_string();
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
            let rows = read_states::<1>(&path).expect("reads");
            assert_eq!(rows[0].1.qd[0], -1.0 / 3.0);
            assert_eq!(rows[0].1.qdd[0], 1e-17);
            assert_eq!(rows[1].0, 0.1 + 0.2);
        }
    }

    #[test]
    fn a_header_in_a_member_of_its_own_is_that_of_the_table() {
        let directory = tempdir().expect("creates");
        let path = directory.path().join("two.csv.gz");
        let member = |text: &str| {
            let mut writer = GzEncoder::new(Vec::new(), Compression::default());
            writer.write_all(text.as_bytes()).expect("writes");
            writer.finish().expect("finishes")
        };
        let [comment, rows] = ["# t_s;a;b\n", "0;1;2\n1;3;4\n"].map(member);
        fs::write(&path, [comment, rows].concat()).expect("writes");
        let mut table = Rows::open(&path).expect("opens");
        assert_eq!(table.header, ["t_s", "a", "b"]);
        assert!(table.advance().expect("a row"));
        assert_eq!(table.number(2).ok(), Some(2.0));
    }

    #[test]
    fn columns_that_are_named_by_their_places_take_other_names() {
        let directory = tempdir().expect("creates");
        let path = directory.path().join("places.csv");
        let names = ["t_s", "a", "b"].map(str::to_owned);
        for (begin, line) in [("", 1), ("sep=,\n0,1,2\n", 3), ("0,1,2\n", 2)] {
            fs::write(&path, format!("{begin}0,1,3\n1,3,4\n")).expect("writes");
            let mut table = Rows::named(&path, &names, &Topics::ANY).expect("opens");
            assert_eq!(table.header, names);
            assert!(table.advance().expect("a row"));
            assert_eq!((table.line(), table.number(2).ok()), (line, Some(3.0)));
        }
    }

    fn bag(name: &str) -> PathBuf {
        let bags = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/ros2-bags");
        Path::new(bags).join(name)
    }

    fn copy(to: &Path, change: &str) {
        fs::copy(bag("ur10.db3"), to).expect("copies");
        let copy = rusqlite::Connection::open(to).expect("a bag");
        copy.execute_batch(change).expect("changes");
    }

    fn rows(path: &Path, named: Option<&str>) -> Result<(Vec<String>, Vec<Vec<f64>>), TableError> {
        let is_there = |names: &[String]| names.iter().any(|own| own == "shoulder_pan_joint");
        let likeness = &|names: &[String]| usize::from(is_there(names));
        let (header, rows, _) = bag::open(path, &Topics { named, likeness })?.expect("a bag");
        Ok((header, rows.collect::<Result<_, _>>()?))
    }

    #[test]
    fn files_of_a_split_bag_are_read_as_one() {
        let directory = tempdir().expect("creates");
        let middle = "(SELECT timestamp FROM messages ORDER BY timestamp LIMIT 1 OFFSET 1000)";
        let names = ["ur10_2.db3", "ur10_10.db3"];
        for (name, side) in names.iter().zip([">=", "<"]) {
            let change = format!("DELETE FROM messages WHERE timestamp {side} {middle}");
            copy(&directory.path().join(name), &change);
        }
        let whole = rows(&bag("ur10.db3"), None).expect("reads");
        assert!(whole.1.len() > 3000);
        let is_whole = || rows(directory.path(), None).expect("reads") == whole;
        assert!(is_whole(), "by the numbers");
        let renamed = directory.path().join("b.db3");
        fs::rename(directory.path().join(names[0]), &renamed).expect("renames");
        let error = rows(directory.path(), None).expect_err("two bags");
        assert!(error.to_string().contains("several bags"), "{error}");
        let metadata = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - b.db3\n    - ur10_10.db3\n  files:\n";
        fs::write(directory.path().join("metadata.yaml"), metadata).expect("writes");
        assert!(is_whole(), "by the metadata");
        fs::remove_file(renamed).expect("removes");
        let error = rows(directory.path(), None).expect_err("a file is missing");
        assert!(error.to_string().contains("b.db3"), "{error}");
    }

    #[test]
    fn files_of_a_split_mcap_are_read_as_one() {
        let directory = tempdir().expect("creates");
        let bytes = fs::read(bag("panda.mcap")).expect("reads");
        let stream = mcap::MessageStream::new(&bytes).expect("an MCAP");
        let messages: Vec<_> = stream.map(|message| message.expect("sound")).collect();
        for (part, messages) in messages.chunks(400).enumerate() {
            let file = fs::File::create(directory.path().join(format!("p_{part}.mcap")));
            let mut writer = mcap::Writer::new(file.expect("creates")).expect("begins");
            for message in messages {
                writer.write(message).expect("writes");
            }
            writer.finish().expect("ends");
        }
        let whole = rows(&bag("panda.mcap"), None).expect("reads");
        assert_eq!(whole.1.len(), 727);
        assert!(rows(directory.path(), None).expect("reads") == whole);
    }

    /// An MCAP of this program with a joint that moves on, from `start_s` on, and its last bytes.
    fn written(path: &Path, start_s: f64, rows: u32, value: impl Fn(u32) -> f64) -> Vec<u8> {
        let header = ["t_s", "q1_rad"].map(str::to_owned);
        let mut table = TableWriter::create(path, &header).expect("creates");
        for row in 0..rows {
            let t_s = start_s + 1e-3 * f64::from(row);
            table.row([t_s, value(row)]).expect("writes");
        }
        table.finish().expect("finishes");
        fs::read(path).expect("reads")
    }

    #[test]
    fn a_damaged_mcap_is_refused_and_a_cut_one_read_to_its_last_whole_chunk() {
        const ROWS: u32 = 6000;
        let directory = tempdir().expect("creates");
        let path = directory.path().join("log.mcap");
        let value = |row: u32| (f64::from(row) * 0.37).sin() / 3.0;
        let sound = written(&path, 0.0, ROWS, value);
        let read = || {
            let (_, messages, notes) = bag::open(&path, &Topics::ANY)?.expect("a bag");
            let rows = messages.collect::<Result<Vec<_>, _>>()?;
            Ok::<_, TableError>((rows, notes.concat()))
        };
        let whole = read().expect("sound").0;
        let values: Vec<f64> = whole.iter().map(|row| row[1]).collect();
        assert!(values.into_iter().eq((0..ROWS).map(value)), "bit for bit");
        let cut = "ended in the middle of a record: what is before its end was read";
        // Some bytes are in indices that nobody reads, some are lengths beyond the end.
        let mut refused = 0;
        for part in 1..40 {
            let mut flipped = sound.clone();
            flipped[sound.len() * part / 40] ^= 0x10;
            fs::write(&path, flipped).expect("writes");
            match read() {
                Ok((rows, notes)) => assert!(rows == whole || notes.contains(cut), "{part}"),
                Err(error) => {
                    refused += 1;
                    assert!(error.to_string().contains("log.mcap: "), "{error}");
                }
            }
        }
        assert!(refused > 8, "{refused}");
        // Chunks of 64 KiB: there are several, and the last cut has all but the last of them.
        let mut lengths = std::collections::BTreeSet::new();
        for part in 1..40 {
            fs::write(&path, &sound[..sound.len() * part / 40]).expect("writes");
            let Ok((rows, notes)) = read() else {
                continue;
            };
            assert!(whole.starts_with(&rows) && notes.contains(cut), "{notes}");
            lengths.insert(rows.len());
        }
        assert!(lengths.len() > 3, "{lengths:?}");
        assert!(*lengths.last().expect("some") > 3000, "{lengths:?}");
    }

    #[test]
    fn times_before_zero_and_numbers_that_are_not_finite_come_back_from_an_mcap() {
        let directory = tempdir().expect("creates");
        let path = directory.path().join("log.mcap");
        written(&path, -2.0, 3000, f64::from);
        let (_, found) = rows(&path, None).expect("sound");
        for (k, row) in (0..).zip(&found) {
            assert!((row[0] - 1e-3 * f64::from(k)).abs() < 1e-9, "{row:?}");
        }
        written(&path, 0.0, 3, |row| if row == 1 { f64::NAN } else { 1.0 });
        let mut table = Rows::open(&path).expect("opens");
        let column = table.require("q1_rad").expect("there");
        let read = (0..3).map(|_| table.advance().and_then(|_| table.number(column)));
        let read: Vec<_> = read.collect();
        assert!(read[0].is_ok() && read[2].is_ok());
        let error = read[1].as_ref().expect_err("NaN").to_string();
        let wanted = "log.mcap:2: column q1_rad: \"NaN\" is not a finite number";
        assert!(error.ends_with(wanted), "{error}");
    }

    /// `sensor_msgs/JointState` with these positions, and so many efforts, in plain CDR.
    fn joint_state(nanoseconds: u32, joints: &[(String, f64)], efforts: usize) -> Vec<u8> {
        let mut cdr = Vec::new();
        let count = joints.len() as u32;
        for word in [0, nanoseconds, 1, 0, count] {
            cdr.extend_from_slice(&u32::to_le_bytes(word));
        }
        // The text of length 1 is its zero, padded.
        for (name, _) in joints {
            cdr.extend_from_slice(&(name.len() as u32 + 1).to_le_bytes());
            cdr.extend_from_slice(name.as_bytes());
            cdr.resize((cdr.len() + 1).next_multiple_of(4), 0);
        }
        for joints in [joints, joints, &joints[..efforts]] {
            cdr.extend_from_slice(&(joints.len() as u32).to_le_bytes());
            cdr.resize(cdr.len().next_multiple_of(8), 0);
            for (_, value) in joints {
                cdr.extend_from_slice(&value.to_le_bytes());
            }
        }
        [&[0, 1, 0, 0], &cdr[..]].concat()
    }

    #[test]
    fn messages_of_a_hand_with_more_joints_than_the_arm_are_left_out() {
        let directory = tempdir().expect("creates");
        let path = directory.path().join("hand.mcap");
        let write = |efforts: Option<usize>| {
            let file = fs::File::create(&path).expect("creates");
            let mut writer = mcap::Writer::new(file).expect("begins");
            let schema = writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", b"");
            let channel = writer.add_channel(
                schema.expect("a schema"),
                "/joint_states",
                "cdr",
                &std::collections::BTreeMap::new(),
            );
            let channel_id = channel.expect("a channel");
            for k in 0..200_u32 {
                let (name, count) = [("finger", 16), ("shoulder_pan_joint", 7)][k as usize % 2];
                let names = (0..count).map(|j| match j {
                    0 => name.to_owned(),
                    j => format!("{name}_{j}"),
                });
                let joints: Vec<_> = names.map(|name| (name, f64::from(k))).collect();
                let header = mcap::records::MessageHeader {
                    channel_id,
                    sequence: k,
                    log_time: u64::from(k) * 1_000_000,
                    publish_time: 0,
                };
                let message = joint_state(k * 1_000_000, &joints, efforts.unwrap_or(count));
                let written = writer.write_to_known_channel(&header, &message);
                written.expect("writes");
            }
            writer.finish().expect("ends");
        };
        write(None);
        let (header, found) = rows(&path, None).expect("reads");
        assert_eq!(header[1], "shoulder_pan_joint/position");
        assert_eq!((header.len(), found.len()), (22, 100));
        assert_eq!((found[0][0], found[1][1]), (0.0, 3.0));
        for (efforts, words) in [(0, "is empty in"), (6, "has 6 values for 7 joints in")] {
            write(Some(efforts));
            let error = rows(&path, None).expect_err("lacks efforts").to_string();
            let wanted = format!("the field effort {words} /joint_states");
            assert!(error.contains(&wanted), "{error}");
        }
    }

    #[test]
    fn the_topic_with_the_joints_of_the_arm_is_read() {
        let directory = tempdir().expect("creates");
        let path = directory.path().join("two.db3");
        let other = format!(
            "UPDATE topics SET name = '/robot/joint_states'; ATTACH '{}' AS other; \
             INSERT INTO topics SELECT 77, '/gripper/joint_states', type, serialization_format, offered_qos_profiles, '' FROM other.topics; \
             INSERT INTO messages SELECT id + 100000, 77, timestamp, data FROM other.messages",
            bag("panda.db3").display()
        );
        copy(&path, &other);
        let whole = rows(&bag("ur10.db3"), None).expect("reads");
        assert!(rows(&path, None).expect("reads") == whole);
        let before = format!(
            "ATTACH '{}' AS other; INSERT INTO messages \
             SELECT theirs.id + 100000, own.id, timestamp / 2, data FROM other.messages theirs, main.topics own",
            bag("panda.db3").display()
        );
        copy(&directory.path().join("one.db3"), &before);
        let late = rows(&directory.path().join("one.db3"), None).expect("reads");
        assert!(late == whole, "after 727 messages of others");
        let named = rows(&path, Some("/gripper/joint_states")).expect("reads");
        assert_eq!(named.1.len(), 727);
        let error = rows(&path, Some("/nowhere")).expect_err("no such topic");
        assert!(error.to_string().contains("no /nowhere of "), "{error}");
        copy(
            &path,
            "INSERT INTO topics SELECT 77, '/a', type, serialization_format, offered_qos_profiles, '' FROM topics; \
             INSERT INTO messages SELECT id + 100000, 77, timestamp, data FROM messages",
        );
        let error = rows(&path, None).expect_err("two topics").to_string();
        let both = "/a, /joint_states all have the joints of the arm: write `topic = \"/a\"";
        assert!(error.contains(both), "{error}");
        let error = bag::open(&path, &Topics::ANY).err();
        let error = error.expect("no arm").to_string();
        let parts = "and no topic has all joints of the arm";
        assert!(error.contains("/a ("), "{error}");
        assert!(error.contains(parts), "{error}");
    }
}
