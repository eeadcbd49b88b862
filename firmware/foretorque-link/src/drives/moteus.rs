//! moteus: registers written and read by subframes of one CAN-FD frame, little endian.
//!
//! A command writes mode 10, position, velocity, torque and the scales of stiffness and damping (0x020 to 0x024), and the
//! watchdog (0x027); it then reads mode, position, velocity and torque (0x000 to 0x003), temperature and fault (0x00e,
//! 0x00f). Turns and turns/s at the output, N·m. Source: mjbots/moteus, docs/protocol.

use super::frame::{carried, nearest};
use super::{
    DriveProfile, DriveState, Event, Frame, Frames, JointCommand, JointReply, Moteus, Order,
    Outgoing, Request, Resolution, Scale, TURN, push, within,
};
use crate::copy;

fn query(bytes: &mut Bytes, resolution: Resolution) {
    let form = form(resolution);
    put(bytes, &[READ | 1, MODE as u8, READ | form | 3, 1]);
    put(bytes, &[READ | 2, TEMPERATURE as u8]);
}

pub(super) struct Codec<'p> {
    pub(super) drive: &'p DriveProfile,
    pub(super) scales: &'p Moteus,
}

impl Codec<'_> {
    fn send(&self, bytes: &[u8], frames: &mut Frames) {
        let id =
            0x8000 | u32::from(self.drive.host_id & 0x7f) << 8 | u32::from(self.drive.id & 0x7f);
        push(frames, Frame::extended(id, bytes).into_fd(NOP));
    }

    pub(super) fn command(&self, motion: &JointCommand, out: &mut Outgoing<'_>) {
        let resolution = self.scales.resolution;
        let [position, velocity, torque] = resolution.steps();
        let unit = match resolution {
            Resolution::Int16 => 1.0 / 32767.0,
            _ => 1.0 / 2_147_483_647.0,
        };
        let mut bytes = Bytes::new();
        put(&mut bytes, &[WRITE | 1, MODE as u8, POSITION]);
        put(&mut bytes, &[WRITE | form(resolution), 5, COMMAND as u8]);
        let kp = motion.kp * TURN / self.scales.kp;
        let kd = motion.kd * TURN / self.scales.kd;
        let most = resolution.largest_scale();
        let kp = within(kp, 0.0, most);
        let kd = within(kd, 0.0, most);
        let (turns, speed) = (motion.position / TURN, motion.velocity / TURN);
        let (of_velocity, of_torque) = (&mut out.carry.velocity, &mut out.carry.torque);
        for (value, step, carry) in [
            (turns, position, &mut 0.0),
            (speed, velocity, of_velocity),
            (motion.torque, torque, of_torque),
            (kp, unit, &mut 0.0),
            (kd, unit, &mut 0.0),
        ] {
            write(&mut bytes, resolution, value, step, carry);
        }
        put(&mut bytes, &[WRITE | 0x0d, WATCHDOG as u8]);
        put(&mut bytes, &self.scales.watchdog_s.to_le_bytes());
        query(&mut bytes, resolution);
        self.send(&bytes, out.frames);
    }

    pub(super) fn order(&self, order: Order, frames: &mut Frames) -> bool {
        let mut bytes = Bytes::new();
        match order {
            // Mode 0 also clears a fault and a time-out.
            Order::Disable | Order::ClearFault => {
                put(&mut bytes, &[WRITE | 1, MODE as u8, STOPPED]);
            }
            Order::Enable => {
                self.send(&[WRITE | 1, MODE as u8, STOPPED], frames);
                // Without a position the drive holds the present one, here with gain scales and torque of 0.
                put(&mut bytes, &[WRITE | 1, MODE as u8, POSITION]);
                put(&mut bytes, &[WRITE | 2, 0x23, 0, 0]);
            }
            Order::SetZero => {
                let [r0, r1] = SET_OUTPUT;
                put(&mut bytes, &[WRITE | 0x0d, r0, r1, 0, 0, 0, 0]);
            }
            Order::Report => {}
            Order::ReadScale(_) => return false,
        }
        query(&mut bytes, self.scales.resolution);
        self.send(&bytes, frames);
        true
    }

    pub(super) fn decode(&self, frame: &Frame) -> Option<Event> {
        let from = u32::from(self.drive.id & 0x7f) << 8 | u32::from(self.drive.host_id & 0x7f);
        if frame.remote || frame.id & 0x7fff != from {
            return None;
        }
        let mut reply = JointReply::default();
        let (mut mode, mut fault, mut any) = (None, 0, false);
        let whole = each(frame.bytes(), REPLY, |register, value, _| {
            any = true;
            match register {
                MODE => mode = Some(value.count() as u8),
                1 => reply.position = value.scaled(0.01, 1e-4, 1e-5).map(|turns| turns * TURN),
                2 => reply.velocity = value.scaled(0.1, 2.5e-4, 1e-5).map(|turns| turns * TURN),
                3 => reply.torque = value.scaled(0.5, 0.01, 1e-3),
                TEMPERATURE => reply.temperature = value.scaled(1.0, 0.1, 1e-3),
                FAULT => fault = value.count(),
                _ => {}
            }
        });
        reply.state = mode.map(|mode| match mode {
            STOPPED => DriveState::Disabled,
            FAULTED => DriveState::Fault(fault.max(1)),
            TIMED_OUT => DriveState::Fault(TIMED_OUT.into()),
            _ => DriveState::Enabled,
        });
        (whole && any).then_some(Event::Reply(reply))
    }

    pub(super) fn accept(&self, frame: &Frame) -> Option<Request> {
        if frame.remote || frame.id & 0x7f != u32::from(self.drive.id) || frame.id & 0x80 != 0 {
            return None;
        }
        let mut motion = JointCommand {
            kp: self.scales.kp / TURN,
            kd: self.scales.kd / TURN,
            ..JointCommand::default()
        };
        let (mut mode, mut zero, mut position) = (None, false, None);
        let whole = each(frame.bytes(), WRITE, |register, value, _| {
            let unit = value.scaled(1.0 / 127.0, 1.0 / 32767.0, 1.0 / 2_147_483_647.0);
            match register {
                MODE => mode = Some(value.count() as u8),
                COMMAND => position = value.scaled(0.01, 1e-4, 1e-5),
                0x021 => motion.velocity = value.scaled(0.1, 2.5e-4, 1e-5).unwrap_or(0.0) * TURN,
                TORQUE => motion.torque = value.scaled(0.5, 0.01, 1e-3).unwrap_or(0.0),
                0x023 => motion.kp = unit.unwrap_or(1.0) * self.scales.kp / TURN,
                0x024 => motion.kd = unit.unwrap_or(1.0) * self.scales.kd / TURN,
                0x130 | 0x131 => zero = true,
                _ => {}
            }
        });
        match mode {
            _ if !whole => None,
            Some(POSITION) => match position {
                Some(turns) => {
                    motion.position = turns * TURN;
                    Some(Request::Command(motion))
                }
                None => {
                    (motion.kp == 0.0 && motion.kd == 0.0).then_some(Request::Order(Order::Enable))
                }
            },
            Some(STOPPED) => Some(Request::Order(Order::Disable)),
            None if zero => Some(Request::Order(Order::SetZero)),
            None => Some(Request::Order(Order::Report)),
            Some(_) => None,
        }
    }

    pub(super) fn reply(&self, reply: &JointReply, frames: &mut Frames) {
        let resolution = self.scales.resolution;
        let (mode, fault) = match reply.state.unwrap_or_default() {
            DriveState::Enabled => (POSITION, 0),
            DriveState::Fault(11) => (TIMED_OUT, 0),
            DriveState::Fault(code) => (FAULTED, code.clamp(1, 127) as u8),
            _ => (STOPPED, 0),
        };
        let mut bytes = Bytes::new();
        put(&mut bytes, &[REPLY | 1, MODE as u8, mode]);
        put(&mut bytes, &[REPLY | form(resolution) | 3, 1]);
        let turns = |value: Option<f32>| value.unwrap_or_default() / TURN;
        let values = [
            turns(reply.position),
            turns(reply.velocity),
            reply.torque.unwrap_or_default(),
        ];
        for (value, step) in values.into_iter().zip(resolution.steps()) {
            write(&mut bytes, resolution, value, step, &mut 0.0);
        }
        let celsius = nearest(reply.temperature.unwrap_or_default()).clamp(-127, 127) as i8;
        put(&mut bytes, &[REPLY | 2, TEMPERATURE as u8]);
        put(&mut bytes, &[celsius as u8, fault]);
        let id = u32::from(self.drive.id & 0x7f) << 8 | u32::from(self.drive.host_id & 0x7f);
        let frame = Frame::new(id, id > Frame::STANDARD_MAX, &bytes);
        push(frames, frame.into_fd(NOP));
    }

    /// No drive of this protocol reports a scale.
    pub(super) fn reply_scale(&self, _: Scale, _: f32, _: &mut Frames) {}
}

