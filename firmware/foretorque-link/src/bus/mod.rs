//! The loop of an arm whose joints are drives on one or two CAN buses.
//!
//! ```text
//! period k    tick: replies of k−1 ─► sample ─► safety, feed-forward ─► commands of all joints, torque included
//!             afterwards: the learner takes its sample; replies to the commands of k arrive
//! ```
//! Sans-IO: the owner passes in frames as they arrive, calls [`BusController::tick`] once a period, and sends what it
//! passes out. The torque of a tick belongs to the desired motion of that tick and leaves at once; the measurement is that
//! of the commands one period before. `docs/bus.md` lists the latencies.
//!
//! A drive that is silent, reports a fault, resets, or reports another scale than its profile ends the torque: it ramps to
//! zero within 10 ms, the drives damp the arm for [`DAMPING_S`], then they are switched off.

mod board;
mod config;
mod controller;
mod drives;
mod joint;
mod line;

use crate::drives::Scale;
pub use board::{BoardDrives, Role, Wires, Wiring};
pub use config::{BusConfig, BusConfigError, BusJoint};
pub use controller::{BusController, BusTick};
use core::fmt;
pub use drives::{BusDrives, BusPhase};
pub use joint::JointCounters;

/// Time without a reply of a drive after which the torque ends, s.
pub const SILENCE_S: f32 = 0.02;
/// Time in which stiffness and damping rise to those of the profile, s.
pub const SOFT_START_S: f32 = 0.5;
/// Time for which the drives damp the arm after the torque has ended, s.
pub const DAMPING_S: f32 = 1.0;
/// Time that the drives have to report that they are enabled, s.
pub const ENABLE_S: f32 = 0.5;
/// Distance between desired and measured position that ends the torque, rad.
pub const FOLLOWING_RAD: f32 = 0.3;
/// Change of the desired position during which a reply that repeats itself counts as stuck, rad.
pub const STUCK_RAD: f32 = 0.05;

/// Cause of a fault of the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultCause {
    /// No reply within [`SILENCE_S`].
    Silent,
    /// Fault code of the drive.
    Drive(u32),
    /// The drive is switched off without an order: it has reset, or its watchdog has ended.
    Disabled,
    /// The drive does not report that it is enabled.
    NotEnabled,
    /// A scale of the drive differs from the profile: scale, of the profile, of the drive.
    Scale(Scale, f32, f32),
    /// The drive has not reported a scale that its protocol can report.
    ScaleUnknown(Scale),
    /// Measured and desired position, rad, differ by more than [`FOLLOWING_RAD`].
    NotFollowing(f32, f32),
    /// The reply repeats itself while the desired position moves.
    Stuck,
    /// Replies of one period contradict each other: positions, rad. Two drives have one identifier.
    Ambiguous(f32, f32),
    /// More than one period in five lacks a reply: the bus is overloaded or disturbed.
    Losses,
    /// The bus is off.
    BusOff,
}

/// Fault of the bus, or of the drive of one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BusFault {
    /// Joint, from 0; `None` where no single joint is at fault.
    pub joint: Option<u8>,
    /// Cause.
    pub cause: FaultCause,
}

impl fmt::Display for BusFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(joint) = self.joint {
            write!(f, "joint {}: ", joint + 1)?;
        }
        match self.cause {
            FaultCause::Silent => f.write_str("the drive does not answer"),
            FaultCause::Drive(code) => write!(f, "the drive reports fault {code:#x}"),
            FaultCause::Disabled => f.write_str("the drive has switched itself off"),
            FaultCause::NotEnabled => f.write_str("the drive does not switch on"),
            FaultCause::Scale(scale, profile, drive) => {
                let name = scale_name(scale);
                write!(
                    f,
                    "{name} is {profile} in the profile, {drive} in the drive"
                )
            }
            FaultCause::ScaleUnknown(scale) => {
                write!(f, "the drive does not report {}", scale_name(scale))
            }
            FaultCause::NotFollowing(desired, measured) => write!(
                f,
                "desired position {desired:.3} rad, measured {measured:.3} rad"
            ),
            FaultCause::Stuck => f.write_str("the reply of the drive repeats itself"),
            FaultCause::Ambiguous(one, other) => write!(
                f,
                "two replies in one period, {one:.3} rad and {other:.3} rad: is the identifier used twice?"
            ),
            FaultCause::Losses => f.write_str("the bus loses more than one period in five"),
            FaultCause::BusOff => f.write_str("the bus is off"),
        }
    }
}

/// Name of a scale, as fields of a profile are called.
const fn scale_name(scale: Scale) -> &'static str {
    match scale {
        Scale::Position => "range of position",
        Scale::Velocity => "range of velocity",
        Scale::Torque => "scale of torque",
    }
}

#[cfg(test)]
mod tests;
