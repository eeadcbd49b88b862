//! CAN frames, classic and FD, and the packed integers in them: scaling, saturation, rounding error.

use super::{JointCommand, JointReply, Outgoing, Ranges};
use crate::copy;
use core::fmt;
pub(super) use foretorque::math::nearest;

/// One CAN frame, classic (at most 8 bytes) or FD (at most 64).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// Identifier: 11 bits, or 29 where [`Self::extended`] is set.
    pub id: u32,
    /// Identifier of 29 bits.
    pub extended: bool,
    /// CAN-FD frame with the faster data phase.
    pub fd: bool,
    /// Remote frame, which asks for the frame of this identifier and has no data.
    pub remote: bool,
    length: u8,
    data: [u8; Self::CAPACITY],
}

impl Frame {
    /// Largest number of bytes of a CAN-FD frame.
    pub const CAPACITY: usize = 64;
    /// Largest standard identifier.
    pub const STANDARD_MAX: u32 = 0x7ff;
    /// Largest extended identifier.
    pub const EXTENDED_MAX: u32 = 0x1fff_ffff;

    /// [`new`](Self::new) with an identifier of 11 bits.
    pub fn standard(id: u32, bytes: &[u8]) -> Self {
        Self::new(id, false, bytes)
    }

    /// [`new`](Self::new) with an identifier of 29 bits.
    pub fn extended(id: u32, bytes: &[u8]) -> Self {
        Self::new(id, true, bytes)
    }

    /// Remote frame with an identifier of 11 bits, cut to them.
    pub fn remote(id: u32) -> Self {
        let mut frame = Self::standard(id, &[]);
        frame.remote = true;
        frame
    }

    /// This frame as CAN-FD, padded with `padding` to the next length that CAN-FD has.
    #[must_use]
    pub fn into_fd(mut self, padding: u8) -> Self {
        self.fd = true;
        let mut longer = [12, 16, 20, 24, 32, 48].into_iter();
        let length = match self.length {
            0..=8 => self.length,
            used => longer.find(|&length| length >= used).unwrap_or(64),
        };
        let tail = self.data.get_mut(self.length.into()..length.into());
        tail.unwrap_or_default().fill(padding);
        self.length = length;
        self
    }

    /// Classic frame; the identifier is cut to its bits, and bytes beyond [`Self::CAPACITY`] are left out.
    pub fn new(id: u32, extended: bool, bytes: &[u8]) -> Self {
        let most = if extended {
            Self::EXTENDED_MAX
        } else {
            Self::STANDARD_MAX
        };
        let mut data = [0; Self::CAPACITY];
        copy(&mut data, bytes);
        Self {
            id: id & most,
            extended,
            fd: false,
            remote: false,
            length: bytes.len().min(Self::CAPACITY) as u8,
            data,
        }
    }

    /// The data bytes.
    pub fn bytes(&self) -> &[u8] {
        self.data.get(..self.length.into()).unwrap_or_default()
    }

    /// The data bytes, to change in place.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        self.data.get_mut(..self.length.into()).unwrap_or_default()
    }

    /// The eight bytes of a classic frame of full length; `None` for any other frame.
    pub fn eight(&self) -> Option<[u8; 8]> {
        if self.remote {
            return None;
        }
        self.bytes().try_into().ok()
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = if self.extended { 8 } else { 3 };
        write!(f, "{:0width$X}", self.id)?;
        f.write_str(match (self.fd, self.remote) {
            (true, _) => "##",
            (false, true) => "#R",
            (false, false) => "#",
        })?;
        self.bytes()
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

/// `value` within `low` and `high`; not a number stays one.
pub(super) fn within(value: f32, low: f32, high: f32) -> f32 {
    if value < low {
        low
    } else if value > high {
        high
    } else {
        value
    }
}

/// Rounding errors of one joint's last command, carried over to its next one, in steps of their fields.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Carry {
    pub(super) velocity: f32,
    pub(super) torque: f32,
}

/// Integer nearest to `value + carry` within `low` and `high`; keeps the rounding error in `carry`.
pub(super) fn carried(value: f32, carry: &mut f32, low: i32, high: i32) -> i32 {
    let wanted = value + *carry;
    let code = nearest(wanted).max(low).min(high);
    *carry = (wanted - code as f32).clamp(-0.5, 0.5);
    code
}

