use super::program::{AbortReason, ExcitationError};
use serde::{Deserialize, Serialize};

/// State of an excitation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ExcitationState {
    /// None is loaded.
    Empty,
    /// The check runs, some points a tick.
    Checking,
    /// It may be started.
    Ready,
    /// It failed the check.
    Refused(ExcitationError),
    /// Moves from the position of the arm to the start of the series.
    Approaching,
    /// Plays the series.
    Playing,
    /// Comes to rest on the path, after a stop.
    Stopping,
    /// At rest; still decides the desired motion.
    Holding,
    /// A limit was exceeded: comes to rest, or is at rest; still decides the desired motion.
    Aborted(AbortReason),
}

impl ExcitationState {
    /// The player decides the desired motion.
    pub const fn is_active(self) -> bool {
        matches!(
            self,
            Self::Approaching | Self::Playing | Self::Stopping | Self::Holding | Self::Aborted(_)
        )
    }
}

/// Commands to the player.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExcitationCommand {
    /// Report the state.
    Status,
    /// Start after the check, from where the host holds the arm, in the next tick with a measurement.
    Start,
    /// Come to rest on the path.
    Stop,
    /// Return the desired motion to the host. Only at rest.
    Release,
}
