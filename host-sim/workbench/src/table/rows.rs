//! Checked rows of a table: as wide as the header, finite numbers, time ascending.

use super::bag::{Messages, Topics};
use super::{TableError, is_compressed};
use crate::files::at;
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Reads a table row by row, in constant memory: CSV with any separator, or the joint states of a ROS 2 bag. A name that
/// ends in `.gz` is decompressed.
pub(crate) struct Rows {
    pub(crate) path: PathBuf,
    source: Source,
    pub(crate) header: Vec<String>,
    /// Line of the header, from 1.
    header_line: u64,
    pub(crate) remedies: Remedies,
    previous_s: Option<f64>,
    /// A row was read.
    begun: bool,
    /// Remarks on what was read.
    pub(crate) notes: Vec<String>,
}

/// Remedies that errors of the rows name.
#[derive(Clone, Copy)]
pub(crate) struct Remedies {
    /// For a field that is no number, from its text.
    pub(crate) of_field: fn(&str) -> &'static str,
    /// For a time that comes twice.
    pub(crate) same: &'static str,
    /// For a time before that of the row before.
    pub(crate) back: &'static str,
}

impl Remedies {
    /// Of a table of states, of which no row may be lost.
    const OF_STATES: Self = Self {
        of_field: |_| "",
        same: "keep one row of each time",
        back: "sort the rows by time",
    };
}

enum Source {
    Csv {
        reader: Box<csv::Reader<Box<dyn BufRead + Send>>>,
        record: csv::ByteRecord,
        separator: u8,
        /// Lines of comment before the table.
        above: u64,
    },
    Bag {
        messages: Messages,
        row: Vec<f64>,
        count: u64,
    },
}

/// Longest line, bytes. A table is read line by line, and a compressed file can hold a line of any length.
const LONGEST_LINE: usize = 1 << 20;

/// Rows that show whether a column has numbers.
const FIRST_ROWS: usize = 100;

/// Bytes of a table until a line is too long.
struct BoundedLines<R> {
    bytes: R,
    /// Bytes since the last end of a line.
    length: usize,
}

impl<R: Read> Read for BoundedLines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.bytes.read(buffer)?;
        let read = &buffer[..count];
        self.length = match read.iter().rposition(|&byte| byte == b'\n') {
            Some(end) => count - end - 1,
            None => self.length + count,
        };
        if self.length > LONGEST_LINE {
            let problem = format!("a line of more than {LONGEST_LINE} bytes: no table");
            return Err(io::Error::other(problem));
        }
        Ok(count)
    }
}

/// Bytes in which the header of a table is looked for.
const BEGINNING: u64 = 1 << 18;

/// Lines before a table that begin with `#`, name the separator (`sep=;`) or are empty, the line behind these, and the bytes
/// before that line.
fn beginning(bytes: &[u8]) -> (Vec<String>, String, usize) {
    let (mut comments, mut length) = (Vec::new(), 0);
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        let text = String::from_utf8_lossy(line);
        let text = text.trim_start_matches('\u{feff}').trim().to_owned();
        if !text.is_empty() && !text.starts_with('#') && !text.starts_with("sep=") {
            return (comments, text, length);
        }
        comments.push(text);
        length += line.len();
    }
    (comments, String::new(), length)
}

/// A name without the sign of a comment, which a header may begin with.
fn uncommented(name: &str) -> &str {
    name.trim_start_matches(['#', '%', ' '])
}

/// Separators of a CSV file in the order in which they are looked for: a comma may be a decimal one.
const SEPARATORS: [u8; 4] = *b";\t, ";

impl Rows {
    pub(crate) fn open(path: &Path) -> Result<Self, TableError> {
        Self::named(path, &[], &Topics::ANY)
    }

