//! Excitation played by the board, as a commissioning step: the finite Fourier series of eq. 17 in f32. The board checks an
//! upload against its certificate and aborts it at limits of its own.
//!
//! ```text
//! q(t)   = q0 + Σ_l a_l / (ω l) sin(ω l t) − b_l / (ω l) cos(ω l t)          ω = 2 π / period, l = 1 … 5
//! qd(t)  =      Σ_l a_l cos(ω l t) + b_l sin(ω l t)
//! qdd(t) =      Σ_l ω l (b_l cos(ω l t) − a_l sin(ω l t))
//! ```
//! The position line is eq. 17 as printed; velocity and acceleration are its derivatives, which the printed ones are not.
//!
//! ```text
//!            load            start, check passed      at q(0)          stop, end, or a limit
//!   Empty ────────► Loaded ─────────────────► Approaching ──► Playing ────────────────► Holding / Aborted
//!                     │ check failed                              (path speed ramped to zero)     │ start: from the beginning
//!                     └────────► Refused                                                          └ release: Loaded
//! ```
//! A host runs this code through a board in its own process, so both give the same bits.

mod check;
mod path;
mod player;
mod program;
mod series;

pub use player::Player;
pub use program::{AbortReason, ExcitationError, ExcitationProgram, MotionBounds, PlayLimits};
use serde::{Deserialize, Serialize};
pub use series::{HARMONICS, JointSeries, PreparedSeries};

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
