//! What a host can ask of a board besides torque. A command that fails has changed nothing.

use super::link::LinkState;
use super::sample_gaps::SampleGaps;
use super::{Clock, Session, seconds};
use crate::bank::{BankError, NETWORK_SEED};
use crate::excitation::{ExcitationCommand, ExcitationError, Player};
use crate::safety::SafetyLimits;
use crate::session::LearnerMailbox;
use crate::telemetry::CostMeter;
use crate::wire::{
    BankSource, BoardMessage, Capabilities, Configuration, Decoder, FrameBuffer, MAC_BYTES,
    NackReason, Pacing, SampleFrame,
};
use foretorque::arm::Arm;
use foretorque::learning::{ParameterSet, Request};

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Parameters may be written: no torque flows, and nothing is learnt.
    pub(super) fn writable(&self) -> Result<(), NackReason> {
        if !self.safety.at_rest() {
            Err(NackReason::Armed)
        } else if self.feed_forward.state().learning {
            Err(NackReason::LearningOn)
        } else {
            Ok(())
        }
    }

    pub(super) fn set_learning(&mut self, on: bool) -> Result<(), NackReason> {
        if on && !self.board.capabilities.contains(Capabilities::LEARNING) {
            return Err(NackReason::NotCapable);
        }
        if on {
            // An upload is for a board that does not learn; half of one must not wait for the learning to end.
            self.transfer.abort();
        }
        self.feed_forward.set_learning(on);
        Ok(())
    }

    #[inline(never)]
    pub(super) fn configure(
        &mut self,
        wanted: Configuration,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        self.writable()?;
        if self.player.state().is_active() {
            return Err(NackReason::Excitation(ExcitationError::Running));
        }
        if !Configuration::PERIODS_US.contains(&wanted.period_us) {
            return Err(NackReason::Period);
        }
        if wanted.pacing == Pacing::SysTick
            && !self.board.capabilities.contains(Capabilities::TIMER)
        {
            return Err(NackReason::NotCapable);
        }
        let set = self.feed_forward.state().active;
        self.restart(wanted, &set, mailbox)
    }

    /// The tick starts over at 0 with `set`, and so does the learner. Changes nothing when it fails.
    #[inline(never)]
    fn restart(
        &mut self,
        configuration: Configuration,
        set: &ParameterSet<N, P>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        let period_s = seconds(&configuration);
        let config = self.bank.feed_forward_config::<A, N, P>(period_s);
        let config = config.map_err(NackReason::Bank)?;
        self.feed_forward
            .restart(config, set)
            .map_err(|_| NackReason::Period)?;
        self.configuration = configuration;
        self.player = Player::new::<A, P>(configuration.period_us);
        self.safety.restart(SafetyLimits::for_arm::<A, P>(period_s));
        self.stream.end();
        self.newest = None;
        self.periods = SampleGaps::new();
        mailbox.restart(period_s, set);
        Ok(())
    }

    /// Takes over the uploaded bank, all of it or nothing.
    #[inline(never)]
    pub(super) fn commit(
        &mut self,
        length: u16,
        crc: u32,
        mac: Option<[u8; MAC_BYTES]>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        self.writable()?;
        self.signed(mac)?;
        self.transfer.commit(length, crc, &mut self.incoming)?;
        self.take_over(mailbox)
    }

    /// Takes over a set that the store kept, all of it or nothing: at boot, or when the host asks for it.
    ///
    /// Errors: [`NackReason::Armed`], [`NackReason::LearningOn`], [`NackReason::Bank`].
    #[inline(never)]
    pub fn restore(
        &mut self,
        bytes: &[u8],
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        self.writable()?;
        self.transfer.abort();
        self.incoming.decode_into(bytes).map_err(NackReason::Bank)?;
        self.take_over(mailbox)
    }

    /// Makes the bank that came in the one in force, if it is one for this board.
    pub(super) fn take_over(
        &mut self,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        let gains = self.incoming.drive_gains().map_err(NackReason::Bank)?;
        let set = self.incoming.set::<A, N, P>().map_err(NackReason::Bank)?;
        let period_s = seconds(&self.configuration);
        let config = self.incoming.feed_forward_config::<A, N, P>(period_s);
        let config = config.map_err(NackReason::Bank)?;
        self.feed_forward
            .configure(config)
            .map_err(|_| NackReason::Bank(BankError::Limit(0)))?;
        self.feed_forward.load(set, &mut mailbox.exchange);
        self.gains = gains;
        core::mem::swap(&mut self.bank, &mut self.incoming);
        Ok(())
    }

    /// Takes over the uploaded excitation, all of it or nothing.
    #[inline(never)]
    pub(super) fn load_excitation(
        &mut self,
        length: u16,
        crc: u32,
        mac: Option<[u8; MAC_BYTES]>,
    ) -> Result<(), NackReason> {
        self.writable()?;
        self.signed(mac)?;
        let program = self.transfer.program(length, crc)?;
        self.player.load(&program).map_err(NackReason::Excitation)
    }

    pub(super) fn excitation(
        &mut self,
        command: ExcitationCommand,
    ) -> Result<BoardMessage<N>, NackReason> {
        self.player
            .command(command)
            .map_err(NackReason::Excitation)?;
        Ok(BoardMessage::Excitation(self.player.state()))
    }

    /// Answers with a piece of a bank; that of the stored one comes when the store has brought it.
    #[inline(never)]
    pub(super) fn read(
        &mut self,
        sequence: u16,
        source: BankSource,
        offset: u16,
        mailbox: &mut LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
    ) {
        let taken = match (source, offset) {
            (_, 1..) => Ok(()),
            (BankSource::Stored, 0) => match self.fetch(sequence, true, mailbox) {
                Ok(()) => return,
                Err(reason) => Err(reason),
            },
            (BankSource::Live | BankSource::Committed, 0) => {
                let state = self.feed_forward.state();
                let set = match source {
                    BankSource::Committed => &state.committed,
                    _ => &state.active,
                };
                self.bank.refresh::<A, N, P>(set);
                let taken = self.transfer.snapshot(&self.bank);
                taken.map_err(NackReason::Bank)
            }
        };
        match taken {
            Ok(()) => self.read_on(sequence, offset, out),
            Err(reason) => self.answer(sequence, &BoardMessage::Nack(reason), out),
        }
    }

    /// Answers with a piece of the snapshot.
    pub(super) fn read_on(&mut self, sequence: u16, offset: u16, out: &mut FrameBuffer) {
        let answer = match self.transfer.read(offset) {
            Ok((length, bytes)) => BoardMessage::BankChunk {
                offset,
                length,
                bytes,
            },
            Err(reason) => BoardMessage::Nack(reason),
        };
        self.answer(sequence, &answer, out);
    }

    pub(super) fn write(&mut self, offset: u16, bytes: &[u8]) -> Result<(), NackReason> {
        self.writable()?;
        self.transfer.write(offset, bytes)
    }

    /// Emergency stop, of the torque and of the learning: what led to it may not be fit to learn from.
    pub(super) fn stop(&mut self, mailbox: &mut LearnerMailbox<N, P>) {
        self.safety.stop();
        self.feed_forward.applied(self.safety.output());
        // It takes the place of a request that still waits.
        self.feed_forward
            .request_over(Request::Stop, &mut mailbox.exchange);
    }

    pub(super) fn request(
        &mut self,
        code: u8,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        // The learner's own stop belongs to the emergency stop alone.
        let request = Request::from_code(code).filter(|&request| request != Request::Stop);
        let request = request.ok_or(NackReason::NotCapable)?;
        self.feed_forward
            .request(request, &mut mailbox.exchange)
            .map_err(|_| NackReason::Busy)
    }

    pub(super) fn ask_for_reboot(&mut self) -> Result<(), NackReason> {
        if !self.board.capabilities.contains(Capabilities::REBOOT) {
            return Err(NackReason::NotCapable);
        }
        self.reboot = true;
        Ok(())
    }

    /// What the signature of the next upload has to be over.
    #[inline(never)]
    pub(super) fn challenge(&mut self) -> Result<[u8; MAC_BYTES], NackReason> {
        let key = self.board.write_key.ok_or(NackReason::NotCapable)?;
        let nonce = key.challenge(&self.board.seed, self.challenges);
        self.challenges = self.challenges.wrapping_add(1);
        self.challenge = Some(nonce);
        Ok(nonce)
    }

    /// The upload may be taken over, as far as the write key is concerned. A challenge is used up; a refused upload is
    /// over.
    #[inline(never)]
    fn signed(&mut self, mac: Option<[u8; MAC_BYTES]>) -> Result<(), NackReason> {
        let Some(key) = &self.board.write_key else {
            return Ok(());
        };
        let verified = match (self.challenge.take(), mac) {
            (Some(nonce), Some(mac)) => key.verifies(&mac, &nonce, A::HASH, self.transfer.come()),
            _ => false,
        };
        if verified {
            return Ok(());
        }
        self.transfer.abort();
        Err(NackReason::Key)
    }

    pub(super) fn arm(&mut self, mailbox: &LearnerMailbox<N, P>) -> Result<(), NackReason> {
        // While the flash is written the processor stands still.
        if mailbox.store.is_busy() {
            return Err(NackReason::Busy);
        }
        self.safety.arm().map_err(NackReason::Unsafe)
    }

    #[inline(never)]
    pub(super) fn reset(
        &mut self,
        sequence: u16,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        if !self.safety.at_rest() {
            return Err(NackReason::Armed);
        }
        let set = ParameterSet::nominal::<A>(NETWORK_SEED);
        self.bank.describe::<A, N, P>();
        self.bank.refresh::<A, N, P>(&set);
        self.gains = [0.0; N];
        self.transfer.abort();
        self.restart(Configuration::default(), &set, mailbox)?;
        self.decoder = Decoder::new();
        self.link = LinkState::after(sequence);
        self.temperatures_c = [SampleFrame::<N>::NO_TEMPERATURE; N];
        self.ticks = 0;
        self.tick_cost = CostMeter::new();
        mailbox.learning_samples_lost = 0;
        mailbox.learn_cost = CostMeter::new();
        Ok(())
    }
}
