//! MIT frame of eight bytes, and the replies of Ben Katz' drive and of Damiao.
//!
//! | bytes | field |
//! |---|---|
//! | 0–1 | position, 16 bits, big endian, as all fields |
//! | 2–3 | velocity, 12 bits; stiffness, upper 4 bits |
//! | 4–5 | stiffness, lower 8 bits; damping, upper 8 bits |
//! | 6–7 | damping, lower 4 bits; torque, 12 bits |
//!
//! Sources: bgkatz/motorcontrol `can.cpp`; Damiao's DM-J manual.

use super::frame::join;
use super::{
    DriveProfile, DriveState, Event, Frame, Frames, JointCommand, JointReply, Order, Outgoing,
    Ranges, Request, Scale, push,
};

/// Steps of all fields but the position.
const STEPS: u16 = 0xfff;
/// Identifier of Damiao's register frames.
const REGISTERS: u32 = 0x7ff;
const READ: u8 = 0x33;
/// First bytes of an order.
const PREFIX: [u8; 7] = [0xff; 7];

pub(super) struct Codec<'p> {
    pub(super) drive: &'p DriveProfile,
    pub(super) scales: &'p Ranges,
    /// With registers, status and clearing of faults.
    pub(super) damiao: bool,
}

impl Codec<'_> {
    pub(super) fn command(&self, command: &JointCommand, out: &mut Outgoing<'_>) {
        let [p, v, kp, kd, t] = self.scales.codes::<STEPS>(command, out);
        let mut data = pack([p, v, kp, kd, t]);
        if data.starts_with(&PREFIX) {
            // Seven bytes of 0xff are the prefix of an order.
            data = pack([p.saturating_sub(1), v, kp, kd, t]);
        }
        push(out.frames, Frame::standard(self.drive.id.into(), &data));
    }

    pub(super) fn order(&self, order: Order, frames: &mut Frames) -> bool {
        let [low, high] = self.drive.id.to_le_bytes();
        let registers = |kind, index| (REGISTERS, join([low, high, kind, index], [0; 4]));
        let own = |last| {
            (
                self.drive.id.into(),
                join([0xff; 4], [0xff, 0xff, 0xff, last]),
            )
        };
        let (id, data) = match (order, self.damiao) {
            (Order::Enable, _) => own(0xfc),
            (Order::Disable, _) => own(0xfd),
            (Order::SetZero, _) => own(0xfe),
            (Order::ClearFault, true) => own(0xfb),
            (Order::ReadScale(scale), true) => registers(READ, register(scale)),
            (Order::Report, true) => registers(0xcc, 0),
            (Order::ClearFault | Order::ReadScale(_) | Order::Report, false) => return false,
        };
        push(frames, Frame::standard(id, &data));
        true
    }

    pub(super) fn decode(&self, frame: &Frame) -> Option<Event> {
        if !plain(frame, self.drive.host_id) {
            return None;
        }
        if !self.damiao {
            let (&[id, p0, p1, v, vt, t], _) = frame.bytes().split_first_chunk()?;
            let own = u16::from(id) == self.drive.id;
            return own.then(|| Event::Reply(self.measured([p0, p1, v, vt, t])));
        }
        let data = frame.eight()?;
        let [low, high, kind, index, value @ ..] = data;
        if kind == READ
            && u16::from_le_bytes([low, high]) == self.drive.id
            && let Some(scale) = scale_of(index)
        {
            let value = f32::from_le_bytes(value);
            return value.is_finite().then_some(Event::Scale(scale, value));
        }
        let [first, p0, p1, v, vt, t, mosfet, rotor] = data;
        if u16::from(first & 0xf) != self.drive.id & 0xf {
            return None;
        }
        let state = match first >> 4 {
            0 => DriveState::Disabled,
            1 => DriveState::Enabled,
            code => DriveState::Fault(code.into()),
        };
        let reply = JointReply {
            temperature: Some(mosfet.max(rotor).into()),
            state: Some(state),
            ..self.measured([p0, p1, v, vt, t])
        };
        Some(Event::Reply(reply))
    }

    pub(super) fn accept(&self, frame: &Frame) -> Option<Request> {
        let data = frame.eight()?;
        if self.damiao && plain(frame, REGISTERS as u16) {
            let [low, high, kind, index, ..] = data;
            let own = u16::from_le_bytes([low, high]) == self.drive.id;
            let order = match kind {
                READ => Order::ReadScale(scale_of(index)?),
                0xcc => Order::Report,
                _ => return None,
            };
            return own.then_some(Request::Order(order));
        }
        if !plain(frame, self.drive.id) {
            return None;
        }
        if let [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, last] = data {
            match last {
                0xfc => return Some(Request::Order(Order::Enable)),
                0xfd => return Some(Request::Order(Order::Disable)),
                0xfe => return Some(Request::Order(Order::SetZero)),
                0xfb if self.damiao => return Some(Request::Order(Order::ClearFault)),
                _ => {}
            }
        }
        let command = self.scales.command::<STEPS>(unpack(data));
        Some(Request::Command(command))
    }

    pub(super) fn reply(&self, reply: &JointReply, frames: &mut Frames) {
        let status = match reply.state.unwrap_or_default() {
            DriveState::Enabled => 1,
            DriveState::Fault(code) => code.clamp(2, 15) as u8,
            _ => 0,
        };
        let [p, v, t] = self.scales.reply_codes::<STEPS>(reply);
        let (id, [p0, p1, .., v, vt, t]) = (self.drive.id as u8, pack([p, 0, 0, v, t]));
        let celsius = reply.temperature.unwrap_or_default() as u8;
        let damiao = [status << 4 | id & 0xf, p0, p1, v, vt, t, celsius, celsius];
        let mini_cheetah = [id, p0, p1, v, vt, t];
        let data: &[u8] = if self.damiao { &damiao } else { &mini_cheetah };
        push(frames, Frame::standard(self.drive.host_id.into(), data));
    }

    pub(super) fn reply_scale(&self, scale: Scale, value: f32, frames: &mut Frames) {
        if !self.damiao {
            return;
        }
        let [low, high] = self.drive.id.to_le_bytes();
        let data = join([low, high, READ, register(scale)], value.to_le_bytes());
        push(frames, Frame::standard(self.drive.host_id.into(), &data));
    }

    /// Content of a reply's five bytes: position, velocity, torque.
    fn measured(&self, [p0, p1, v, vt, t]: [u8; 5]) -> JointReply {
        let [p, .., v, t] = unpack([p0, p1, 0, 0, 0, v, vt, t]);
        self.scales.reply::<STEPS>([p, v, t])
    }
}

