//! ODrive CANSimple: classic frames with the standard identifier `node << 5 | command`, little endian.
//!
//! Turns and turns/s of the axis' coordinate, N·m. `Set_Input_Pos` carries velocity and torque as scaled i16, the other
//! two inputs as f32. Source: ODrive's CAN protocol and DBC, firmware 0.6.

use super::frame::{carried, join, pair, unpair};
use super::{
    ControlMode, DriveProfile, DriveState, Event, Frame, Frames, JointCommand, JointReply, Odrive,
    Order, Outgoing, Request, Scale, TURN, push, within,
};
use crate::copy;

mod command {
    pub(super) const HEARTBEAT: u16 = 0x01;
    pub(super) const READ: u16 = 0x04;
    pub(super) const VALUE: u16 = 0x05;
    pub(super) const STATE: u16 = 0x07;
    pub(super) const ESTIMATES: u16 = 0x09;
    pub(super) const MODE: u16 = 0x0b;
    pub(super) const POSITION: u16 = 0x0c;
    pub(super) const VELOCITY: u16 = 0x0d;
    pub(super) const TORQUE: u16 = 0x0e;
    pub(super) const TEMPERATURE: u16 = 0x15;
    pub(super) const CLEAR: u16 = 0x18;
    pub(super) const ZERO: u16 = 0x19;
    pub(super) const TORQUES: u16 = 0x1c;
}

const IDLE: u32 = 1;
const CLOSED_LOOP: u32 = 8;

pub(super) struct Codec<'p> {
    pub(super) drive: &'p DriveProfile,
    pub(super) scales: &'p Odrive,
}