    /// Opens a table; a CSV file without a header row takes `names` as its header, a bag is read by one of its `topics`.
    pub(crate) fn named(
        path: &Path,
        names: &[String],
        topics: &Topics<'_>,
    ) -> Result<Self, TableError> {
        if let Some((header, messages, notes)) = super::bag::open(path, topics)? {
            return Ok(Self {
                path: path.to_owned(),
                source: Source::Bag {
                    messages,
                    row: Vec::new(),
                    count: 0,
                },
                header,
                header_line: 1,
                remedies: Remedies::OF_STATES,
                previous_s: None,
                begun: false,
                notes,
            });
        }
        let file = File::open(path).map_err(|error| at(path, error))?;
        let bytes: Box<dyn Read + Send> = if is_compressed(path) {
            Box::new(MultiGzDecoder::new(BufReader::new(file)))
        } else {
            Box::new(file)
        };
        let mut bytes = BoundedLines { bytes, length: 0 };
        // One read may end early: with a member of a compressed file, or with what a pipe holds.
        let mut start = Vec::new();
        let read = bytes.by_ref().take(BEGINNING).read_to_end(&mut start);
        read.map_err(|error| at(path, error))?;
        let (comments, first, length) = beginning(&start);
        start.drain(..length);
        let bytes = BufReader::with_capacity(1 << 18, bytes);
        let bytes: Box<dyn BufRead + Send> = Box::new(io::Cursor::new(start).chain(bytes));
        let split_by = |line: &str, separator: u8| -> Vec<String> {
            let fields = line.split(char::from(separator));
            let fields = fields.map(|field| field.trim().trim_matches('"').to_owned());
            fields.filter(|field| !field.is_empty()).collect()
        };
        // A missing value is a number, too.
        let are_numbers = |separator: &u8| {
            let fields = split_by(&first, *separator);
            let is_number = |field: &String| parsed(field.as_bytes(), *separator).is_some();
            !fields.is_empty() && fields.iter().all(is_number)
        };
        let is_there = |separator: &u8| first.as_bytes().contains(separator);
        let of_numbers = SEPARATORS.into_iter().filter(is_there).find(are_numbers);
        let separator = of_numbers.or(SEPARATORS.into_iter().find(is_there));
        let separator = separator.unwrap_or(b',');
        let fields = split_by(&first, separator);
        // A row of numbers may have texts. A whole number may be the name of a column.
        let is_value = |field: &&String| {
            let is_number = number(field.as_bytes(), separator).is_some();
            is_number && !field.bytes().all(|byte| byte.is_ascii_digit())
        };
        let values = fields.iter().filter(is_value).count();
        let all_numbers = are_numbers(&separator);
        let numbers = all_numbers || (values > 0 && 3 * values >= fields.len());
        // The comment that names as many columns as there are numbers is the header.
        let named = |line: &String| split_by(line.trim_start_matches('#'), separator);
        let mut lines = comments.iter().map(named).enumerate();
        let commented = lines.rfind(|(_, names)| numbers && names.len() == fields.len());
        let header_line = match &commented {
            Some((place, _)) => *place as u64 + 1,
            None => comments.len() as u64 + 1,
        };
        let has_header = commented.is_some() || !numbers;
        if !has_header && names.is_empty() {
            let found = match all_numbers {
                true => format!("{} numbers", fields.len()),
                false => {
                    let line = first.trim_end_matches(char::from(separator));
                    let count = line.split(char::from(separator)).count();
                    format!("{count} fields with numbers among them")
                }
            };
            let problem =
                format!("no header row, {found}: name the columns by --names t_s,q1_rad,…");
            return Err(TableError::at(path, header_line, problem));
        }
        // A header of the places of its columns, as tables without names have it.
        let is_place = |(place, field): (usize, &String)| *field == place.to_string();
        let places = commented.is_none() && fields.len() > 2;
        let places = places && fields.iter().enumerate().all(is_place);
        let mut reader = csv::ReaderBuilder::new()
            .flexible(true)
            .has_headers(!numbers || places)
            .delimiter(separator)
            .trim(csv::Trim::Headers)
            .buffer_capacity(1 << 18)
            .from_reader(bytes);
        let header: Vec<String> = if let Some((_, header)) = commented {
            header
        } else if numbers {
            names.to_vec()
        } else {
            let found = reader.headers().map_err(|error| unreadable(path, &error))?;
            let found = found.iter().map(uncommented);
            let found = found.filter(|name| separator != b' ' || !name.is_empty());
            let mut found: Vec<String> = found.map(str::to_owned).collect();
            // A separator ends the header.
            found.pop_if(|name| name.is_empty());
            found
        };
        if header.is_empty() {
            return Err(TableError::empty(path));
        }
        let named = (has_header && !names.is_empty()).then(|| {
            let path = path.display();
            format!("{path}: its own header is taken, in the place of --names")
        });
        Ok(Self {
            path: path.to_owned(),
            header,
            source: Source::Csv {
                reader: Box::new(reader),
                record: csv::ByteRecord::new(),
                separator,
                above: comments.len() as u64,
            },
            header_line,
            remedies: Remedies::OF_STATES,
            previous_s: None,
            begun: false,
            notes: named.into_iter().collect(),
        })
    }

