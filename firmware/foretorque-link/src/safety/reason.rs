use core::fmt;
use serde::{Deserialize, Serialize, Serializer};

/// State of the torque enable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SafetyState {
    /// Torque zero, enable pin off. After every start.
    #[default]
    Disarmed,
    /// Torque of the tick, within the hard limits.
    Armed,
    /// Torque ramps to zero at the hard slew limit, with a brake after that of gravity was kept; the pin stays on until then.
    RampDown,
    /// Torque zero, enable pin off, a fault latched that has to be cleared before arming.
    Fault,
}

/// Declares the reasons with their texts, in the order of their codes.
macro_rules! reasons {
    ($($(#[$attribute:meta])* $reason:ident = $text:literal;)*) => {
        errors! {
            /// Reason why the torque is, or may soon be, less than requested. Variants are only ever appended: their index
            /// is the code on the wire and in the memory that outlives a reset.
            #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
            #[cfg_attr(feature = "defmt", derive(defmt::Format))]
            pub enum SafetyReason {
                $($(#[$attribute])* $reason = $text;)*
            }
        }

        impl SafetyReason {
            /// Every reason, in the order of their codes.
            pub const ALL: [Self; 24] = [$(Self::$reason),*];
        }
    };
}

reasons! {
    #[default]
    None = "no fault";
    Disarmed = "disarmed by the host";
    /// (Limit: [`COMMAND_TIMEOUT_US`](super::COMMAND_TIMEOUT_US).)
    CommandTimeout = "no usable sample in time";
    Stopped = "emergency stop";
    DesiredNotFinite = "desired motion not finite";
    DesiredJump = "desired position faster than the joint";
    MeasuredNotFinite = "measured position or effort not finite";
    PositionRange = "measured position out of range";
    PositionJump = "measured position faster than the joint";
    /// (Limit: three torque limits.)
    EffortRange = "measured effort out of range";
    MotorWarm = "motor warm, torque limit reduced";
    MotorHot = "motor too hot";
    TorqueNotFinite = "torque of the tick not finite";
    Drive = "drive fault";
    /// (Causes: panic, processor fault, stack overflow, watchdog.)
    Restarted = "the firmware restarted itself";
    NoSample = "too few fresh samples with a plausible measured position";
    TooFar = "desired position too far from the measured one";
    StillRamping = "torque still ramps to zero";
    Stage = "the board's own motor stage accepts no command";
    Encoder = "the board's own encoder gives no position";
    /// (Limit: [`MEASUREMENT_TIMEOUT_US`](super::MEASUREMENT_TIMEOUT_US).)
    MeasurementTimeout = "no plausible measurement in time";
    /// (Limit: [`ARM_DISTANCE`](super::ARM_DISTANCE).)
    FollowingError = "measured position too far from the desired one";
    GravityLost = "no sound rigid-body share for a joint";
    Image = "program in flash damaged";
}

impl SafetyReason {
    /// The code on the wire and in the memory that outlives a reset.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The reason latches, until the host clears it.
    pub const fn latches(self) -> bool {
        use SafetyReason::*;
        !matches!(
            self,
            None | Disarmed
                | CommandTimeout
                | MotorWarm
                | NoSample
                | TooFar
                | StillRamping
                | MeasurementTimeout
                | Image
        )
    }

    /// The reason of a code; [`Restarted`](Self::Restarted) for an unknown code.
    pub fn from_code(code: u8) -> Self {
        let reason = Self::ALL.get(usize::from(code)).copied();
        reason.unwrap_or(Self::Restarted)
    }
}

impl Serialize for SafetyReason {
    /// Writes the code alone, as the derived implementation does in postcard; that one costs 44 bytes of flash a variant.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_unit_variant("SafetyReason", u32::from(self.code()), "")
    }
}

/// State and reason of one tick, as replies carry them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SafetyStatus {
    /// State of the torque enable.
    pub state: SafetyState,
    /// The latched fault, else the fault of this tick's input, else a warm motor, else the reason that ended the torque.
    pub reason: SafetyReason,
}

impl fmt::Display for SafetyStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = match self.state {
            SafetyState::Disarmed => "disarmed",
            SafetyState::Armed => "armed",
            SafetyState::RampDown => "torque going to zero",
            SafetyState::Fault => "fault",
        };
        write!(f, "{state}: {}", self.reason)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_means_its_reason_and_an_unknown_one_a_restart() {
        for (code, reason) in SafetyReason::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(reason.code()), code);
            assert_eq!(SafetyReason::from_code(code as u8), reason);
            let mut buffer = [0; 4];
            let sent = postcard::to_slice(&reason, &mut buffer).unwrap();
            assert_eq!(sent, [code as u8]);
            assert_eq!(postcard::from_bytes(sent), Ok(reason));
        }
        assert_eq!(SafetyReason::from_code(200), SafetyReason::Restarted);
    }
}
