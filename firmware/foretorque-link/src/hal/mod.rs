//! Hardware at the edge of the board, generic over embedded-hal 1.0: where a joint's position comes from, where its
//! torque goes, and the pin that lets it through.
//!
//! ```text
//! encoder (SPI) ──► q                      tau ──► MotorStage ──► TorqueOutput: PWM and direction, or SPI DAC
//!                                                     │  ▲
//!                                       enable output ┘  └ fault input
//! ```
//! Every call is bounded: at most three bus transfers and a few pin accesses, none of them in a loop.

mod dac;
mod enable;
mod encoder;
mod output;
mod pwm;
mod stage;

pub use dac::{DacModel, SpiDac};
pub use enable::TorqueEnable;
#[cfg(test)]
pub(crate) use encoder::chip::Chip;
pub use encoder::{AbsoluteEncoder, Direction, EncoderConfig, EncoderError, EncoderState};
pub use output::{OutputError, TorqueOutput};
pub use pwm::PwmWithDirection;
pub use stage::{Driven, MotorStage, StageError, TorqueScale};
