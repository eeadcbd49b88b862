//! CyberGear and RobStride: classic frames with an extended identifier, `kind << 24 | data << 8 | target`.
//!
//! A command (kind 1) has the torque in the 16 data bits of the identifier, and position, velocity, stiffness and damping
//! in the eight bytes, big endian. A reply (kind 2) has state and faults in the identifier. Sources: CyberGear manual
//! 4.1; RobStride manual, private protocol. The manual's position range is ±4π, its sample code's ±12.5 rad.

use super::frame::{join, nearest};
use super::{
    DriveProfile, DriveState, Event, Frame, Frames, JointCommand, JointReply, Order, Outgoing,
    Ranges, Request, Scale, push,
};

const STEPS: u16 = 0xffff;
/// Register of the mode; 0 is that of motion commands.
const RUN_MODE: u16 = 0x7005;
/// Register of the largest torque, N·m.
const TORQUE_LIMIT: u16 = 0x700b;

mod kind {
    pub(super) const COMMAND: u32 = 1;
    pub(super) const REPLY: u32 = 2;
    pub(super) const ENABLE: u32 = 3;
    pub(super) const STOP: u32 = 4;
    pub(super) const ZERO: u32 = 6;
    pub(super) const READ: u32 = 17;
    pub(super) const WRITE: u32 = 18;
    pub(super) const FAULT: u32 = 21;
    pub(super) const ACTIVE: u32 = 24;
}

fn send(kind: u32, data: u16, target: u16, bytes: [u8; 8], frames: &mut Frames) {
    let id = kind << 24 | u32::from(data) << 8 | u32::from(target & 0xff);
    push(frames, Frame::extended(id, &bytes));
}

fn pack([a, b, c, d]: [u16; 4]) -> [u8; 8] {
    let half = |high: u16, low: u16| (u32::from(high) << 16 | u32::from(low)).to_be_bytes();
    join(half(a, b), half(c, d))
}

fn unpack([a0, a1, b0, b1, c0, c1, d0, d1]: [u8; 8]) -> [u16; 4] {
    [[a0, a1], [b0, b1], [c0, c1], [d0, d1]].map(u16::from_be_bytes)
}

pub(super) struct Codec<'p> {
    pub(super) drive: &'p DriveProfile,
    pub(super) scales: &'p Ranges,
}

