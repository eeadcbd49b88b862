use crate::drives::Scale;
use core::fmt;

/// Cause of a fault of the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultCause {
    /// No reply within [`SILENCE_S`](super::SILENCE_S).
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
    /// Measured and desired position, rad, differ by more than [`FOLLOWING_RAD`](super::FOLLOWING_RAD).
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
