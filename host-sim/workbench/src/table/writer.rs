//! Writing a table: CSV, and MCAP with the columns of each topic as one JSON message a row, at the time of the row.
//!
//! Numbers in an MCAP are those of the CSV, digit by digit. It has no negative times: where the first row is before zero, they
//! count from that row. Chunks are small, so that a file that was cut reads almost to its end.

use super::is_compressed;
use crate::files::WholeFile;
use flate2::Compression;
use flate2::write::GzEncoder;
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Write};
use std::path::Path;

/// Writes a table that is whole or absent: CSV, MCAP where the name ends in `.mcap`, or both.
pub struct TableWriter {
    csv: Option<csv::Writer<Box<dyn Sink>>>,
    mcap: Option<Box<McapTable>>,
}

/// Bytes on their way to a file that is whole or absent.
trait Sink: Write {
    fn finish(self: Box<Self>) -> io::Result<()>;
}

impl Sink for WholeFile {
    fn finish(self: Box<Self>) -> io::Result<()> {
        Self::finish(*self)
    }
}

impl Sink for GzEncoder<WholeFile> {
    fn finish(self: Box<Self>) -> io::Result<()> {
        Self::finish(*self)?.finish()
    }
}

impl TableWriter {
    /// Starts a table with its header row.
    ///
    /// Errors: the file system's.
    pub fn create(path: &Path, header: &[String]) -> io::Result<Self> {
        if path.extension().is_some_and(|end| end == "mcap") {
            let mcap = Some(Box::new(McapTable::create(path, header)?));
            return Ok(Self { csv: None, mcap });
        }
        let file = WholeFile::create(path)?;
        let sink: Box<dyn Sink> = match is_compressed(path) {
            true => Box::new(GzEncoder::new(file, Compression::default())),
            false => Box::new(file),
        };
        let mut writer = csv::Writer::from_writer(sink);
        writer.write_record(header)?;
        let (csv, mcap) = (Some(writer), None);
        Ok(Self { csv, mcap })
    }

    /// Starts a table as CSV, and as MCAP beside it; as MCAP alone where the name ends in `.mcap`.
    ///
    /// Errors: the file system's.
    pub fn with_mcap(path: &Path, header: &[String]) -> io::Result<Self> {
        let beside = path.with_extension("mcap");
        if beside == path {
            return Self::create(path, header);
        }
        let beside = McapTable::create(&beside, header)?;
        Ok(Self {
            mcap: Some(Box::new(beside)),
            ..Self::create(path, header)?
        })
    }

    /// Adds a row. Numbers are written with as many digits as bring back the same value.
    ///
    /// Errors: the file system's, or a row of another width than the header.
    pub fn row<T: fmt::Display>(&mut self, values: impl IntoIterator<Item = T>) -> io::Result<()> {
        let values: Vec<String> = values.into_iter().map(|value| value.to_string()).collect();
        if let Some(mcap) = &mut self.mcap {
            mcap.row(&values)?;
        }
        match &mut self.csv {
            Some(csv) => Ok(csv.write_record(&values)?),
            None => Ok(()),
        }
    }

    /// Completes the table and gives it its name.
    ///
    /// Errors: the file system's.
    pub fn finish(self) -> io::Result<()> {
        if let Some(mcap) = self.mcap {
            mcap.finish()?;
        }
        let Some(csv) = self.csv else {
            return Ok(());
        };
        let sink = csv.into_inner();
        let sink = sink.map_err(|error| io::Error::other(error.to_string()))?;
        sink.finish()
    }
}

/// Bytes of a chunk before compression.
const CHUNK: u64 = 1 << 16;

/// Topics by the words that names of columns begin with, the first that fits; all others are of the board.
const TOPICS: [(&str, &[&str]); 6] = [
    ("/desired", &["desired"]),
    (
        "/shares",
        &["total", "rigid", "friction", "network", "feed_forward"],
    ),
    ("/residual", &["residual"]),
    (
        "/decisions",
        &["decision", "trust", "information", "payload", "guard"],
    ),
    ("/safety", &["flags", "safety"]),
    ("/measured", &["q", "tau", "i"]),
];

fn topic_of(column: &str) -> &'static str {
    let stem = column.find(|c: char| c.is_ascii_digit());
    let stem = stem.map_or(column, |end| &column[..end]);
    let fits = |word: &&str| match word.len() {
        1 => stem == *word || (*word == "q" && matches!(stem, "qd" | "qdd")),
        _ => stem.starts_with(*word),
    };
    let found = TOPICS.iter().find(|(_, words)| words.iter().any(fits));
    found.map_or("/board", |(topic, _)| topic)
}