    /// Place of a column; `None` if the table does not have it.
    pub(crate) fn find(&self, column: &str) -> Result<Option<usize>, TableError> {
        let names = self.header.iter().enumerate();
        let is_it = |name: &str| uncommented(name) == uncommented(column);
        let mut places = names.filter(|(_, name)| is_it(name)).map(|(k, _)| k);
        match (places.next(), places.next()) {
            (_, Some(_)) => Err(self.header_error(format!("column {column} appears twice"))),
            (first, None) => Ok(first),
        }
    }

    /// Place of a column that must be there.
    pub(crate) fn require(&self, column: &str) -> Result<usize, TableError> {
        self.find(column)?.ok_or_else(|| self.missing(column))
    }

    pub(crate) fn missing(&self, column: &str) -> TableError {
        self.header_error(format!("column {column} is missing"))
    }

    /// Refuses the column of a joint that a robot of `joints` joints does not have.
    pub(crate) fn refuse(&self, column: &str, joints: usize) -> Result<(), TableError> {
        let many = format!("column {column} is one too many: the robot has {joints} joints");
        let found = self.find(column)?;
        found.map_or(Ok(()), |_| Err(self.header_error(many)))
    }

    pub(crate) fn header_error(&self, problem: String) -> TableError {
        TableError::at(&self.path, self.header_line, problem)
    }

    pub(crate) fn row_error(&self, problem: String) -> TableError {
        TableError::at(&self.path, self.line(), problem)
    }

    /// Reads the next row; false at the end.
    pub(crate) fn advance(&mut self) -> Result<bool, TableError> {
        let fields = match &mut self.source {
            Source::Bag {
                messages,
                row,
                count,
            } => {
                let next = messages.next().transpose()?;
                *count += 1;
                let more = next.is_some();
                *row = next.unwrap_or_default();
                return Ok(more);
            }
            Source::Csv {
                reader,
                record,
                separator,
                ..
            } => {
                loop {
                    let more = reader.read_byte_record(record);
                    if !more.map_err(|error| unreadable(&self.path, &error))? {
                        return Ok(false);
                    }
                    let first = record.get(0).unwrap_or_default();
                    if !first.trim_ascii_start().starts_with(b"#") {
                        break;
                    }
                }
                // Several spaces in a row are one separator.
                if *separator == b' ' && record.iter().any(<[u8]>::is_empty) {
                    let position = record.position().cloned();
                    *record = record.iter().filter(|field| !field.is_empty()).collect();
                    record.set_position(position);
                }
                // A separator may end a row.
                let ends = record.len() == self.header.len() + 1;
                let ends = ends && record.iter().next_back().is_some_and(<[u8]>::is_empty);
                record.len() - usize::from(ends)
            }
        };
        let width = self.header.len();
        if fields != width {
            let remedy = match self.begun {
                true => "delete such rows",
                false => "name every column once",
            };
            let problem = format!("{fields} fields where the header has {width}: {remedy}");
            return Err(self.row_error(problem));
        }
        self.begun = true;
        Ok(true)
    }

