//! Hardware adapters, generic over embedded-hal 1.0: encoder, torque output and enable pin of a joint.
//!
//! ```text
//! encoder (SPI) ──► q                      tau ──► MotorStage ──► TorqueOutput: PWM and direction, or SPI DAC
//!                                                     │  ▲
//!                                       enable output ┘  └ fault input
//! ```
//! Every call is bounded: at most three bus transfers and a few pin accesses, without loops.

mod enable;
mod encoder;
mod output;
mod stage;

pub use enable::TorqueEnable;
#[cfg(test)]
pub(crate) use encoder::tests::Chip;
pub use encoder::{AbsoluteEncoder, Direction, EncoderConfig, EncoderError, EncoderState};
pub use output::{DacModel, OutputError, PwmWithDirection, SpiDac, TorqueOutput};
pub use stage::{Driven, MotorStage, StageError, TorqueScale};
