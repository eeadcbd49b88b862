use super::program::{AbortReason, ExcitationError};
use serde::{Deserialize, Serialize};

/// Where an excitation stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ExcitationState {
    /// None is loaded.
    Empty,
    /// It is being checked, some points a tick.
    Checking,
    /// It may be started.
    Ready,
    /// It failed the check.
    Refused(ExcitationError),
    /// On the way from where the arm was to where the series begins.
    Approaching,
    /// The series is played.
    Playing,
    /// Coming to rest on the path, because it was told to.
    Stopping,
    /// At rest, and still in charge of the desired motion.
    Holding,
    /// A limit was met: coming to rest, or at rest, and still in charge.
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

/// What a host can ask of the player.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExcitationCommand {
    /// Where does it stand?
    Status,
    /// Begin: once the check has passed, from where the host holds the arm, in the next tick that has a measurement.
    Start,
    /// Come to rest on the path.
    Stop,
    /// Give the desired motion back to the host. Only at rest.
    Release,
}