    /// Columns of which the first rows have no number: a driver may have none of an optional quantity. The table is read
    /// again for it by `open`.
    pub(crate) fn empty_columns(mut self) -> Result<Vec<bool>, TableError> {
        let mut empty = vec![false; self.header.len()];
        for row in 0..FIRST_ROWS {
            if !self.advance()? {
                break;
            }
            if row == 0 {
                empty.fill(true);
            }
            for (column, empty) in empty.iter_mut().enumerate() {
                *empty &= self.number(column).is_err();
            }
        }
        Ok(empty)
    }

    /// Line of the row, or number of the message, from 1.
    pub(crate) fn line(&self) -> u64 {
        match &self.source {
            Source::Csv { record, above, .. } => {
                above + record.position().map_or(0, csv::Position::line)
            }
            Source::Bag { count, .. } => *count,
        }
    }

    /// The number in a column of the row.
    pub(crate) fn number(&self, column: usize) -> Result<f64, TableError> {
        let (value, text) = match &self.source {
            Source::Bag { row, .. } => {
                let value = row.get(column).copied().unwrap_or(f64::NAN);
                (value.is_finite().then_some(value), value.to_string())
            }
            Source::Csv {
                record, separator, ..
            } => {
                let field = record.get(column).unwrap_or_default();
                let value = number(field, *separator);
                let text = match value {
                    Some(_) => String::new(),
                    None => String::from_utf8_lossy(field).trim().to_owned(),
                };
                (value, text)
            }
        };
        value.ok_or_else(|| {
            let (column, remedy) = (&self.header[column], (self.remedies.of_field)(&text));
            let colon = if remedy.is_empty() { "" } else { ": " };
            self.row_error(format!(
                "column {column}: {text:?} is not a finite number{colon}{remedy}"
            ))
        })
    }

    /// The time in a column of the row, after that of the row before.
    pub(crate) fn time(&mut self, column: usize) -> Result<f64, TableError> {
        let t_s = self.number(column)?;
        match self.previous_s.replace(t_s) {
            Some(previous_s) if t_s <= previous_s => {
                let name = &self.header[column];
                let remedy = match t_s == previous_s {
                    _ if matches!(self.source, Source::Bag { .. }) => {
                        "record the messages of one publisher alone; for even rows give rate_hz in --columns-from FILE; where a clock begins anew, cut the bag"
                    }
                    true => self.remedies.same,
                    false => self.remedies.back,
                };
                let problem =
                    format!("column {name}: {t_s} does not come after {previous_s}: {remedy}");
                Err(self.row_error(problem))
            }
            _ => Ok(t_s),
        }
    }
}

/// The finite number in a field.
fn number(field: &[u8], separator: u8) -> Option<f64> {
    parsed(field, separator).filter(|value| value.is_finite())
}

/// The number in a field, finite or not. Where commas do not separate, the decimal sign may be one.
fn parsed(field: &[u8], separator: u8) -> Option<f64> {
    let text = std::str::from_utf8(field).ok()?.trim();
    let parsed = match text.parse() {
        Err(_) if separator != b',' => text.replacen(',', ".", 1).parse(),
        parsed => parsed,
    };
    parsed.ok()
}

fn unreadable(path: &Path, error: &csv::Error) -> TableError {
    let problem = match error.kind() {
        csv::ErrorKind::Utf8 { .. } => {
            "the header is no text in UTF-8: write CSV; compressed CSV ends in .gz".to_owned()
        }
        _ => error.to_string(),
    };
    TableError::at(path, None, problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endless_line_is_refused_and_any_number_of_lines_is_read() {
        let line = [&[b'1'; 1 << 16][..], b"\n"].concat();
        for (last, sound) in [(0, true), (LONGEST_LINE, true), (LONGEST_LINE + 1, false)] {
            let bytes = [line.repeat(40), vec![b'1'; last]].concat();
            let (bytes, length) = (&bytes[..], 0);
            let read = io::copy(&mut BoundedLines { bytes, length }, &mut io::sink());
            assert_eq!(read.is_ok(), sound, "{last}");
        }
    }
}
