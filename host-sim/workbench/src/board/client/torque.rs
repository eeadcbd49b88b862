//! Samples in, torques out, and what lets the torque flow.

use super::{BoardError, BoardShares, Client, TickReply, refused};
use foretorque::feedforward::Torque;
use foretorque::joint::JointSample;
use foretorque::limits::Flags;
use foretorque_link::excitation::{ExcitationCommand, ExcitationState};
use foretorque_link::safety::{ARM_SAMPLES, SafetyReason, SafetyState, SafetyStatus};
use foretorque_link::wire::{BoardMessage, HostMessage, NackReason, SampleFlags, SampleFrame};

/// Samples that a board is given, at most, to become ready to be armed.
const ARM_ATTEMPTS: u32 = 30;
/// Samples that a board is given, at most, to bring its torque to zero: the slowest brakes at the shortest period, twice.
const DISARM_SAMPLES: u32 = 20_000;

impl<const N: usize> Client<N> {
    /// Runs one tick with `sample` and returns its torque.
    ///
    /// Errors: as below; after [`BoardError::Timeout`] the sample counts as lost and the next one may follow.
    pub fn sample(&mut self, sample: &JointSample<N>) -> Result<TickReply<N>, BoardError> {
        self.sample_frame(&SampleFrame::new(sample))
    }

    /// [`sample`](Self::sample) for a frame made elsewhere: with currents, or temperatures. Its period is numbered here.
    pub fn sample_frame(&mut self, frame: &SampleFrame<N>) -> Result<TickReply<N>, BoardError> {
        let mut frame = frame.in_period(self.period);
        if self.patient {
            frame = frame.answered_after_learning();
        }
        self.skip_period();
        let sequence = self.post(&HostMessage::Sample(frame))?;
        let reply = self.wait_for(sequence, self.timeout)?;
        let reply = match reply {
            BoardMessage::Torque(reply) => Ok(TickReply {
                tick: reply.tick,
                flags: Flags(reply.flags),
                safety: reply.safety,
                total: reply.total.into(),
                shares: BoardShares::Joint(reply.tick as usize % N, reply.shares),
                excited: None,
            }),
            BoardMessage::Excited(reply) => Ok(TickReply {
                tick: reply.torque.tick,
                flags: Flags(reply.torque.flags),
                safety: reply.torque.safety,
                total: reply.torque.total.into(),
                shares: BoardShares::Joint(reply.torque.tick as usize % N, reply.torque.shares),
                excited: Some((reply.state, reply.desired())),
            }),
            BoardMessage::FullTorque(reply) => {
                let torque = Torque::from(&reply);
                Ok(TickReply {
                    tick: torque.tick,
                    flags: torque.flags,
                    safety: reply.safety,
                    total: torque.total,
                    shares: BoardShares::All(torque.shares),
                    excited: None,
                })
            }
            other => Err(refused(other)),
        }?;
        self.safety = reply.safety;
        self.presented = Some(SampleFrame {
            flags: SampleFlags::default(),
            ..frame
        });
        Ok(reply)
    }

    /// Safety state of the last reply.
    pub fn safety(&self) -> SafetyStatus {
        self.safety
    }

    /// Sends `sample` until the board has received enough of them, then arms it: its torque counts from the next sample on.
    ///
    /// Errors: as for every command; [`BoardError::Refused`] with the reason why the board must not be armed.
    pub fn arm(&mut self, sample: &JointSample<N>) -> Result<(), BoardError> {
        let mut shown = 0;
        loop {
            self.sample(sample)?;
            shown += 1;
            if shown < ARM_SAMPLES {
                continue;
            }
            match self.command(&HostMessage::Arm) {
                Err(BoardError::Refused(NackReason::Unsafe(SafetyReason::NoSample)))
                    if shown < ARM_ATTEMPTS => {}
                done => return done,
            }
        }
    }

    /// Disarms the board and goes on with the last desired motion until its torque is zero.
    ///
    /// Errors: as for every command; a board whose torque does not end is one of [`BoardError::UnexpectedAnswer`].
    pub fn disarm(&mut self) -> Result<(), BoardError> {
        self.command(&HostMessage::Disarm)?;
        let Some(frame) = self.presented else {
            return Ok(());
        };
        for _ in 0..DISARM_SAMPLES {
            if !torque_flows(self.safety.state) {
                return Ok(());
            }
            self.sample_frame(&frame)?;
        }
        Err(BoardError::UnexpectedAnswer)
    }

    /// Emergency stop: torque off at once; a fault is latched.
    pub fn stop(&mut self) -> Result<(), BoardError> {
        self.command(&HostMessage::Stop)
    }

    /// Has the board forget a latched fault.
    pub fn clear_fault(&mut self) -> Result<(), BoardError> {
        self.command(&HostMessage::ClearFault)
    }

    /// Disarms the board if its torque flows.
    pub(super) fn bring_to_rest(&mut self) -> Result<(), BoardError> {
        if torque_flows(self.safety.state) {
            self.disarm()?;
        }
        Ok(())
    }

    /// Starts, stops or releases the excitation on the board, or asks for it; where it then stands.
    pub fn excitation(
        &mut self,
        command: ExcitationCommand,
    ) -> Result<ExcitationState, BoardError> {
        match self.ask(&HostMessage::Excitation(command))? {
            BoardMessage::Excitation(stage) => Ok(stage),
            other => Err(refused(other)),
        }
    }
}

/// In this state the motor stage has torque.
fn torque_flows(state: SafetyState) -> bool {
    matches!(state, SafetyState::Armed | SafetyState::RampDown)
}
