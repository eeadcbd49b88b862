//! Telemetry of a board as a table: one row a record, one column a number, with `t_s` in front; of a board that another host
//! drives, too, read along on its line.

use crate::table::{TableWriter, joint_columns};
use foretorque_link::bank::MAX_JOINTS;
use foretorque_link::wire::{BoardMessage, Decoder, Field, TelemetryFrame};
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Fields that a board shall report, and their rates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Selection {
    /// Sum of the fields' bits.
    pub fields: u16,
    /// Ticks from record to record.
    pub every: u16,
}

enum Columns {
    /// One for each joint, in this unit.
    Joints(&'static str),
    /// Those of the board as a whole, separated by spaces.
    Board(&'static str),
}
use Columns::{Board, Joints};

const STATE: &str = "flags safety_state safety_reason";
const QUALITY: &str = "trust information payload_kg phase";
const DECISION: &str = "decisions decision_reason decision_joint decision_figure";
const LOSS: &str = "frames_missed frames_refused replies_lost overruns";

/// The fields with their names on the command line, in the order of a record.
const FIELDS: [(&str, Field, Columns); Field::ALL.len()] = [
    ("state", Field::State, Board(STATE)),
    ("total", Field::Total, Joints("nm")),
    ("rigid", Field::Rigid, Joints("nm")),
    ("friction", Field::Friction, Joints("nm")),
    ("network", Field::Network, Joints("nm")),
    ("desired-q", Field::DesiredPosition, Joints("rad")),
    ("desired-qd", Field::DesiredVelocity, Joints("rad_s")),
    ("q", Field::MeasuredPosition, Joints("rad")),
    ("tau", Field::MeasuredTorque, Joints("nm")),
    ("residual", Field::Residual, Joints("of_limit")),
    ("quality", Field::Quality, Board(QUALITY)),
    ("decision", Field::Decision, Board(DECISION)),
    ("cost", Field::Cost, Board("tick_counts learn_counts")),
    ("loss", Field::Loss, Board(LOSS)),
    ("temperature", Field::Temperature, Joints("c")),
];

impl FromStr for Selection {
    type Err = String;

    /// `state,total/10`: fields, and every how many ticks; `all/20`: all fields.
    fn from_str(text: &str) -> Result<Self, String> {
        let (list, every) = text.split_once('/').unwrap_or((text, "1"));
        let ticks = every.parse().ok().filter(|ticks| *ticks > 0);
        let wrong = || format!("'{every}' is no number of ticks from 1 to 65535");
        let every = ticks.ok_or_else(wrong)?;
        let mut fields = 0;
        for name in list.split(',') {
            fields |= match FIELDS.iter().find(|(known, ..)| *known == name) {
                Some((_, field, _)) => field.bit(),
                None if name == "all" => Field::ALL.iter().fold(0, |all, field| all | field.bit()),
                None => {
                    let known: Vec<_> = FIELDS.iter().map(|(known, ..)| *known).collect();
                    return Err(format!("no field '{name}', only {}, all", known.join(", ")));
                }
            };
        }
        Ok(Self { fields, every })
    }
}

impl Selection {
    fn has(&self, field: Field) -> bool {
        self.fields & field.bit() != 0
    }

    fn columns(&self, joints: usize) -> Vec<String> {
        let chosen = FIELDS.iter().filter(|(_, field, _)| self.has(*field));
        let columns = chosen.map(|(name, _, columns)| match columns {
            Joints(unit) => joint_columns(&name.replace('-', "_"), unit, joints),
            Board(names) => names.split(' ').map(str::to_owned).collect(),
        });
        columns.flatten().collect()
    }
}

/// Numbers of one field; its bytes have the length of the field.
pub fn numbers(field: Field, bytes: &[u8]) -> Vec<f64> {
    let word = |place: usize| -> [u8; 4] { std::array::from_fn(|k| bytes[place + k]) };
    let float = |place| f64::from(f32::from_le_bytes(word(place)));
    let int = |place| f64::from(u32::from_le_bytes(word(place)));
    let half = |place: usize| f64::from(u16::from_le_bytes([bytes[place], bytes[place + 1]]));
    let byte = |place: usize| f64::from(bytes[place]);
    match field {
        Field::State => vec![half(0), byte(2), byte(3)],
        Field::Quality => vec![float(0), float(4), float(8), byte(12)],
        Field::Decision => vec![int(0), byte(4), byte(5), float(6)],
        Field::Cost => vec![int(0), int(4)],
        Field::Loss => (0..4).map(|k| half(2 * k)).collect(),
        Field::Temperature => bytes.iter().map(|b| f64::from(*b as i8)).collect(),
        _ => (0..bytes.len() / 4).map(|k| float(4 * k)).collect(),
    }
}

/// Writes records into a table as their frames come.
pub struct Recorder {
    selection: Selection,
    joints: usize,
    period_s: f64,
    table: TableWriter,
    /// The record whose frames are still coming: tick, fields, numbers.
    open: Option<(u32, u16, Vec<f64>)>,
    whole: u64,
    /// Records that came with a part missing, and were left out.
    torn: u64,
}

impl Recorder {
    /// Starts the table.
    ///
    /// Errors: the file system's.
    pub fn create(
        path: &Path,
        selection: Selection,
        joints: usize,
        period_s: f64,
    ) -> io::Result<Self> {
        let mut header = vec!["t_s".to_owned()];
        header.extend(selection.columns(joints));
        Ok(Self {
            selection,
            joints,
            period_s,
            table: TableWriter::with_mcap(path, &header)?,
            open: None,
            whole: 0,
            torn: 0,
        })
    }

    /// Takes frames in the order they came.
    ///
    /// Errors: the file system's.
    pub fn take(&mut self, frames: &[TelemetryFrame]) -> io::Result<()> {
        for frame in frames {
            let of_open = matches!(&self.open, Some((tick, ..)) if *tick == frame.tick);
            if !of_open && self.open.replace((frame.tick, 0, Vec::new())).is_some() {
                self.torn += 1;
            }
            let Some((tick, fields, row)) = &mut self.open else {
                continue;
            };
            let wanted = frame.fields(self.joints);
            for (field, bytes) in wanted.filter(|(field, _)| self.selection.has(*field)) {
                *fields |= field.bit();
                row.extend(numbers(field, bytes));
            }
            if *fields == self.selection.fields {
                let t_s = f64::from(*tick) * self.period_s;
                self.table
                    .row(std::iter::once(t_s).chain(row.iter().copied()))?;
                self.open = None;
                self.whole += 1;
            }
        }
        Ok(())
    }

    /// Completes the table; how many records it has, and how many came with a part missing.
    ///
    /// Errors: the file system's.
    pub fn finish(self) -> io::Result<(u64, u64)> {
        self.table.finish()?;
        Ok((self.whole, self.torn + u64::from(self.open.is_some())))
    }
}

/// Records from which the fields of the stream are found: one of them may have lost a frame.
const FIRST_RECORDS: usize = 8;

/// Takes the bytes that a board sends, and writes its telemetry into a table.
///
/// Fields and joints are found from the records: nothing is sent to the board.
pub struct TelemetryTap {
    path: PathBuf,
    period_s: f64,
    decoder: Decoder,
    /// Frames until the table begins.
    first: Vec<TelemetryFrame>,
    recorder: Option<Recorder>,
}

impl TelemetryTap {
    /// Begins a table at `path` with the first records.
    ///
    /// * `period_s` period of the board; a hello that is read along replaces it
    pub fn new(path: &Path, period_s: f64) -> Self {
        Self {
            path: path.to_owned(),
            period_s,
            decoder: Decoder::new(),
            first: Vec::new(),
            recorder: None,
        }
    }

    /// Takes bytes in the order they came.
    ///
    /// Errors: the file system's.
    pub fn take(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut frames = Vec::new();
        for byte in bytes {
            let Some(Ok(frame)) = self.decoder.push(*byte) else {
                continue;
            };
            // Telemetry and hello do not depend on the number of joints; other messages are of no interest.
            match frame.message::<BoardMessage<1>>() {
                Ok(BoardMessage::Telemetry(frame)) => frames.push(frame),
                Ok(BoardMessage::Hello(hello)) => {
                    self.period_s = f64::from(hello.configuration.period_us) * 1e-6;
                }
                _ => {}
            }
        }
        if let Some(recorder) = &mut self.recorder {
            return recorder.take(&frames);
        }
        self.first.extend(frames);
        let pairs = self.first.windows(2);
        let changes = pairs.filter(|two| two[0].tick != two[1].tick);
        if changes.count() > FIRST_RECORDS {
            self.begin()?;
        }
        Ok(())
    }

    /// Begins the table with the frames so far, the first record left out: its beginning may be missing.
    fn begin(&mut self) -> io::Result<()> {
        let mut first = std::mem::take(&mut self.first);
        let Some(tick) = first.first().map(|frame| frame.tick) else {
            return Ok(());
        };
        if first.iter().any(|frame| frame.tick != tick) {
            first.retain(|frame| frame.tick != tick);
        }
        let fields = first.iter().fold(0, |all, frame| all | frame.fields);
        let joints = first.iter().find_map(joints_of).unwrap_or(1);
        let selection = Selection { fields, every: 1 };
        let mut recorder = Recorder::create(&self.path, selection, joints, self.period_s)?;
        recorder.take(&first)?;
        self.recorder = Some(recorder);
        Ok(())
    }

    /// Completes the table; how many records it has and how many came with a part missing. `None` where no telemetry came:
    /// there is no table.
    ///
    /// Errors: the file system's.
    pub fn finish(mut self) -> io::Result<Option<(u64, u64)>> {
        if self.recorder.is_none() {
            self.begin()?;
        }
        self.recorder.map(Recorder::finish).transpose()
    }
}

/// Joints by the length of a frame; `None` where its fields do not depend on them.
fn joints_of(frame: &TelemetryFrame) -> Option<usize> {
    let length = |joints: usize| -> usize {
        let present = Field::ALL.into_iter();
        let present = present.filter(|field| frame.fields & field.bit() != 0);
        present.map(|field| field.bytes(joints)).sum()
    };
    let found = (1..=MAX_JOINTS).find(|joints| length(*joints) == frame.bytes.len());
    found.filter(|_| length(1) != length(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::{Client, Native};
    use foretorque::arm::ur5::Ur5;
    use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
    use foretorque_link::wire::{MAX_FRAME, encode};
    use std::time::Duration;

    #[test]
    fn a_selection_is_read_as_it_is_written() {
        let chosen: Selection = "q,tau/10".parse().expect("two fields");
        let fields = Field::MeasuredPosition.bit() | Field::MeasuredTorque.bit();
        assert_eq!((chosen.fields, chosen.every), (fields, 10));
        let all: Selection = "all/20".parse().expect("all of them");
        assert_eq!(all.fields.count_ones() as usize, Field::ALL.len());
        for wrong in ["", "speed", "state/0", "state/x", "state,/3"] {
            assert!(wrong.parse::<Selection>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn every_field_has_as_many_columns_as_numbers() {
        for (field, (_, own, _)) in Field::ALL.into_iter().zip(FIELDS) {
            assert_eq!(field, own);
            let (fields, every) = (field.bit(), 1);
            let columns = Selection { fields, every }.columns(6);
            let bytes = vec![0; field.bytes(6)];
            assert_eq!(columns.len(), numbers(field, &bytes).len());
        }
    }

    /// A message of the board, as it stands on the line.
    fn sent(message: BoardMessage<6>) -> Vec<u8> {
        let mut buffer = [0; MAX_FRAME];
        let frame = encode(0, &message, &mut buffer);
        frame.expect("it fits").to_vec()
    }

    #[test]
    fn what_is_read_along_is_what_the_host_records() {
        let native = Box::new(Native::<Ur5, 6, 40>::new().expect("the arm's limits are usable"));
        let boot = Duration::from_secs(1);
        let mut board = Client::<6>::connect::<Ur5, 40>(native, boot).expect("it answers");
        let selection: Selection = "all/20".parse().expect("all fields");
        let streams = board.stream(selection.fields, selection.every);
        streams.expect("it has the bandwidth");
        let mut frames = Vec::new();
        for tick in 0..2000 {
            let mut desired = JointMotion::<6>::zero();
            desired.q.fill((1e-3 * tick as f32).sin() * 0.1);
            let tau = JointVector::zeros();
            let measured = Some(JointMeasurement { q: desired.q, tau });
            let answer = board.sample(&JointSample { desired, measured });
            answer.expect("it answers");
            frames.extend(board.take_telemetry());
        }
        let here = tempfile::tempdir().expect("it can be created");
        let files = ["own.csv", "along.csv", "cut.csv"];
        let [own, along, cut] = files.map(|name| here.path().join(name));
        let recorded = |path: &Path, frames: &[TelemetryFrame]| {
            let mut recorder = Recorder::create(path, selection, 6, 1e-3)?;
            recorder.take(frames)?;
            recorder.finish()
        };
        let whole = recorded(&own, &frames).expect("it can be written");
        assert_eq!(whole, (100, 0));
        // The last record has lost its last frame.
        let begun = recorded(&cut, &frames[..frames.len() - 1]);
        assert_eq!(begun.expect("it can be written"), (99, 1));
        let mut bytes = sent(BoardMessage::Hello(board.hello().clone()));
        let frames = frames.into_iter().map(BoardMessage::Telemetry);
        bytes.extend(frames.flat_map(sent));
        let mut telemetry_tap = TelemetryTap::new(&along, 0.5);
        for part in bytes.chunks(37) {
            telemetry_tap.take(part).expect("it can be written");
        }
        let whole = telemetry_tap.finish().expect("it can be written");
        assert_eq!(whole, Some((99, 0)));
        let lines = |path: &Path| -> Vec<String> {
            let text = std::fs::read_to_string(path).expect("it is there");
            text.lines().map(str::to_owned).collect()
        };
        let (mut own, along) = (lines(&own), lines(&along));
        // The first record.
        own.remove(1);
        assert!(own == along, "{} {}", own.len(), along.len());
        assert!(here.path().join("along.mcap").exists());
        let silent = TelemetryTap::new(&here.path().join("none.csv"), 1e-3);
        assert_eq!(silent.finish().expect("no file"), None);
    }
}
