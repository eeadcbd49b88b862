//! Commands of a host: banks, excitations and the board's store; samples, and what lets the torque flow.

use super::{BoardError, BoardShares, Client, TickReply, acknowledged, refused};
use foretorque::feedforward::Torque;
use foretorque::joint::{JointMotion, JointSample};
use foretorque::limits::Flags;
use foretorque_link::bank::ParameterBank;
use foretorque_link::excitation::{ExcitationCommand, ExcitationProgram, ExcitationState};
use foretorque_link::safety::{ARM_SAMPLES, SafetyReason, SafetyState, SafetyStatus};
use foretorque_link::wire::{
    Acceleration, BankSource, BoardMessage, CHUNK, Capabilities, HostMessage, MAC_BYTES,
    NackReason, Position, SampleFlags, SampleFrame, TorqueFrame, Velocity,
};
use foretorque_link::write_key::WriteKey;
use std::time::Duration;

/// How long the store may take: erasing a sector of 128 KiB takes up to 2 s (DS8626 table 48), and it has two.
const STORE_TIMEOUT: Duration = Duration::from_secs(10);
/// Samples that a board is given, at most, to become ready to be armed.
const ARM_ATTEMPTS: u32 = 30;
/// Samples that a board is given, at most, to bring its torque to zero: the slowest brakes at the shortest period, twice.
const DISARM_SAMPLES: u32 = 20_000;

impl<const N: usize> Client<N> {
    /// Disarms the board, sends `bank` and has the board take it over, whole or not at all. Learning must be off.
    pub fn upload_bank(&mut self, bank: &ParameterBank) -> Result<(), BoardError> {
        if bank.arm_hash != self.hello.arm_hash {
            let [found, wanted] = [
                (&bank.arm, bank.arm_hash),
                (&self.hello.arm, self.hello.arm_hash),
            ]
            .map(|(arm, hash)| format!("{arm} ({hash:08x})"));
            return Err(BoardError::WrongBank(found, wanted));
        }
        self.bring_to_rest()?;
        let mut buffer = [0; ParameterBank::MAX_BYTES];
        let bytes = bank.encode(&mut buffer).map_err(BoardError::Bank)?;
        self.upload(bytes, |length, crc, mac| HostMessage::BankCommit {
            length,
            crc,
            mac,
        })
    }

    /// Sends `program` and has the board take it over, whole or not at all. Learning must be off; the board's check runs
    /// in the ticks that follow.
    pub fn load_excitation(&mut self, program: &ExcitationProgram<N>) -> Result<(), BoardError> {
        let mut buffer = [0; ParameterBank::MAX_BYTES];
        let bytes = program
            .encode(&mut buffer)
            .expect("an excitation of few joints is shorter than a bank");
        self.upload(bytes, |length, crc, mac| HostMessage::ExcitationLoad {
            length,
            crc,
            mac,
        })
    }

    /// Sends `bytes` in pieces, then the message that has the board take over their length and checksum, signed where the board
    /// has a write key.
    fn upload(
        &mut self,
        bytes: &[u8],
        commit: impl Fn(u16, u32, Option<[u8; MAC_BYTES]>) -> HostMessage<N>,
    ) -> Result<(), BoardError> {
        let signed = self.challenge()?;
        let mac = signed.map(|(key, nonce)| key.sign_upload(&nonce, self.hello.arm_hash, bytes));
        for (place, chunk) in bytes.chunks(CHUNK).enumerate() {
            self.command(&HostMessage::BankWrite {
                offset: (place * CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            })?;
        }
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes);
        // Not asked twice: the first commit ends the upload, so a second would be refused although the first was good.
        let sequence = self.post(&commit(bytes.len() as u16, crc, mac))?;
        acknowledged(self.wait_for(sequence, self.timeout)?)
    }

    /// The bank in force on the board, what it has learnt included.
    pub fn read_bank(&mut self) -> Result<ParameterBank, BoardError> {
        self.read_bank_of(BankSource::Live)
    }

    /// One of the banks on the board.
    pub fn read_bank_of(&mut self, source: BankSource) -> Result<ParameterBank, BoardError> {
        let mut bank = Vec::new();
        loop {
            let wanted = bank.len() as u16;
            let question = HostMessage::BankRead {
                source,
                offset: wanted,
            };
            let (length, piece) = match self.ask(&question)? {
                BoardMessage::BankChunk {
                    offset,
                    length,
                    bytes,
                } if offset == wanted => (length, bytes),
                other => return Err(refused(other)),
            };
            bank.extend_from_slice(&piece);
            if bank.len() >= usize::from(length) || piece.is_empty() {
                return ParameterBank::decode(&bank).map_err(BoardError::Bank);
            }
        }
    }