struct McapTable {
    writer: Writer<NoSeek<WholeFile>>,
    /// Channel, its columns with their names as JSON keys.
    channels: Vec<(u16, Vec<(usize, String)>)>,
    time: Option<usize>,
    /// Time of the first row where that is negative, else 0, s.
    origin_s: f64,
    rows: u32,
}

fn failed(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        other => io::Error::other(other.to_string()),
    }
}

impl McapTable {
    fn create(path: &Path, header: &[String]) -> io::Result<Self> {
        let options = WriteOptions::new().library("foretorque");
        let options = options.chunk_size(Some(CHUNK)).disable_seeking(true);
        let writer = options.create(NoSeek::new(WholeFile::create(path)?));
        let mut writer = writer.map_err(failed)?;
        let mut topics: BTreeMap<&str, Vec<(usize, String)>> = BTreeMap::new();
        for (place, name) in header.iter().enumerate().filter(|(_, name)| *name != "t_s") {
            let columns = topics.entry(topic_of(name)).or_default();
            columns.push((place, name.clone()));
        }
        let mut channels = Vec::new();
        for (topic, columns) in topics {
            let number =
                |(_, name): &(usize, String)| format!("\"{name}\":{{\"type\":\"number\"}}");
            let properties: Vec<String> = columns.iter().map(number).collect();
            let properties = properties.join(",");
            let schema = format!("{{\"type\":\"object\",\"properties\":{{{properties}}}}}");
            let name = format!("foretorque{}", topic.replace('/', "."));
            let schema = writer.add_schema(&name, "jsonschema", schema.as_bytes());
            let schema = schema.map_err(failed)?;
            let channel = writer.add_channel(schema, topic, "json", &BTreeMap::new());
            channels.push((channel.map_err(failed)?, columns));
        }
        Ok(Self {
            writer,
            channels,
            time: header.iter().position(|name| name == "t_s"),
            origin_s: 0.0,
            rows: 0,
        })
    }

    /// Adds a row of numbers as they stand in the CSV.
    fn row(&mut self, values: &[String]) -> io::Result<()> {
        let t_s = self.time.and_then(|place| values.get(place)?.parse().ok());
        let t_s: f64 = t_s.unwrap_or(f64::from(self.rows));
        if self.rows == 0 {
            self.origin_s = t_s.min(0.0);
        }
        let log_time = ((t_s - self.origin_s) * 1e9).round() as u64;
        for (channel, columns) in &self.channels {
            let pairs = columns.iter().filter_map(|(place, name)| {
                let value = values.get(*place)?;
                // JSON has no infinities.
                let finite = value.parse::<f64>().is_ok_and(f64::is_finite);
                let value = if finite { value } else { "null" };
                Some(format!("\"{name}\":{value}"))
            });
            let message = format!("{{{}}}", pairs.collect::<Vec<_>>().join(","));
            let header = MessageHeader {
                channel_id: *channel,
                sequence: self.rows,
                log_time,
                publish_time: log_time,
            };
            let written = self
                .writer
                .write_to_known_channel(&header, message.as_bytes());
            written.map_err(failed)?;
        }
        self.rows += 1;
        Ok(())
    }

    fn finish(mut self) -> io::Result<()> {
        self.writer.finish().map_err(failed)?;
        self.writer.into_inner().into_inner().finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_go_to_the_topics_of_their_kind() {
        for (column, topic) in [
            ("q1_rad", "/measured"),
            ("qdd6_rad_s2", "/measured"),
            ("tau3_nm", "/measured"),
            ("desired_q1_rad", "/desired"),
            ("desired1_rad", "/desired"),
            ("feed_forward2_nm", "/shares"),
            ("residual1_of_limit", "/residual"),
            ("decision_reason", "/decisions"),
            ("safety_state", "/safety"),
            ("tick_counts", "/board"),
            ("information", "/decisions"),
        ] {
            assert_eq!(topic_of(column), topic, "{column}");
        }
    }

    #[test]
    fn a_table_named_mcap_is_written_as_mcap_alone() {
        let here = tempfile::tempdir().expect("creates");
        for (name, has_csv) in [("alone.mcap", false), ("both.csv", true)] {
            let path = here.path().join(name);
            let header = ["t_s".to_owned()];
            let mut table = TableWriter::with_mcap(&path, &header).expect("creates");
            table.row([1.0]).expect("writes");
            table.finish().expect("finishes");
            let found = ["mcap", "csv"].map(|end| path.with_extension(end).exists());
            assert_eq!(found, [true, has_csv], "{name}");
        }
    }
}
