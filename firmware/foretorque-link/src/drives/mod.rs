//! Codecs of CAN drives with a torque feed-forward: commands into frames, frames into replies, and back.
//!
//! ```text
//! JointCommand ─ command ─► frames ─► bus ─► accept ─► Request       (a simulated drive)
//! Event ◄─────── decode ◄── frames ◄─ bus ◄─ reply ◄── JointReply
//! ```
//! [`JointCommand`] and [`JointReply`] are in SI units in the coordinates of the joint; [`DriveProfile`] holds sign, zero,
//! gear and scales. Nothing here waits, allocates or panics. A value out of range saturates. A command
//! with a value that is not finite is refused: the frames then take the torque off.
//!
//! Where a field has few bits, [`Carry`] adds the rounding error of one frame to the next. The mean torque of successive
//! frames is then the commanded one, also for zero, which a field of ± full scale over 4095 steps cannot express.

mod cia402;
mod cybergear;
mod frame;
pub mod in_line;
mod mit;
mod moteus;
mod odrive;
mod profile;
pub mod text;

use core::fmt;
use frame::within;
pub use frame::{Carry, Frame};
pub use profile::{
    Cia402, Contradiction, ControlMode, DriveProfile, Moteus, Odrive, Protocol, Ranges, Resolution,
};

/// Radians of a turn.
const TURN: f32 = core::f32::consts::TAU;

/// Frames of one call, in the order to send them.
pub type Frames = heapless::Vec<Frame, 4>;

/// Command to one joint: `kp·(position − q) + kd·(velocity − q̇) + torque` is what the drive applies.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointCommand {
    /// Desired position, rad.
    pub position: f32,
    /// Desired velocity, rad/s.
    pub velocity: f32,
    /// Torque feed-forward, N·m.
    pub torque: f32,
    /// Stiffness, N·m/rad; without effect where [`DriveProfile::carries_gains`] is false.
    pub kp: f32,
    /// Damping, N·m·s/rad; without effect where [`DriveProfile::carries_gains`] is false.
    pub kd: f32,
}

impl JointCommand {
    /// Every field is finite.
    pub fn is_finite(&self) -> bool {
        let c = self;
        let values = [c.position, c.velocity, c.torque, c.kp, c.kd];
        values.iter().all(|value| value.is_finite())
    }
}

/// State of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DriveState {
    /// No torque.
    #[default]
    Disabled,
    /// No torque, and not ready to be switched on before an order to switch it off (CiA 402: switch on disabled).
    NotReady,
    /// No torque; the next command turns it on (CiA 402).
    SwitchedOn,
    /// Torque follows the commands.
    Enabled,
    /// Fault, with the code of the protocol; no torque.
    Fault(u32),
}

/// Reply of a drive; a quantity that the frame does not carry is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointReply {
    /// Position, rad.
    pub position: Option<f32>,
    /// Velocity, rad/s.
    pub velocity: Option<f32>,
    /// Torque, N·m.
    pub torque: Option<f32>,
    /// Highest temperature of the frame, °C.
    pub temperature: Option<f32>,
    /// State.
    pub state: Option<DriveState>,
}

impl JointReply {
    /// Takes over every quantity that `newer` carries.
    pub fn update(&mut self, newer: &Self) {
        self.position = newer.position.or(self.position);
        self.velocity = newer.velocity.or(self.velocity);
        self.torque = newer.torque.or(self.torque);
        self.temperature = newer.temperature.or(self.temperature);
        self.state = newer.state.or(self.state);
    }
}

/// Scale of a profile that the drive itself can report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Damiao: P_MAX, rad.
    Position,
    /// Damiao: V_MAX, rad/s.
    Velocity,
    /// Damiao: T_MAX, N·m. CyberGear and RobStride: `limit_torque`, N·m. ODrive: `input_torque_scale`, counts per N·m.
    /// CiA 402: rated torque, N·m.
    Torque,
}

impl Scale {
    /// All of them, in their order.
    pub(crate) const ALL: [Self; 3] = [Self::Position, Self::Velocity, Self::Torque];
}

impl fmt::Display for Scale {
    /// Name of its field in a profile.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "range of position",
            Self::Velocity => "range of velocity",
            Self::Torque => "scale of torque",
        })
    }
}

/// Content of a frame from a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// Measurement or state.
    Reply(JointReply),
    /// Scale read from the drive, in the unit of the profile's field.
    Scale(Scale, f32),
}

/// Request to a drive other than a motion command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Torque on; the drive follows commands.
    Enable,
    /// Torque off.
    Disable,
    /// Clear a fault.
    ClearFault,
    /// Make the present position the zero of the drive.
    SetZero,
    /// Send a reply without a motion command.
    Report,
    /// Send a scale.
    ReadScale(Scale),
}

/// Content of a frame to a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Motion command, in the coordinates of the joint.
    Command(JointCommand),
    /// Anything else.
    Order(Order),
}

