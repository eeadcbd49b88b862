//! Arms on a bus of drives: transports, simulated drives, profiles, and the loop around them.

mod choice;
mod commission;
mod error;
mod player;
mod profile;
pub mod sim;
mod socketcan;
mod text;
mod timing;
mod udp;
mod wired;

pub use choice::BusChoice;
pub use commission::{Ask, Commissioning, Found, Operator, Step};
pub use error::BusError;
pub use player::{BusPlayer, Jitter};
pub use profile::{JointEntry, Profile};
pub use timing::{BitRates, frame_time_s};
pub use wired::{Line, WiredNetwork, real_time};

use foretorque_link::drives::Frame;
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
}

impl<W: Network + ?Sized> Network for Box<W> {
    fn name(&self) -> String {
        (**self).name()
    }

    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError> {
        (**self).send(bus, frame)
    }

    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError> {
        (**self).receive()
    }

    fn wait(&mut self) -> Duration {
        (**self).wait()
    }

    fn is_off(&self) -> bool {
        (**self).is_off()
    }
}
