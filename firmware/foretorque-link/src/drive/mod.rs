//! A board that drives its own joint: encoder in, torque out, around the ticks of a session.
//!
//! ```text
//! watch ──► session: sample ─► encoder's position in ─► step ─► safety ──► follow ──► enable, torque command
//!   ▲                                                                        │
//!   └──────────────────── fault input of the stage ◄─────────────────────────┘
//! ```
//! Whatever goes wrong with the stage switches it off first; then the session is told, which latches the reason and answers
//! zero torque from then on. What goes wrong with the encoder is a matter of the tick's input: a measurement is dropped, and
//! a torque that flows ends when that lasts.

mod encoder;

pub use encoder::{JointEncoder, TurnReference};

use crate::hal::{MotorStage, StageError, TorqueOutput};
use crate::safety::SafetyReason;
use crate::session::{Clock, Session};
use embedded_hal::digital::{InputPin, OutputPin};
use foretorque::arm::Arm;

/// The motor stage of a board's own joint, which goes where the session's safety goes.
#[derive(Debug)]
pub struct JointStage<Output, Enable, Fault> {
    stage: MotorStage<Output, Enable, Fault>,
    joint: usize,
    /// Bits of the torque that was put out last, so that a command goes out once a tick.
    told: Option<u32>,
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
            told: None,
            last_error: None,
        }
    }

    /// Last error of the stage. It stays until the stage is switched on again.
    pub const fn last_error(&self) -> Option<StageError> {
        self.last_error
    }

    /// Before a tick: a stage with a fault is off, and the session knows.
    ///
    /// Cost: one read of a pin.
    pub fn check<A: Arm<N, P>, const N: usize, const P: usize, C: Clock>(
        &mut self,
        session: &mut Session<A, N, P, C>,
    ) {
        let checked = self.stage.check();
        self.tell(checked, session);
    }

    /// After a tick: enable and torque command are what the session's safety says.
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
        } else {
            self.end()
        };
        self.tell(done, session);
    }

    fn put_out(&mut self, tau_nm: f32) -> Result<(), StageError> {
        if !self.stage.is_enabled() {
            self.stage.enable()?;
            self.told = None;
            self.last_error = None;
        }
        if self.told != Some(tau_nm.to_bits()) {
            self.told = None;
            self.stage.drive(tau_nm)?;
            self.told = Some(tau_nm.to_bits());
        }
        Ok(())
    }

    fn end(&mut self) -> Result<(), StageError> {
        if self.stage.is_enabled() {
            self.stage.disable()?;
        }
        Ok(())
    }

    fn tell<A: Arm<N, P>, const N: usize, const P: usize, C: Clock>(
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

/// Reason that the host gets.
fn reason(error: StageError) -> SafetyReason {
    match error {
        StageError::Fault | StageError::FaultInput => SafetyReason::Drive,
        StageError::NotFinite => SafetyReason::TorqueNotFinite,
        StageError::Scale | StageError::Disabled | StageError::Output(_) | StageError::Enable => {
            SafetyReason::Stage
        }
    }
}

#[cfg(test)]
mod tests;