/// Code of `value` in a field of `steps` steps from −`scale` to +`scale`, not rounded.
fn centred(value: f32, scale: f32, steps: u16) -> f32 {
    (value + scale) * f32::from(steps) / (2.0 * scale)
}

/// Value of a code of such a field.
fn from_centred(code: u16, scale: f32, steps: u16) -> f32 {
    f32::from(code) * (2.0 * scale) / f32::from(steps) - scale
}

pub(super) fn join([a0, a1, a2, a3]: [u8; 4], [b0, b1, b2, b3]: [u8; 4]) -> [u8; 8] {
    [a0, a1, a2, a3, b0, b1, b2, b3]
}

/// Eight bytes of two numbers, little endian.
pub(super) fn pair(first: f32, second: f32) -> [u8; 8] {
    join(first.to_le_bytes(), second.to_le_bytes())
}

/// The two numbers of eight bytes, little endian.
pub(super) fn unpair(data: [u8; 8]) -> (f32, f32) {
    let bits = u64::from_le_bytes(data);
    (
        f32::from_bits(bits as u32),
        f32::from_bits((bits >> 32) as u32),
    )
}

/// Steps of the position in a frame of packed integers; the other fields have `STEPS`.
const POSITION_STEPS: u16 = 0xffff;

impl Ranges {
    /// Codes of a command: position, velocity, stiffness, damping, torque.
    pub(super) fn codes<const STEPS: u16>(
        &self,
        command: &JointCommand,
        out: &mut Outgoing<'_>,
    ) -> [u16; 5] {
        let command = self.clamp(command);
        let code = |value: f32, scale: f32, carry: &mut f32| {
            carried(centred(value, scale, STEPS), carry, 0, STEPS.into()) as u16
        };
        let gain = |value: f32, scale: f32| nearest(value * f32::from(STEPS) / scale) as u16;
        let position = centred(command.position, self.position, POSITION_STEPS);
        [
            nearest(position) as u16,
            code(command.velocity, self.velocity, &mut out.carry.velocity),
            gain(command.kp, self.kp),
            gain(command.kd, self.kd),
            code(command.torque, self.torque, &mut out.carry.torque),
        ]
    }

    /// Command of such codes.
    pub(super) fn command<const STEPS: u16>(&self, [p, v, kp, kd, t]: [u16; 5]) -> JointCommand {
        JointCommand {
            position: from_centred(p, self.position, POSITION_STEPS),
            velocity: from_centred(v, self.velocity, STEPS),
            torque: from_centred(t, self.torque, STEPS),
            kp: f32::from(kp) * self.kp / f32::from(STEPS),
            kd: f32::from(kd) * self.kd / f32::from(STEPS),
        }
    }

    /// Codes of the position, velocity and torque of a reply; an absent one counts as 0.
    pub(super) fn reply_codes<const STEPS: u16>(&self, reply: &JointReply) -> [u16; 3] {
        let code = |value: Option<f32>, scale: f32, steps: u16| {
            nearest(centred(value.unwrap_or_default(), scale, steps)).clamp(0, steps.into()) as u16
        };
        [
            code(reply.position, self.position, POSITION_STEPS),
            code(reply.velocity, self.velocity, STEPS),
            code(reply.torque, self.torque, STEPS),
        ]
    }

    /// Reply of such codes.
    pub(super) fn reply<const STEPS: u16>(&self, [p, v, t]: [u16; 3]) -> JointReply {
        JointReply {
            position: Some(from_centred(p, self.position, POSITION_STEPS)),
            velocity: Some(from_centred(v, self.velocity, STEPS)),
            torque: Some(from_centred(t, self.torque, STEPS)),
            ..JointReply::default()
        }
    }

    /// A command in the coordinates of the drive within the fields.
    fn clamp(&self, command: &JointCommand) -> JointCommand {
        let within_both = |value, most: f32| within(value, -most, most);
        JointCommand {
            position: within_both(command.position, self.position),
            velocity: within_both(command.velocity, self.velocity),
            torque: within_both(command.torque, self.torque),
            kp: within(command.kp, 0.0, self.kp),
            kd: within(command.kd, 0.0, self.kd),
        }
    }
}
