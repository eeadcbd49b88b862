//! CiA 402 process data: one PDO out (control word, target, torque), one or two in (status word, position, torque).
//!
//! | PDO | identifier | content |
//! |---|---|---|
//! | out, position | 200h + node | 6040h u16, 607Ah i32, 60B2h i16 |
//! | out, velocity | 200h + node | 6040h u16, 60FFh i32, 60B2h i16 |
//! | out, torque | 200h + node | 6040h u16, 6071h i16 |
//! | in 1 | 180h + node | 6041h u16, 6064h i32, 6077h i16 |
//! | in 2 | 280h + node | 606Ch i32 |
//!
//! Torques are in thousandths of the rated torque (6076h). The same bytes are the process data of EtherCAT; the stack that
//! configures the mapping is the user's. Source: CiA 402-2; Beckhoff's object pages of AX8000 and AMP8000.

use super::frame::{carried, join, nearest};
use super::{
    Cia402, ControlMode, DriveProfile, DriveState, Event, Frame, Frames, JointCommand, JointReply,
    Order, Outgoing, Request, Scale, TURN, push, within,
};

const ENABLED: u16 = 0x0f;
const SHUTDOWN: u16 = 0x06;
const SWITCH_ON: u16 = 0x07;
const RESET: u16 = 0x80;
const SYNC: u32 = 0x80;
/// First bytes of an expedited SDO: command, index and subindex.
const READ_RATED: [u8; 4] = [0x40, 0x76, 0x60, 0];
const RATED: [u8; 4] = [0x43, 0x76, 0x60, 0];

pub(super) struct Codec<'p> {
    pub(super) drive: &'p DriveProfile,
    pub(super) scales: &'p Cia402,
}