    /// Has the board keep its parameters over power-off. The board is disarmed; learning must be off.
    pub fn save(&mut self) -> Result<(), BoardError> {
        self.bring_to_rest()?;
        self.unlock(&HostMessage::Save)?;
        // Not asked twice: what the store was asked for it does, however long it takes.
        let sequence = self.post(&HostMessage::Save)?;
        acknowledged(self.wait_for(sequence, STORE_TIMEOUT)?)
    }

    /// Permission of a protected order, where the board has a write key.
    pub(super) fn unlock(&mut self, message: &HostMessage<N>) -> Result<(), BoardError> {
        let Some(order) = message.protected() else {
            return Ok(());
        };
        match self.challenge()? {
            None => Ok(()),
            Some((key, nonce)) => {
                let mac = key.sign_order(&nonce, self.hello.arm_hash, order);
                self.command(&HostMessage::Unlock { order, mac })
            }
        }
    }

    /// Key and challenge, where the board has a write key.
    fn challenge(&mut self) -> Result<Option<(WriteKey, [u8; MAC_BYTES])>, BoardError> {
        if !self.hello.capabilities.contains(Capabilities::WRITE_KEY) {
            return Ok(None);
        }
        let key = self.key.ok_or(BoardError::NoKey)?;
        match self.ask(&HostMessage::Challenge)? {
            BoardMessage::Challenge { nonce } => Ok(Some((key, nonce))),
            other => Err(refused(other)),
        }
    }

    /// Runs one tick with `sample` and returns its torque.
    ///
    /// Errors: as below; after [`BoardError::Timeout`] the sample counts as lost and the next one may follow;
    /// [`BoardError::BeyondSample`] before anything is sent.
    pub fn sample(&mut self, sample: &JointSample<N>) -> Result<TickReply<N>, BoardError> {
        let JointMotion { q, qd, qdd } = &sample.desired;
        for (values, unit, range) in [
            (q, "rad", Position::MAX),
            (qd, "rad/s", Velocity::MAX),
            (qdd, "rad/s²", Acceleration::MAX),
        ] {
            if let Some(joint) = values.iter().position(|value| value.abs() > range) {
                return Err(BoardError::BeyondSample(
                    joint + 1,
                    values[joint],
                    unit,
                    range,
                ));
            }
        }
        let mut frame = SampleFrame::new(sample);
        if let (Some(gains), Some(measured)) = (&self.gains, &sample.measured) {
            frame = frame.with_current(&measured.tau.component_div(gains));
        }
        self.sample_frame(&frame)
    }

    /// [`sample`](Self::sample) for a frame made elsewhere: with currents, or temperatures. Its period is numbered here.
    pub fn sample_frame(&mut self, frame: &SampleFrame<N>) -> Result<TickReply<N>, BoardError> {
        let mut frame = frame.in_period(self.period);
        if self.waits_for_learning {
            frame = frame.answered_after_learning();
        }
        self.skip_period();
        let sequence = self.post(&HostMessage::Sample(frame))?;
        let of_joint = |reply: TorqueFrame<N>, excited| TickReply {
            tick: reply.tick,
            flags: Flags(reply.flags),
            safety: reply.safety,
            total: reply.total.into(),
            shares: BoardShares::Joint(reply.tick as usize % N, reply.shares),
            excited,
        };
        let reply = match self.wait_for(sequence, self.timeout)? {
            BoardMessage::Torque(reply) => of_joint(reply, None),
            BoardMessage::Excited(reply) => {
                let excited = (reply.state, reply.desired());
                of_joint(reply.torque, Some(excited))
            }
            BoardMessage::FullTorque(reply) => {
                let torque = Torque::from(&reply);
                TickReply {
                    tick: torque.tick,
                    flags: torque.flags,
                    safety: reply.safety,
                    total: torque.total,
                    shares: BoardShares::All(torque.shares),
                    excited: None,
                }
            }
            other => return Err(refused(other)),
        };
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

fn torque_flows(state: SafetyState) -> bool {
    matches!(state, SafetyState::Armed | SafetyState::RampDown)
}