/// Frames of a motion command, and the rounding errors it takes and leaves.
struct Outgoing<'o> {
    frames: &'o mut Frames,
    carry: &'o mut Carry,
}

/// The call on the codec of a profile.
macro_rules! codec {
    ($profile:expr, $codec:ident => $call:expr) => {{
        let drive = $profile;
        match &drive.protocol {
            Protocol::MiniCheetah(scales) | Protocol::Damiao(scales) => {
                let damiao = matches!(drive.protocol, Protocol::Damiao(_));
                let $codec = mit::Codec {
                    drive,
                    scales,
                    damiao,
                };
                $call
            }
            Protocol::CyberGear(scales) | Protocol::RobStride(scales) => {
                let $codec = cybergear::Codec { drive, scales };
                $call
            }
            Protocol::Moteus(scales) => {
                let $codec = moteus::Codec { drive, scales };
                $call
            }
            Protocol::Odrive(scales) => {
                let $codec = odrive::Codec { drive, scales };
                $call
            }
            Protocol::Cia402(scales) => {
                let $codec = cia402::Codec { drive, scales };
                $call
            }
        }
    }};
}

impl DriveProfile {
    /// Appends the frames of a motion command; where a value is not finite, they take the torque off and `carry` is cleared.
    pub fn command(&self, command: &JointCommand, carry: &mut Carry, frames: &mut Frames) {
        let limited = JointCommand {
            torque: within(command.torque, -self.torque_limit, self.torque_limit),
            ..*command
        };
        let drive = self.in_drive(&limited);
        if !(command.is_finite() && drive.is_finite()) {
            *carry = Carry::default();
            self.order(Order::Disable, frames);
            return;
        }
        let mut out = Outgoing { frames, carry };
        codec!(self, codec => codec.command(&drive, &mut out));
    }

    /// Appends the frames of an order. `false`: the protocol has none for it.
    pub fn order(&self, order: Order, frames: &mut Frames) -> bool {
        codec!(self, codec => codec.order(order, frames))
    }

    /// Content of a frame from this drive; `None` for any other frame.
    pub fn decode(&self, frame: &Frame) -> Option<Event> {
        Some(match codec!(self, codec => codec.decode(frame))? {
            Event::Reply(reply) => Event::Reply(self.reply_of_joint(&reply)),
            scale @ Event::Scale(..) => scale,
        })
    }

    /// Content of a frame to this drive, as the drive reads it; `None` for any other frame.
    pub fn accept(&self, frame: &Frame) -> Option<Request> {
        match codec!(self, codec => codec.accept(frame))? {
            Request::Command(command) => {
                let command = self.in_joint(&command);
                command.is_finite().then_some(Request::Command(command))
            }
            order @ Request::Order(_) => Some(order),
        }
    }

    /// This drive answers a frame to it with its state. A moteus answers queries alone, a polled ODrive remote frames.
    pub fn answers(&self, frame: &Frame) -> bool {
        match &self.protocol {
            Protocol::Moteus(_) => moteus::queries(frame),
            Protocol::Odrive(odrive) => frame.remote || !odrive.polled,
            _ => true,
        }
    }

    /// Appends the frames that this drive sends as its reply; an absent quantity counts as 0.
    pub fn reply(&self, reply: &JointReply, frames: &mut Frames) {
        let turn = self.sign * self.gear;
        let drive = JointReply {
            position: Some((reply.position.unwrap_or_default() - self.zero) * turn),
            velocity: Some(reply.velocity.unwrap_or_default() * turn),
            torque: Some(reply.torque.unwrap_or_default() / turn),
            ..*reply
        };
        codec!(self, codec => codec.reply(&drive, frames));
    }

    /// Appends the frame by which this drive reports a scale, in the unit of the profile's field.
    pub fn reply_scale(&self, scale: Scale, value: f32, frames: &mut Frames) {
        codec!(self, codec => codec.reply_scale(scale, value, frames));
    }

    fn reply_of_joint(&self, drive: &JointReply) -> JointReply {
        let turn = self.sign * self.gear;
        // A finite number of turns can be an infinite angle.
        let finite = |value: f32| value.is_finite().then_some(value);
        let position = drive.position.map(|position| position / turn + self.zero);
        JointReply {
            position: position.and_then(finite),
            velocity: drive.velocity.and_then(|velocity| finite(velocity / turn)),
            torque: drive.torque.and_then(|torque| finite(torque * turn)),
            temperature: drive.temperature.and_then(finite),
            ..*drive
        }
    }
}

/// Appends a frame; a call appends at most as many as [`Frames`] holds.
fn push(frames: &mut Frames, frame: Frame) {
    let pushed = frames.push(frame);
    debug_assert!(pushed.is_ok(), "more frames than one call may append");
}

#[cfg(test)]
mod tests;
