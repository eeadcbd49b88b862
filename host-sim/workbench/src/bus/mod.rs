//! Arms on a bus of drives: transports, simulated drives, profiles, and the loop around them.

mod choice;
mod commission;
mod player;
mod profile;
pub mod sim;
mod socketcan;
mod text;
mod udp;
mod wired;

pub use choice::BusChoice;
pub use commission::{Ask, Commissioning, Found, Step};
pub use player::{BusPlayer, Jitter};
pub use profile::{BitRates, JointEntry, Profile, frame_time_s};
pub use wired::{Line, WiredNetwork, real_time};

use foretorque_link::bus::{BusConfigError, BusFault};
use foretorque_link::drives::Frame;
use foretorque_link::safety::SafetyReason;
use std::io;
use std::time::Duration;

/// Buses of one arm, with the clock of their loop.
pub trait Network {
    /// Name for messages.
    fn name(&self) -> String;

    /// Sends a frame; one that the queue has no room for is lost.
    ///
    /// Errors: the bus has gone.
    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError>;

    /// Next frame that has arrived, without waiting.
    ///
    /// Errors: the bus has gone.
    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError>;

    /// Waits for the next period: how late it begins.
    fn wait(&mut self) -> Duration;

    /// A controller has left its bus because of too many errors.
    fn is_off(&self) -> bool {
        false
    }

    /// Asks somebody who stands beside the arm to move it; returns when it is done.
    ///
    /// Errors: nobody is there.
    fn ask(&mut self, _: &Ask) -> Result<(), BusError> {
        let (name, error) = (self.name(), io::ErrorKind::Unsupported.into());
        Err(BusError::Gone { name, error })
    }
}

/// Reason for which an arm on a bus cannot be driven.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The profile cannot be read.
    #[error("{file}: {problem}")]
    Profile {
        /// File.
        file: String,
        /// Reason, with the field.
        problem: String,
    },
    /// The profile contradicts itself or the arm.
    #[error("{file}: {error}")]
    Contradiction {
        /// File.
        file: String,
        /// The two values.
        error: BusConfigError,
    },
    /// The bus cannot be opened.
    #[error("bus {name}: {error}")]
    Open {
        /// Name of the bus.
        name: String,
        /// Reason.
        error: io::Error,
    },
    /// The bus has gone.
    #[error("bus {name} has gone, torque off: {error}")]
    Gone {
        /// Name of the bus.
        name: String,
        /// Reason.
        error: io::Error,
    },
    /// Nothing answers.
    #[error("bus {0} is silent, torque off: no drive of the profile answers")]
    Quiet(String),
    /// The user has ended it.
    #[error("interrupted after {0} periods, torque off")]
    Interrupted(u32),
    /// Commissioning has found a mistake.
    #[error("joint {}: {mistake}", joint + 1)]
    Mistake {
        /// Joint, from 0.
        joint: usize,
        /// The mistake, with the value of the profile and the one found.
        mistake: String,
    },
    /// A drive or the bus has a fault.
    #[error("torque off: {0}")]
    Fault(BusFault),
    /// The torque has ended for another reason.
    #[error("torque off: {0}")]
    Stopped(SafetyReason),
}