impl Codec<'_> {
    fn id(&self, command: u16) -> u32 {
        u32::from(self.drive.id << 5 | command)
    }

    fn send(&self, command: u16, bytes: &[u8], frames: &mut Frames) {
        push(frames, Frame::standard(self.id(command), bytes));
    }

    fn poll(&self, frames: &mut Frames) {
        for command in [command::ESTIMATES, command::TORQUES] {
            push(frames, Frame::remote(self.id(command)));
        }
    }

    pub(super) fn command(&self, motion: &JointCommand, out: &mut Outgoing<'_>) {
        let (turns, speed) = (motion.position / TURN, motion.velocity / TURN);
        match self.scales.mode {
            ControlMode::Position => {
                let most = f32::from(i16::MAX);
                let code = |value: f32, carry: &mut f32| {
                    let value = within(value, -most, most);
                    carried(value, carry, (-i16::MAX).into(), i16::MAX.into()) as i16
                };
                let speed = speed * self.scales.velocity_scale;
                let torque = motion.torque * self.scales.torque_scale;
                let speed = code(speed, &mut out.carry.velocity);
                let torque = code(torque, &mut out.carry.torque);
                let ([v0, v1], [t0, t1]) = (speed.to_le_bytes(), torque.to_le_bytes());
                let bytes = join(turns.to_le_bytes(), [v0, v1, t0, t1]);
                self.send(command::POSITION, &bytes, out.frames);
            }
            ControlMode::Velocity => {
                self.send(command::VELOCITY, &pair(speed, motion.torque), out.frames);
            }
            ControlMode::Torque => {
                self.send(command::TORQUE, &pair(motion.torque, 0.0), out.frames);
            }
        }
        if self.scales.polled {
            self.poll(out.frames);
        }
    }

    pub(super) fn order(&self, order: Order, frames: &mut Frames) -> bool {
        match order {
            Order::Enable => {
                let control = match self.scales.mode {
                    ControlMode::Torque => 1_u8,
                    ControlMode::Velocity => 2,
                    ControlMode::Position => 3,
                };
                // Input mode 1: pass-through.
                self.send(command::MODE, &[control, 0, 0, 0, 1, 0, 0, 0], frames);
                self.send(command::STATE, &state(CLOSED_LOOP), frames);
            }
            Order::Disable => self.send(command::STATE, &state(IDLE), frames),
            Order::ClearFault => self.send(command::CLEAR, &[0], frames),
            Order::SetZero => self.send(command::ZERO, &[0; 8], frames),
            Order::Report if self.scales.polled => self.poll(frames),
            // It reports by itself.
            Order::Report => return false,
            Order::ReadScale(Scale::Torque) if self.scales.torque_scale_endpoint != 0 => {
                let [low, high] = self.scales.torque_scale_endpoint.to_le_bytes();
                self.send(command::READ, &[0, low, high, 0, 0, 0, 0, 0], frames);
            }
            Order::ReadScale(_) => return false,
        }
        // It answers neither of these two, and must not count as silent.
        if self.scales.polled && matches!(order, Order::Enable | Order::Disable) {
            self.poll(frames);
        }
        true
    }

    pub(super) fn decode(&self, frame: &Frame) -> Option<Event> {
        let data = frame.eight().filter(|_| !frame.extended)?;
        if frame.id >> 5 != u32::from(self.drive.id) {
            return None;
        }
        let (first, second) = unpair(data);
        let finite = |value: f32| value.is_finite().then_some(value);
        let mut reply = JointReply::default();
        match (frame.id & 0x1f) as u16 {
            command::ESTIMATES => {
                reply.position = finite(first * TURN);
                reply.velocity = finite(second * TURN);
            }
            command::TORQUES => reply.torque = finite(second),
            command::TEMPERATURE => {
                // Of a motor without a sensor it is no number.
                reply.temperature = finite(first.max(second));
            }
            command::HEARTBEAT => {
                let [error @ .., state, _, _, _] = data;
                reply.state = Some(match (u32::from_le_bytes(error), u32::from(state)) {
                    (0, CLOSED_LOOP) => DriveState::Enabled,
                    (0, _) => DriveState::Disabled,
                    (error, _) => DriveState::Fault(error),
                });
            }
            command::VALUE => {
                // A property of 32 bits without a sign.
                let [_, low, high, _, value @ ..] = data;
                let endpoint = u16::from_le_bytes([low, high]);
                let own = endpoint != 0 && endpoint == self.scales.torque_scale_endpoint;
                let value = u32::from_le_bytes(value) as f32;
                return own.then_some(Event::Scale(Scale::Torque, value));
            }
            _ => return None,
        }
        Some(Event::Reply(reply))
    }

    pub(super) fn accept(&self, frame: &Frame) -> Option<Request> {
        if frame.extended || frame.id >> 5 != u32::from(self.drive.id) {
            return None;
        }
        let kind = (frame.id & 0x1f) as u16;
        if frame.remote {
            // The drive answers the other remote frame, too, with the reply to this one.
            return (kind == command::ESTIMATES).then_some(Request::Order(Order::Report));
        }
        let mut data = [0; 8];
        copy(&mut data, frame.bytes());
        let (first, second) = unpair(data);
        let mut motion = JointCommand::default();
        match (kind, frame.bytes().len()) {
            (command::POSITION, 8) => {
                let [_, _, _, _, v0, v1, t0, t1] = data;
                motion.position = first * TURN;
                motion.velocity =
                    f32::from(i16::from_le_bytes([v0, v1])) * TURN / self.scales.velocity_scale;
                motion.torque = f32::from(i16::from_le_bytes([t0, t1])) / self.scales.torque_scale;
            }
            (command::VELOCITY, 8) => (motion.velocity, motion.torque) = (first * TURN, second),
            (command::TORQUE, 4 | 8) => motion.torque = first,
            (command::STATE, 4 | 8) => {
                let [state @ .., _, _, _, _] = data;
                return match u32::from_le_bytes(state) {
                    CLOSED_LOOP => Some(Request::Order(Order::Enable)),
                    IDLE => Some(Request::Order(Order::Disable)),
                    _ => None,
                };
            }
            (command::CLEAR, _) => return Some(Request::Order(Order::ClearFault)),
            (command::ZERO, 4 | 8) => return Some(Request::Order(Order::SetZero)),
            (command::READ, 8) => {
                let [_, low, high, ..] = data;
                let own = u16::from_le_bytes([low, high]) == self.scales.torque_scale_endpoint;
                return own.then_some(Request::Order(Order::ReadScale(Scale::Torque)));
            }
            _ => return None,
        }
        motion.is_finite().then_some(Request::Command(motion))
    }

    pub(super) fn reply(&self, reply: &JointReply, frames: &mut Frames) {
        let turns = |value: Option<f32>| value.unwrap_or_default() / TURN;
        let estimates = pair(turns(reply.position), turns(reply.velocity));
        self.send(command::ESTIMATES, &estimates, frames);
        let torque = reply.torque.unwrap_or_default();
        self.send(command::TORQUES, &pair(torque, torque), frames);
        let (error, state) = match reply.state.unwrap_or_default() {
            DriveState::Enabled => (0, CLOSED_LOOP),
            DriveState::Fault(error) => (error.max(1), IDLE),
            _ => (0, IDLE),
        };
        let bytes = join(error.to_le_bytes(), state.to_le_bytes());
        self.send(command::HEARTBEAT, &bytes, frames);
    }

    pub(super) fn reply_scale(&self, _: Scale, value: f32, frames: &mut Frames) {
        let [low, high] = self.scales.torque_scale_endpoint.to_le_bytes();
        let bytes = join([0, low, high, 0], (value as u32).to_le_bytes());
        self.send(command::VALUE, &bytes, frames);
    }
}

/// The eight bytes of a requested state; the DBC has all frames with data at full length.
const fn state(state: u32) -> [u8; 8] {
    (state as u64).to_le_bytes()
}

/// Adds to the torque of a motion command: `torque`, N·m, where it is an f32, else `steps`; saturates.
pub(super) fn add_torque(frame: &mut Frame, torque: f32, steps: i32) {
    let kind = (frame.id & 0x1f) as u16;
    match (kind, frame.bytes_mut()) {
        (command::POSITION, [_, _, _, _, _, _, t0, t1]) => {
            let sum = i32::from(i16::from_le_bytes([*t0, *t1])) + steps;
            let sum = sum.clamp((-i16::MAX).into(), i16::MAX.into()) as i16;
            [*t0, *t1] = sum.to_le_bytes();
        }
        (command::VELOCITY, [_, _, _, _, t0, t1, t2, t3])
        | (command::TORQUE, [t0, t1, t2, t3, ..]) => {
            let sum = f32::from_le_bytes([*t0, *t1, *t2, *t3]) + torque;
            if sum.is_finite() {
                [*t0, *t1, *t2, *t3] = sum.to_le_bytes();
            }
        }
        _ => {}
    }
}