/// Bytes of position, velocity, stiffness, damping and torque.
fn pack(codes: [u16; 5]) -> [u8; 8] {
    let [p, v, kp, kd, t] = codes.map(u32::from);
    let (high, low) = (p << 16 | v << 4 | kp >> 8, kp << 24 | kd << 12 | t);
    join(high.to_be_bytes(), low.to_be_bytes())
}

fn unpack([p0, p1, v, vk, kp, kd, kt, t]: [u8; 8]) -> [u16; 5] {
    let high = u32::from_be_bytes([0, v, vk, kp]);
    let low = u32::from_be_bytes([0, kd, kt, t]);
    let [v, kp, kd, t] = [high >> 12, high, low >> 12, low].map(|code| code as u16 & STEPS);
    [u16::from_be_bytes([p0, p1]), v, kp, kd, t]
}

/// Register of the first range.
const RANGES: u8 = 21;

const fn register(scale: Scale) -> u8 {
    RANGES + scale as u8
}

fn scale_of(register: u8) -> Option<Scale> {
    let place = usize::from(register.checked_sub(RANGES)?);
    Scale::ALL.get(place).copied()
}

fn plain(frame: &Frame, id: u16) -> bool {
    !frame.extended && !frame.remote && frame.id == u32::from(id)
}

/// Adds steps to the torque of a motion command; saturates. A frame that is an order, or would become one, stays.
pub(super) fn add_torque(frame: &mut Frame, steps: i32) {
    let Ok(data) = <&mut [u8; 8]>::try_from(frame.bytes_mut()) else {
        return;
    };
    let [p, v, kp, kd, t] = unpack(*data);
    let t = (i32::from(t) + steps).clamp(0, STEPS.into()) as u16;
    let sum = pack([p, v, kp, kd, t]);
    if !data.starts_with(&PREFIX) && !sum.starts_with(&PREFIX) {
        *data = sum;
    }
}