/// Adds a torque, N·m, to that of a motion command; saturates. A command without the field stays as it is.
pub(super) fn add_torque(frame: &mut Frame, torque: f32, carry: &mut f32) {
    let mut field = None;
    let whole = each(frame.bytes(), WRITE, |register, value, end| {
        if register == TORQUE {
            field = Some((value, end));
        }
    });
    let Some((value, end)) = field.filter(|_| whole) else {
        return;
    };
    // The most negative integer and NaN mean a torque of 0.
    let before = value.scaled(0.5, 0.01, 1e-3).unwrap_or(0.0);
    let mut bytes = Bytes::new();
    let mut code = |step: f32, most: i32| {
        let wanted =
            nearest(before / step).saturating_add(carried(torque / step, carry, -most, most));
        wanted.max(-most).min(most)
    };
    match value {
        Value::Byte(_) => put(&mut bytes, &(code(0.5, i8::MAX.into()) as i8).to_le_bytes()),
        Value::Integer(_, Resolution::Int16) => {
            let code = code(0.01, i16::MAX.into()) as i16;
            put(&mut bytes, &code.to_le_bytes());
        }
        Value::Integer(..) => put(&mut bytes, &code(1e-3, i32::MAX).to_le_bytes()),
        Value::Float(_) => put(&mut bytes, &(before + torque).to_le_bytes()),
    }
    let place = end.saturating_sub(bytes.len())..end;
    copy(frame.bytes_mut().get_mut(place).unwrap_or_default(), &bytes);
}

