//! Drive of a board's own joint: encoder in, torque out, around the ticks of a session.
//!
//! ```text
//! check ──► session: sample ─► encoder's position in ─► step ─► safety ──► apply ──► enable, torque command
//!   ▲                                                                       │
//!   └──────────────────── fault input of the stage ◄────────────────────────┘
//! ```
//! An error of the stage switches it off first; then the session latches the reason and replies with zero torque. An error
//! of the encoder is a fault of the tick's input: the measurement is dropped, and lasting errors end the torque.

use crate::hal::{AbsoluteEncoder, EncoderError, MotorStage, StageError, TorqueOutput};
use crate::safety::SafetyReason;
use crate::session::{Clock, LocalSensor, Session};
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::spi::SpiDevice;
use foretorque::arm::Arm;
use foretorque::joint::JointSample;

/// Motor stage of a board's own joint, which follows the safety of the session.
#[derive(Debug)]
pub struct JointStage<Output, Enable, Fault> {
    stage: MotorStage<Output, Enable, Fault>,
    joint: usize,
    /// Bits of the last torque command, so that only a change is sent.
    commanded: Option<u32>,
    last_error: Option<StageError>,
}

impl<Output, Enable, Fault> JointStage<Output, Enable, Fault>
where
    Output: TorqueOutput,
    Enable: OutputPin,
    Fault: InputPin,
{
    /// The stage of `joint`, counted from 0.
    pub const fn new(stage: MotorStage<Output, Enable, Fault>, joint: usize) -> Self {
        Self {
            stage,
            joint,
            commanded: None,
            last_error: None,
        }
    }

    /// Last error of the stage; stays until the stage is switched on again.
    pub const fn last_error(&self) -> Option<StageError> {
        self.last_error
    }

    /// Before a tick: switches a stage with a fault off and reports it to the session.
    ///
    /// Cost: one read of a pin.
    pub fn check<A: Arm<N, P>, const N: usize, const P: usize, C: Clock>(
        &mut self,
        session: &mut Session<A, N, P, C>,
    ) {
        let checked = self.stage.check();
        self.report(checked, session);
    }

    /// After a tick: sets enable and torque command to those of the session's safety.
    ///
    /// Cost: one read of a pin and one command; nothing where neither enable nor torque have changed.
    pub fn apply<A: Arm<N, P>, const N: usize, const P: usize, C: Clock>(
        &mut self,
        session: &mut Session<A, N, P, C>,
    ) {
        let wanted = session.torque_output().get(self.joint);
        // A joint that the arm does not have gets no torque.
        let tau_nm = wanted.copied().unwrap_or(0.0);
        let done = if session.torque_enabled() {
            self.put_out(tau_nm)
        } else if self.stage.is_enabled() {
            self.stage.disable()
        } else {
            Ok(())
        };
        self.report(done, session);
    }

    fn put_out(&mut self, tau_nm: f32) -> Result<(), StageError> {
        if !self.stage.is_enabled() {
            self.stage.enable()?;
            self.commanded = None;
            self.last_error = None;
        }
        if self.commanded != Some(tau_nm.to_bits()) {
            self.commanded = None;
            self.stage.drive(tau_nm)?;
            self.commanded = Some(tau_nm.to_bits());
        }
        Ok(())
    }

    fn report<A: Arm<N, P>, const N: usize, const P: usize, C: Clock>(
        &mut self,
        done: Result<(), StageError>,
        session: &mut Session<A, N, P, C>,
    ) {
        if let Err(error) = done {
            self.last_error = Some(error);
            session.torque_off(reason(error));
        }
    }
}

fn reason(error: StageError) -> SafetyReason {
    match error {
        StageError::Fault | StageError::FaultInput => SafetyReason::Drive,
        StageError::NotFinite => SafetyReason::TorqueNotFinite,
        StageError::Scale | StageError::Disabled | StageError::Output(_) | StageError::Enable => {
            SafetyReason::Stage
        }
    }
}

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
        if self.encoder.has_turn() || !at_rest {
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

    /// Counts turns on.
    fn silence(&mut self) {
        let _ = self.encoder.position();
    }

    fn miss(&mut self, periods: u32) {
        self.encoder.miss(periods);
    }
}

#[cfg(test)]
mod tests;
