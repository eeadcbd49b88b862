//! Telemetry of a board as a table: one row a record, one column a number, with `t_s` in front.

use crate::table::{TableWriter, joint_columns};
use foretorque_link::wire::{Field, TelemetryFrame};
use std::io;
use std::path::Path;
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