/// Padding of a frame to the next length of CAN-FD: a subframe that does nothing.
const NOP: u8 = 0x50;
const WRITE: u8 = 0x00;
const READ: u8 = 0x10;
const REPLY: u8 = 0x20;
const MODE: u32 = 0x000;
const TEMPERATURE: u32 = 0x00e;
const FAULT: u32 = 0x00f;
const COMMAND: u32 = 0x020;
const TORQUE: u32 = 0x022;
const WATCHDOG: u32 = 0x027;
/// Register 0x131, "set output exact"; two bytes as a variable-length integer. Its neighbour 0x130 only chooses the nearest
/// turn of the motor.
const SET_OUTPUT: [u8; 2] = [0xb1, 0x02];
const STOPPED: u8 = 0;
const FAULTED: u8 = 1;
const POSITION: u8 = 10;
const TIMED_OUT: u8 = 11;

type Bytes = heapless::Vec<u8, { Frame::CAPACITY }>;

fn put(bytes: &mut Bytes, more: &[u8]) {
    let fits = bytes.extend_from_slice(more);
    debug_assert!(fits.is_ok(), "longer than a frame");
}

/// Bits 2 and 3 of a subframe's first byte.
const fn form(resolution: Resolution) -> u8 {
    match resolution {
        Resolution::Int16 => 0x04,
        Resolution::Int32 => 0x08,
        Resolution::F32 => 0x0c,
    }
}

