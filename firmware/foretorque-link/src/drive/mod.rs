//! Drive of a board's own joint: encoder in, torque out, around the ticks of a session.
//!
//! ```text
//! check ──► session: sample ─► encoder's position in ─► step ─► safety ──► apply ──► enable, torque command
//!   ▲                                                                       │
//!   └──────────────────── fault input of the stage ◄────────────────────────┘
//! ```
//! An error of the stage switches it off first; then the session latches the reason and replies with zero torque. An error
//! of the encoder is a fault of the tick's input: the measurement is dropped, and lasting errors end the torque.

mod encoder;

pub use encoder::{JointEncoder, TurnReference};

use crate::hal::{MotorStage, StageError, TorqueOutput};
use crate::safety::SafetyReason;
use crate::session::{Clock, Session};
use embedded_hal::digital::{InputPin, OutputPin};
use foretorque::arm::Arm;

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
        } else {
            self.end()
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

    fn end(&mut self) -> Result<(), StageError> {
        if self.stage.is_enabled() {
            self.stage.disable()?;
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

/// Reason that the host receives.
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
