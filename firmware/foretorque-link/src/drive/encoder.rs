use crate::hal::{AbsoluteEncoder, EncoderError};
use crate::safety::SafetyReason;
use crate::session::LocalSensor;
use embedded_hal::spi::SpiDevice;
use foretorque::joint::JointSample;

/// Where the turn comes from in which a single-turn encoder stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TurnReference {
    /// At start, and wherever the count is lost, the joint is less than half a turn of the encoder from here, rad. For
    /// encoders on the link's side, one turn of which is the joint's range.
    Near(f32),
    /// The host's measured position of the joint tells it, once. For encoders behind a gear: the host must know the joint
    /// to half a turn of the encoder.
    FromSample,
}

/// The encoder of a board's own joint, as the session reads it: once a tick.
#[derive(Debug)]
pub struct JointEncoder<Spi> {
    encoder: AbsoluteEncoder<Spi>,
    joint: usize,
    turn: TurnReference,
    last_error: Option<EncoderError>,
}

impl<Spi: SpiDevice> JointEncoder<Spi> {
    /// The encoder of `joint`, counted from 0. Says nothing to it.
    pub const fn new(encoder: AbsoluteEncoder<Spi>, joint: usize, turn: TurnReference) -> Self {
        Self {
            encoder,
            joint,
            turn,
            last_error: None,
        }
    }

    /// Error of the last tick's reading.
    pub const fn last_error(&self) -> Option<EncoderError> {
        self.last_error
    }

    /// Where a lost turn is found again, at rest only: a reference taken while torque flows could put the joint a whole
    /// turn away from where the controller holds it.
    fn read(&mut self, told: Option<f32>, at_rest: bool) -> Result<f32, EncoderError> {
        if self.encoder.state().position.is_some() || !at_rest {
            return self.encoder.position();
        }
        self.encoder.reference(match self.turn {
            TurnReference::Near(q) => q,
            // A position that is none is refused, after the reading: the questions to the chip go on.
            TurnReference::FromSample => told.unwrap_or(f32::NAN),
        })
    }
}

impl<Spi: SpiDevice> LocalSensor for JointEncoder<Spi> {
    fn measure<const N: usize>(
        &mut self,
        sample: Option<&mut JointSample<N>>,
        at_rest: bool,
    ) -> SafetyReason {
        let measured = sample.and_then(|sample| sample.measured.as_mut());
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
