use crate::hal::{AbsoluteEncoder, EncoderError};
use crate::safety::SafetyReason;
use crate::session::LocalSensor;
use embedded_hal::spi::SpiDevice;
use foretorque::joint::JointSample;

/// Source of the turn of a single-turn encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TurnReference {
    /// Position within half a turn of the encoder, rad, at start and wherever the count is lost. For encoders on the link
    /// side, one turn of which is the range of the joint.
    Near(f32),
    /// Measured position in the sample of the host, once. For encoders behind a gear: the host must measure the joint to
    /// half a turn of the encoder.
    FromSample,
}

/// Encoder of a board's own joint, read once a tick.
#[derive(Debug)]
pub struct JointEncoder<Spi> {
    encoder: AbsoluteEncoder<Spi>,
    joint: usize,
    turn: TurnReference,
    last_error: Option<EncoderError>,
}

impl<Spi: SpiDevice> JointEncoder<Spi> {
    /// The encoder of `joint`, counted from 0, without access to it.
    pub const fn new(encoder: AbsoluteEncoder<Spi>, joint: usize, turn: TurnReference) -> Self {
        Self {
            encoder,
            joint,
            turn,
            last_error: None,
        }
    }

    /// Error of the reading of the last tick.
    pub const fn last_error(&self) -> Option<EncoderError> {
        self.last_error
    }

    /// Reads the position; restores a lost turn at rest only, because a wrong turn moves the joint while torque flows.
    fn read(&mut self, sampled: Option<f32>, at_rest: bool) -> Result<f32, EncoderError> {
        if self.encoder.state().position.is_some() || !at_rest {
            return self.encoder.position();
        }
        self.encoder.reference(match self.turn {
            TurnReference::Near(q) => q,
            // NaN is refused after the reading, so that the sequence of frames continues.
            TurnReference::FromSample => sampled.unwrap_or(f32::NAN),
        })
    }
}

impl<Spi: SpiDevice, const N: usize> LocalSensor<N> for JointEncoder<Spi> {
    fn measure(&mut self, sample: &mut Option<JointSample<N>>, at_rest: bool) -> SafetyReason {
        let measured = sample.as_mut().and_then(|sample| sample.measured.as_mut());
        let slot = measured.and_then(|measured| measured.q.get_mut(self.joint));
        match self.read(slot.as_deref().copied(), at_rest) {
            Ok(q) => {
                if let Some(slot) = slot {
                    *slot = q;
                }
                self.last_error = None;
                SafetyReason::None
            }
            Err(error) => {
                self.last_error = Some(error);
                SafetyReason::Encoder
            }
        }
    }
}
