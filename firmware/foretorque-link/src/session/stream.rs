//! Telemetry: records of chosen fields, sent piece by piece into what the line has left.

use super::{Clock, Session};
use crate::safety::SafetyStatus;
use crate::wire::{
    BoardMessage, Field, FrameBuffer, NackReason, ReplyMode, TELEMETRY_BYTES, TelemetryFrame, size,
};
use foretorque::arm::Arm;
use foretorque::feedforward::Torque;
use foretorque::joint::{JointSample, JointVector};
use foretorque::learning::Report;
use heapless::Vec;

/// Room for all fields of eight joints.
const RECORD_BYTES: usize = 352;
/// Bytes of telemetry a tick where there is no line to fill, such as between two processes.
const UNLIMITED: usize = 400;

/// What a record is made from.
pub(super) struct Instant<'t, const N: usize> {
    pub(super) torque: &'t Torque<N>,
    pub(super) status: SafetyStatus,
    pub(super) sample: &'t Option<JointSample<N>>,
    pub(super) report: &'t Report<N>,
    /// Of the tick and of a lesson.
    pub(super) costs: [u32; 2],
    pub(super) losses: [u16; 4],
    pub(super) temperatures_c: &'t [i8; N],
}

/// One stream, and the record that is on its way.
pub(super) struct Stream {
    fields: u16,
    every: u16,
    /// Bytes that may be sent in one tick.
    allowance: usize,
    tick: u32,
    /// Fields of the record that are not sent yet; their bytes are at the end of it.
    unsent: u16,
    record: Vec<u8, RECORD_BYTES>,
    sent: usize,
    lost: u32,
}

impl Stream {
    /// No stream.
    pub(super) const fn new() -> Self {
        Self {
            fields: 0,
            every: 1,
            allowance: 0,
            tick: 0,
            unsent: 0,
            record: Vec::new(),
            sent: 0,
            lost: 0,
        }
    }

    /// Records whose end found no room in the reply buffer, or that the next one overtook.
    pub(super) fn lost(&self) -> u32 {
        self.lost
    }

    /// Ends the stream.
    pub(super) fn end(&mut self) {
        *self = Self {
            lost: self.lost,
            ..Self::new()
        };
    }

    /// This tick is one that is recorded.
    pub(super) fn due(&self, tick: u32) -> bool {
        self.fields != 0 && tick.is_multiple_of(u32::from(self.every.max(1)))
    }

    /// Begins the stream of `fields`, if a record is sent before the next one is due.
    fn begin(
        &mut self,
        fields: u16,
        every: u16,
        joints: usize,
        allowance: usize,
    ) -> Result<(), NackReason> {
        let known = Field::ALL
            .iter()
            .fold(0, |known, field| known | field.bit());
        let fields = fields & known;
        if fields != 0 {
            let needed = ticks_needed(fields, joints, allowance);
            if needed == 0 || needed > every {
                return Err(NackReason::Bandwidth { every: needed });
            }
        }
        self.end();
        (self.fields, self.every, self.allowance) = (fields, every, allowance);
        Ok(())
    }

    /// Takes down the fields of one tick.
    pub(super) fn record<const N: usize>(&mut self, instant: &Instant<'_, N>) {
        if self.unsent != 0 {
            self.lost = self.lost.saturating_add(1);
        }
        (self.tick, self.unsent, self.sent) = (instant.torque.tick, self.fields, 0);
        self.record.clear();
        for field in Field::ALL {
            if self.fields & field.bit() != 0 {
                write(&mut self.record, field, instant);
            }
        }
    }

    /// The next frame of the record, at most `left` bytes on the wire.
    fn next(&mut self, joints: usize, left: usize) -> Option<TelemetryFrame> {
        let (fields, content) = fitting(self.unsent, joints, left);
        if fields == 0 {
            return None;
        }
        let bytes = self.record.get(self.sent..self.sent + content)?;
        let mut frame = TelemetryFrame {
            tick: self.tick,
            fields,
            bytes: Vec::new(),
        };
        frame.bytes.extend_from_slice(bytes).ok()?;
        self.sent += content;
        self.unsent &= !fields;
        Some(frame)
    }
}

/// The first fields of `wanted` that fit one frame of at most `left` bytes on the wire, and their bytes.
fn fitting(wanted: u16, joints: usize, left: usize) -> (u16, usize) {
    let (mut fields, mut content) = (0, 0);
    for field in Field::ALL {
        if wanted & field.bit() == 0 {
            continue;
        }
        let longer = content + field.bytes(joints);
        if longer > TELEMETRY_BYTES || size::telemetry(longer) > left {
            break;
        }
        fields |= field.bit();
        content = longer;
    }
    (fields, content)
}

