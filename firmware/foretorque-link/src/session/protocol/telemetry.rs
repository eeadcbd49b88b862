//! Telemetry: records of selected fields, sent in the bytes that each tick leaves on the link.

use crate::session::controller::TickResult;
use crate::wire::{
    BoardMessage, Field, FrameBuffer, NackReason, TELEMETRY_BYTES, TelemetryFrame, size,
};
use foretorque::joint::JointVector;
use foretorque::learning::LearnerReport;
use heapless::Vec;

/// Bytes of all fields of eight joints, rounded up.
const RECORD_BYTES: usize = 352;

/// Sources of one record.
pub(in crate::session) struct Instant<'t, const N: usize> {
    pub(in crate::session) tick: &'t TickResult<N>,
    pub(in crate::session) report: &'t LearnerReport<N>,
    /// Mean cost of a learning step, counts of the board's counter.
    pub(in crate::session) learn_cost: u32,
    pub(in crate::session) losses: [u16; 4],
    pub(in crate::session) temperatures_c: &'t [i8; N],
}

/// One stream, and the record that is being sent.
#[derive(Default)]
pub(in crate::session) struct Stream {
    fields: u16,
    every: u16,
    /// Bytes that may be sent in one tick.
    allowance: usize,
    tick: u32,
    /// Fields of the record that are not sent yet; their bytes are at the end of it.
    unsent: u16,
    record: Vec<u8, RECORD_BYTES>,
    sent: usize,
    /// Records that were not sent whole: the reply buffer was full, or the next record came first.
    pub(in crate::session) lost: u32,
}

impl Stream {
    pub(in crate::session) fn end(&mut self) {
        *self = Self {
            lost: self.lost,
            ..Self::default()
        };
    }

    /// `tick` is one that is recorded.
    pub(in crate::session) fn due(&self, tick: u32) -> bool {
        self.fields != 0 && tick.is_multiple_of(u32::from(self.every.max(1)))
    }

    /// Starts the stream of `fields`; no fields end it.
    ///
    /// * `allowance` bytes of telemetry that the link carries in one tick
    ///
    /// Errors: [`NackReason::Bandwidth`] where a record is not sent before the next one is due.
    pub(in crate::session) fn begin<const N: usize>(
        &mut self,
        fields: u16,
        every: u16,
        allowance: usize,
    ) -> Result<(), NackReason> {
        let fields = fields & ((1 << Field::ALL.len()) - 1);
        if fields != 0 {
            let needed = ticks_needed(fields, N, allowance);
            if needed == 0 || needed > every {
                return Err(NackReason::Bandwidth { every: needed });
            }
        }
        self.end();
        (self.fields, self.every, self.allowance) = (fields, every, allowance);
        Ok(())
    }

    pub(in crate::session) fn record<const N: usize>(&mut self, instant: &Instant<'_, N>) {
        if self.unsent != 0 {
            self.lost = self.lost.saturating_add(1);
        }
        (self.tick, self.unsent, self.sent) = (instant.tick.torque.tick, self.fields, 0);
        self.record.clear();
        for field in Field::ALL {
            if self.fields & field.bit() != 0 {
                write(&mut self.record, field, instant);
            }
        }
    }

    /// Sends the rest of the record, within the allowance of one tick.
    pub(in crate::session) fn send<const N: usize>(&mut self, out: &mut FrameBuffer) {
        let mut left = self.allowance;
        while let Some(frame) = self.next(N, left) {
            left = left.saturating_sub(size::telemetry(frame.bytes.len()));
            if out.push(0, &BoardMessage::<N>::Telemetry(frame)).is_err() {
                self.lost = self.lost.saturating_add(1);
                self.unsent = 0;
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

/// Ticks that a record of `fields` takes to send; 0 when it never ends.
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

/// Appends one field. The record holds all fields, so nothing is cut off.
fn write<const N: usize>(
    record: &mut Vec<u8, RECORD_BYTES>,
    field: Field,
    instant: &Instant<'_, N>,
) {
    let (tick, torque) = (instant.tick, &instant.tick.torque);
    let quality = &instant.report.quality;
    let measured = tick.sample.as_ref().and_then(|sample| sample.measured);
    let desired = tick.sample.as_ref().map(|sample| &sample.desired);
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
            put(&[tick.status.state as u8, tick.status.reason.code()]);
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
        Field::Cost => {
            for cost in [tick.cost, instant.learn_cost] {
                put(&cost.to_le_bytes());
            }
        }
        Field::Loss => {
            for loss in instant.losses {
                put(&loss.to_le_bytes());
            }
        }
        Field::Temperature => {
            for &celsius in instant.temperatures_c {
                put(&celsius.to_le_bytes());
            }
        }
    }
}
