//! Hardware adapters, generic over embedded-hal 1.0: encoder, torque output and enable pin of a joint.
//!
//! ```text
//! encoder (SPI) ──► q                      tau ──► MotorStage ──► TorqueOutput: PWM and direction, or SPI DAC
//!                                                     │  ▲
//!                                       enable output ┘  └ fault input
//! ```
//! Every call is bounded: at most three bus transfers and a few pin accesses, without loops.

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
