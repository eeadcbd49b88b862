//! Telemetry: which fields a record may have, and the frame that carries some of them.

use serde::{Deserialize, Serialize};

/// Bytes of fields that one frame carries at most.
pub const TELEMETRY_BYTES: usize = 160;

/// Telemetry fields of a tick. The bit of a field is `1 << field as u16`; fields stand in a frame in this order, little endian, without padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Field {
    /// Flags (u16), safety state (u8), safety reason (u8).
    State = 0,
    /// Torque that left, N × f32, N·m.
    Total = 1,
    /// Rigid-body share, N × f32, N·m.
    Rigid = 2,
    /// Friction share, N × f32, N·m.
    Friction = 3,
    /// Network share, N × f32, N·m.
    Network = 4,
    /// Desired position, N × f32, rad.
    DesiredPosition = 5,
    /// Desired velocity, N × f32, rad/s.
    DesiredVelocity = 6,
    /// Measured position, N × f32, rad; NaN where it was not measured or not believed.
    MeasuredPosition = 7,
    /// Measured torque, N × f32, N·m; NaN likewise.
    MeasuredTorque = 8,
    /// RMS residual of every joint over the last seconds, N × f32, parts of the torque limit.
    Residual = 9,
    /// Trust (f32, 0 to 1), information (f32, 0 to 1), payload (f32, kg), phase of the guard (u8).
    Quality = 10,
    /// Number of decisions (u32), then of the newest: reason (u8), joint (u8, 255 = the arm), figure (f32).
    Decision = 11,
    /// Cost of the last tick and mean cost of a lesson (2 × u32), counts of the board's counter.
    Cost = 12,
    /// Lost: frames missed, frames refused, replies, overruns (4 × u16, of counters that wrap).
    Loss = 13,
    /// Motor temperatures, N × i8, °C; -128 where not known.
    Temperature = 14,
}

impl Field {
    /// All fields, in the order of their bits.
    pub const ALL: [Self; 15] = [
        Self::State,
        Self::Total,
        Self::Rigid,
        Self::Friction,
        Self::Network,
        Self::DesiredPosition,
        Self::DesiredVelocity,
        Self::MeasuredPosition,
        Self::MeasuredTorque,
        Self::Residual,
        Self::Quality,
        Self::Decision,
        Self::Cost,
        Self::Loss,
        Self::Temperature,
    ];

    /// Its bit in a mask.
    pub const fn bit(self) -> u16 {
        1 << self as u16
    }

    /// Its bytes for `joints` joints.
    pub const fn bytes(self, joints: usize) -> usize {
        match self {
            Self::State => 4,
            Self::Quality => 13,
            Self::Decision => 10,
            Self::Cost | Self::Loss => 8,
            Self::Temperature => joints,
            _ => 4 * joints,
        }
    }
}

/// Some fields of one tick; the others of the same record come in frames with the same tick.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TelemetryFrame {
    /// Counter of the tick.
    #[serde(with = "postcard::fixint::le")]
    pub tick: u32,
    /// Which fields.
    #[serde(with = "postcard::fixint::le")]
    pub fields: u16,
    /// Their bytes.
    pub bytes: heapless::Vec<u8, TELEMETRY_BYTES>,
}

impl TelemetryFrame {
    /// The fields with their bytes, in order; ends early where bytes are missing.
    ///
    /// * `joints` joints of the board
    pub fn fields(&self, joints: usize) -> impl Iterator<Item = (Field, &[u8])> {
        let mut rest = self.bytes.as_slice();
        let present = Field::ALL
            .into_iter()
            .filter(|field| self.fields & field.bit() != 0);
        present.map_while(move |field| {
            let (bytes, behind) = rest.split_at_checked(field.bytes(joints))?;
            rest = behind;
            Some((field, bytes))
        })
    }
}
