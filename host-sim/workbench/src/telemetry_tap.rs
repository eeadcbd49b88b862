//! Telemetry read along on a board's line, while another host drives the board.

use crate::telemetry::{Recorder, Selection};
use foretorque_link::bank::MAX_JOINTS;
use foretorque_link::wire::{BoardMessage, Decoder, Field, TelemetryFrame};
use std::io;
use std::path::{Path, PathBuf};

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