impl Codec<'_> {
    fn frame(&self, function: u32, bytes: &[u8]) -> Frame {
        Frame::standard(function + u32::from(self.drive.id), bytes)
    }

    fn output(&self, control: u16, target: i32, torque: i16) -> Frame {
        let [c0, c1] = control.to_le_bytes();
        let ([p0, p1, p2, p3], [t0, t1]) = (target.to_le_bytes(), torque.to_le_bytes());
        match self.scales.mode {
            ControlMode::Torque => self.frame(0x200, &[c0, c1, t0, t1]),
            _ => self.frame(0x200, &[c0, c1, p0, p1, p2, p3, t0, t1]),
        }
    }

    pub(super) fn command(&self, motion: &JointCommand, out: &mut Outgoing<'_>) {
        // The largest f32 below 2^31.
        const MOST: f32 = 2_147_483_500.0;
        let counts = self.scales.counts_per_turn / TURN;
        let (position, velocity) = (motion.position * counts, motion.velocity * counts);
        let target = match self.scales.mode {
            ControlMode::Position => within(position, -MOST, MOST),
            ControlMode::Velocity => within(velocity, -MOST, MOST),
            ControlMode::Torque => 0.0,
        };
        let most = i32::from(i16::MAX);
        let torque = motion.torque * 1e3 / self.scales.rated_torque;
        let torque = within(torque, -most as f32, most as f32);
        let torque = carried(torque, &mut out.carry.torque, -most, most) as i16;
        push(out.frames, self.output(ENABLED, nearest(target), torque));
    }

    pub(super) fn order(&self, order: Order, frames: &mut Frames) -> bool {
        match order {
            Order::Enable => {
                // The control word of the first command, beside its target, is what enables the operation.
                push(frames, self.output(SWITCH_ON, 0, 0));
            }
            Order::Disable => {
                push(frames, self.output(SHUTDOWN, 0, 0));
                // A node that boots takes and sends process data only after it was started.
                push(frames, Frame::standard(0, &[1, self.drive.id as u8]));
            }
            Order::ClearFault => push(frames, self.output(RESET, 0, 0)),
            Order::ReadScale(Scale::Torque) => {
                push(frames, self.frame(0x600, &join(READ_RATED, [0; 4])))
            }
            Order::Report => push(frames, Frame::standard(SYNC, &[])),
            Order::SetZero | Order::ReadScale(_) => return false,
        }
        true
    }

    pub(super) fn decode(&self, frame: &Frame) -> Option<Event> {
        if frame.extended || frame.remote {
            return None;
        }
        let to_rad = TURN / self.scales.counts_per_turn;
        let mut reply = JointReply::default();
        match (frame.id.checked_sub(self.drive.id.into())?, frame.bytes()) {
            (0x180, &[s0, s1, p0, p1, p2, p3, t0, t1]) => {
                let torque = i16::from_le_bytes([t0, t1]);
                reply.position = Some(i32::from_le_bytes([p0, p1, p2, p3]) as f32 * to_rad);
                reply.torque = Some(f32::from(torque) * 1e-3 * self.scales.rated_torque);
                let status = u16::from_le_bytes([s0, s1]);
                reply.state = Some(match status & 0x6f {
                    _ if status & 8 != 0 => DriveState::Fault(status.into()),
                    0x21 => DriveState::Disabled,
                    0x23 => DriveState::SwitchedOn,
                    0x27 => DriveState::Enabled,
                    _ => DriveState::NotReady,
                });
            }
            (0x280, &[v0, v1, v2, v3]) => {
                reply.velocity = Some(i32::from_le_bytes([v0, v1, v2, v3]) as f32 * to_rad);
            }
            (0x580, &[c, i0, i1, s, v0, v1, v2, v3]) if [c, i0, i1, s] == RATED => {
                let millis = u32::from_le_bytes([v0, v1, v2, v3]);
                return Some(Event::Scale(Scale::Torque, millis as f32 / 1e3));
            }
            _ => return None,
        }
        Some(Event::Reply(reply))
    }

    pub(super) fn accept(&self, frame: &Frame) -> Option<Request> {
        if frame.extended || frame.remote {
            return None;
        }
        if frame.id == SYNC {
            return Some(Request::Order(Order::Report));
        }
        let (control, target, torque) =
            match (frame.id.checked_sub(self.drive.id.into())?, frame.bytes()) {
                (0x200, &[c0, c1, p0, p1, p2, p3, t0, t1])
                    if self.scales.mode != ControlMode::Torque =>
                {
                    ([c0, c1], [p0, p1, p2, p3], [t0, t1])
                }
                (0x200, &[c0, c1, t0, t1]) if self.scales.mode == ControlMode::Torque => {
                    ([c0, c1], [0; 4], [t0, t1])
                }
                (0x600, &[c, i0, i1, s, ..]) if [c, i0, i1, s] == READ_RATED => {
                    return Some(Request::Order(Order::ReadScale(Scale::Torque)));
                }
                _ => return None,
            };
        match u16::from_le_bytes(control) {
            ENABLED => {}
            SWITCH_ON => return Some(Request::Order(Order::Enable)),
            RESET => return Some(Request::Order(Order::ClearFault)),
            _ => return Some(Request::Order(Order::Disable)),
        }
        let target = i32::from_le_bytes(target) as f32 * TURN / self.scales.counts_per_turn;
        let mut motion = JointCommand {
            torque: f32::from(i16::from_le_bytes(torque)) * 1e-3 * self.scales.rated_torque,
            ..JointCommand::default()
        };
        match self.scales.mode {
            ControlMode::Position => motion.position = target,
            ControlMode::Velocity => motion.velocity = target,
            ControlMode::Torque => {}
        }
        Some(Request::Command(motion))
    }

    pub(super) fn reply(&self, reply: &JointReply, frames: &mut Frames) {
        let counts = self.scales.counts_per_turn / TURN;
        let position = nearest(reply.position.unwrap_or_default() * counts).to_le_bytes();
        let velocity = nearest(reply.velocity.unwrap_or_default() * counts).to_le_bytes();
        let thousandths = reply.torque.unwrap_or_default() * 1e3 / self.scales.rated_torque;
        let torque = nearest(thousandths).clamp((-i16::MAX).into(), i16::MAX.into()) as i16;
        let status: u16 = match reply.state.unwrap_or_default() {
            DriveState::Disabled => 0x21,
            DriveState::NotReady => 0x40,
            DriveState::SwitchedOn => 0x23,
            DriveState::Enabled => 0x27,
            DriveState::Fault(_) => 0x08,
        };
        let ([s0, s1], [p0, p1, p2, p3]) = (status.to_le_bytes(), position);
        let [t0, t1] = torque.to_le_bytes();
        let first = [s0, s1, p0, p1, p2, p3, t0, t1];
        push(frames, self.frame(0x180, &first));
        push(frames, self.frame(0x280, &velocity));
    }

    pub(super) fn reply_scale(&self, _: Scale, value: f32, frames: &mut Frames) {
        let millis = (value * 1e3) as u32;
        push(
            frames,
            self.frame(0x580, &join(RATED, millis.to_le_bytes())),
        );
    }
}