impl Codec<'_> {
    pub(super) fn command(&self, command: &JointCommand, out: &mut Outgoing<'_>) {
        let [p, v, kp, kd, torque] = self.scales.codes::<STEPS>(command, out);
        let bytes = pack([p, v, kp, kd]);
        send(kind::COMMAND, torque, self.drive.id, bytes, out.frames);
    }

    pub(super) fn order(&self, order: Order, frames: &mut Frames) -> bool {
        let (host, id) = (self.drive.host_id, self.drive.id);
        if order == Order::Enable {
            // A tool may have left another mode, with a set-point of its own.
            let [low, high] = RUN_MODE.to_le_bytes();
            let mode = [low, high, 0, 0, 0, 0, 0, 0];
            send(kind::WRITE, host, id, mode, frames);
        }
        let (kind, bytes) = match order {
            Order::Enable => (kind::ENABLE, [0; 8]),
            Order::Disable => (kind::STOP, [0; 8]),
            Order::ClearFault => (kind::STOP, [1, 0, 0, 0, 0, 0, 0, 0]),
            Order::SetZero => (kind::ZERO, [1, 0, 0, 0, 0, 0, 0, 0]),
            Order::ReadScale(Scale::Torque) => {
                let [low, high] = TORQUE_LIMIT.to_le_bytes();
                (kind::READ, [low, high, 0, 0, 0, 0, 0, 0])
            }
            Order::ReadScale(_) | Order::Report => return false,
        };
        send(kind, host, id, bytes, frames);
        true
    }

    pub(super) fn decode(&self, frame: &Frame) -> Option<Event> {
        let data = frame.eight().filter(|_| frame.extended)?;
        let own =
            frame.id & 0xffff == u32::from(self.drive.id) << 8 | u32::from(self.drive.host_id);
        let [p, v, t, celsius] = unpack(data);
        match frame.id >> 24 {
            _ if !own => None,
            kind::REPLY | kind::ACTIVE => Some(Event::Reply(JointReply {
                temperature: Some(f32::from(celsius) * 0.1),
                state: Some(match (frame.id >> 16 & 0x3f, frame.id >> 22 & 3) {
                    (0, 2) => DriveState::Enabled,
                    (0, _) => DriveState::Disabled,
                    (faults, _) => DriveState::Fault(faults),
                }),
                ..self.scales.reply::<STEPS>([p, v, t])
            })),
            kind::READ => {
                let [low, high, _, _, value @ ..] = data;
                let value = f32::from_le_bytes(value);
                let known = u16::from_le_bytes([low, high]) == TORQUE_LIMIT && value.is_finite();
                known.then_some(Event::Scale(Scale::Torque, value))
            }
            kind::FAULT => {
                let [faults @ .., _, _, _, _] = data;
                let state = match u32::from_le_bytes(faults) {
                    0 => None,
                    faults => Some(DriveState::Fault(faults)),
                };
                Some(Event::Reply(JointReply {
                    state,
                    ..JointReply::default()
                }))
            }
            _ => None,
        }
    }

    pub(super) fn accept(&self, frame: &Frame) -> Option<Request> {
        let data = frame.eight().filter(|_| frame.extended)?;
        if frame.id & 0xff != u32::from(self.drive.id) {
            return None;
        }
        let [p, v, kp, kd] = unpack(data);
        let order = match frame.id >> 24 {
            kind::COMMAND => {
                let torque = (frame.id >> 8) as u16;
                let command = self.scales.command::<STEPS>([p, v, kp, kd, torque]);
                return Some(Request::Command(command));
            }
            kind::ENABLE => Order::Enable,
            kind::STOP if data.starts_with(&[1]) => Order::ClearFault,
            kind::STOP => Order::Disable,
            kind::ZERO => Order::SetZero,
            kind::READ if data.starts_with(&TORQUE_LIMIT.to_le_bytes()) => {
                Order::ReadScale(Scale::Torque)
            }
            _ => return None,
        };
        Some(Request::Order(order))
    }

    pub(super) fn reply(&self, reply: &JointReply, frames: &mut Frames) {
        let [p, v, t] = self.scales.reply_codes::<STEPS>(reply);
        let celsius = nearest(reply.temperature.unwrap_or_default() * 10.0);
        let bytes = pack([p, v, t, celsius.clamp(0, STEPS.into()) as u16]);
        let state = match reply.state.unwrap_or_default() {
            DriveState::Enabled => 2 << 14,
            DriveState::Fault(faults) => (faults.clamp(1, 0x3f) as u16) << 8,
            _ => 0,
        };
        let id = kind::REPLY << 24 | u32::from(state | self.drive.id & 0xff) << 8;
        push(
            frames,
            Frame::extended(id | u32::from(self.drive.host_id), &bytes),
        );
    }

    pub(super) fn reply_scale(&self, _: Scale, value: f32, frames: &mut Frames) {
        let [low, high] = TORQUE_LIMIT.to_le_bytes();
        let bytes = join([low, high, 0, 0], value.to_le_bytes());
        send(kind::READ, self.drive.id, self.drive.host_id, bytes, frames);
    }
}

/// Adds steps to the torque in the identifier of a motion command; saturates.
pub(super) fn add_torque(frame: &mut Frame, steps: i32) {
    let code = (frame.id >> 8 & 0xffff) as i32;
    let code = (code + steps).clamp(0, STEPS.into()) as u32;
    frame.id = frame.id & 0xff00_00ff | code << 8;
}