/// Appends one value in units of `step`. The most negative integer means "not given", so it is never sent.
fn write(bytes: &mut Bytes, resolution: Resolution, value: f32, step: f32, carry: &mut f32) {
    match resolution {
        Resolution::F32 => put(bytes, &value.to_le_bytes()),
        Resolution::Int16 => {
            let most = i32::from(i16::MAX);
            let code = carried(value / step, carry, -most, most) as i16;
            put(bytes, &code.to_le_bytes());
        }
        Resolution::Int32 => {
            let code = carried(value / step, carry, -i32::MAX, i32::MAX);
            put(bytes, &code.to_le_bytes());
        }
    }
}

/// Value of one register in a subframe.
#[derive(Clone, Copy)]
enum Value {
    Integer(i32, Resolution),
    Byte(i8),
    Float(f32),
}

impl Value {
    /// In the unit of a register with these steps for 8, 16 and 32 bits; `None` where it is not given.
    fn scaled(self, byte: f32, short: f32, long: f32) -> Option<f32> {
        match self {
            Self::Byte(i8::MIN) | Self::Integer(i32::MIN, Resolution::Int32) => None,
            Self::Integer(value, Resolution::Int16) if value == i16::MIN.into() => None,
            Self::Byte(value) => Some(f32::from(value) * byte),
            Self::Integer(value, Resolution::Int16) => Some(value as f32 * short),
            Self::Integer(value, _) => Some(value as f32 * long),
            Self::Float(value) => value.is_finite().then_some(value),
        }
    }

    fn count(self) -> u32 {
        match self {
            Self::Byte(value) => value.max(0) as u32,
            Self::Integer(value, _) => value.max(0) as u32,
            Self::Float(value) => value as u32,
        }
    }
}

fn varuint<'a>(bytes: &mut &'a [u8]) -> Option<u32> {
    let mut value = 0_u32;
    for shift in [0, 7, 14, 21, 28] {
        let (&byte, rest): (&'a u8, _) = bytes.split_first()?;
        *bytes = rest;
        value |= u32::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

fn next(bytes: &mut &[u8], form: u8) -> Option<Value> {
    fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
        let (&head, rest) = bytes.split_first_chunk()?;
        *bytes = rest;
        Some(head)
    }
    Some(match form {
        0 => Value::Byte(i8::from_le_bytes(take(bytes)?)),
        1 => Value::Integer(i16::from_le_bytes(take(bytes)?).into(), Resolution::Int16),
        2 => Value::Integer(i32::from_le_bytes(take(bytes)?), Resolution::Int32),
        _ => Value::Float(f32::from_le_bytes(take(bytes)?)),
    })
}

/// A frame asks for registers.
pub(super) fn queries(frame: &Frame) -> bool {
    let mut any = false;
    each(frame.bytes(), READ, |_, _, _| any = true) && any
}

/// Calls `register` with every value of `kind` in a frame and the place behind it, for a query once with 0; `false` where the
/// frame ends in the middle of a subframe or has one of an unknown kind.
fn each(all: &[u8], kind: u8, mut register: impl FnMut(u32, Value, usize)) -> bool {
    let mut bytes = all;
    let mut walk = || {
        while let Some((&first, rest)) = bytes.split_first() {
            bytes = rest;
            match first & 0xf0 {
                _ if first == NOP => {}
                family @ (WRITE | READ | REPLY) => {
                    let count = match first & 3 {
                        0 => varuint(&mut bytes)?,
                        count => count.into(),
                    };
                    let start = varuint(&mut bytes)?;
                    if family == READ {
                        if kind == READ {
                            register(start, Value::Byte(0), all.len() - bytes.len());
                        }
                        continue;
                    }
                    // A frame of 64 bytes has no room for more.
                    for place in 0..count.min(64) {
                        let value = next(&mut bytes, first >> 2 & 3)?;
                        if family == kind {
                            register(start.wrapping_add(place), value, all.len() - bytes.len());
                        }
                    }
                }
                _ => return None,
            }
        }
        Some(())
    };
    walk().is_some()
}