/// Ticks that sending a record of `fields` takes; 0 when it never ends.
fn ticks_needed(mut fields: u16, joints: usize, allowance: usize) -> u16 {
    for ticks in 1..=Field::ALL.len() as u16 {
        let mut left = allowance;
        loop {
            let (sent, content) = fitting(fields, joints, left);
            if sent == 0 {
                break;
            }
            fields &= !sent;
            left = left.saturating_sub(size::telemetry(content));
        }
        if fields == 0 {
            return ticks;
        }
    }
    0
}

/// Appends one field. The room holds all of them, so nothing is cut.
fn write<const N: usize>(
    record: &mut Vec<u8, RECORD_BYTES>,
    field: Field,
    instant: &Instant<'_, N>,
) {
    let torque = instant.torque;
    let quality = &instant.report.quality;
    let measured = instant.sample.as_ref().and_then(|sample| sample.measured);
    let desired = instant.sample.as_ref().map(|sample| &sample.desired);
    let unknown = JointVector::<N>::repeat(f32::NAN);
    let mut put = |bytes: &[u8]| {
        let _ = record.extend_from_slice(bytes);
    };
    let mut put_vector = |vector: &JointVector<N>| {
        for value in vector.iter() {
            put(&value.to_le_bytes());
        }
    };
    match field {
        Field::State => {
            put(&torque.flags.0.to_le_bytes());
            put(&[instant.status.state as u8, instant.status.reason.code()]);
        }
        Field::Total => put_vector(&torque.total),
        Field::Rigid => put_vector(&torque.shares.rigid),
        Field::Friction => put_vector(&torque.shares.friction),
        Field::Network => put_vector(&torque.shares.network),
        Field::DesiredPosition => put_vector(desired.map_or(&unknown, |desired| &desired.q)),
        Field::DesiredVelocity => put_vector(desired.map_or(&unknown, |desired| &desired.qd)),
        Field::MeasuredPosition => put_vector(&measured.map_or(unknown, |measured| measured.q)),
        Field::MeasuredTorque => put_vector(&measured.map_or(unknown, |measured| measured.tau)),
        Field::Residual => put_vector(&JointVector::from(quality.residual_rms)),
        Field::Quality => {
            for value in [quality.trust, quality.information, quality.payload.mass] {
                put(&value.to_le_bytes());
            }
            put(&[quality.phase as u8]);
        }
        Field::Decision => {
            let decisions = &instant.report.decisions;
            put(&decisions.count().to_le_bytes());
            let newest = decisions.newest();
            let reason = newest.map_or(0, |newest| newest.reason as u8);
            let joint = newest.and_then(|newest| newest.joint);
            put(&[reason, joint.unwrap_or(u8::MAX)]);
            let figure = newest.map_or(0.0, |newest| newest.figure);
            put(&figure.to_le_bytes());
        }
        Field::Cost => instant
            .costs
            .iter()
            .for_each(|cost| put(&cost.to_le_bytes())),
        Field::Loss => instant
            .losses
            .iter()
            .for_each(|loss| put(&loss.to_le_bytes())),
        Field::Temperature => {
            for &celsius in instant.temperatures_c {
                put(&celsius.to_le_bytes());
            }
        }
    }
}

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Begins, changes or ends the stream.
    pub(super) fn stream_telemetry(&mut self, fields: u16, every: u16) -> Result<(), NackReason> {
        let reply = match self.configuration.reply {
            ReplyMode::Decimated => size::torque(N),
            ReplyMode::Full => size::full_torque(N),
        };
        let allowance = match self.board.link_bytes_s {
            0 => UNLIMITED,
            bytes_s => size::left(bytes_s, self.configuration.period_us, reply),
        };
        self.stream.begin(fields, every, N, allowance)
    }

    /// Sends what is left of the record, within what the line has left in this tick.
    pub(super) fn send_telemetry(&mut self, out: &mut FrameBuffer) {
        let mut left = self.stream.allowance;
        while let Some(frame) = self.stream.next(N, left) {
            left = left.saturating_sub(size::telemetry(frame.bytes.len()));
            if out.push(0, &BoardMessage::<N>::Telemetry(frame)).is_err() {
                self.stream.lost = self.stream.lost.saturating_add(1);
                self.stream.unsent = 0;
            }
        }
    }
}
