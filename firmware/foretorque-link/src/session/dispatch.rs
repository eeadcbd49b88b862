//! Messages of the host to protocol and controller.

use super::board::SAVE_INTERVAL_US;
use super::controller::Arrived;
use super::mailbox::{Order, Upload};
use super::protocol::Received;
use super::{Clock, LocalSensor, Mailboxes, Session};
use crate::excitation::ExcitationCommand;
use crate::safety::SafetyReason;
use crate::wire::{
    BankSource, BoardMessage, Capabilities, FrameBuffer, HostMessage, NackReason, Pacing,
    ReplyMode, size,
};
use foretorque::arm::Arm;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Takes bytes from the link, acts on every frame that they complete and replies into `out`.
    ///
    /// Cost: a few instructions a byte; the byte that ends a sample also runs the tick where samples pace the board.
    pub fn receive(
        &mut self,
        bytes: &[u8],
        mailboxes: &mut Mailboxes<N, P>,
        out: &mut FrameBuffer,
        sensor: &mut impl LocalSensor<N>,
    ) {
        for &byte in bytes {
            if self.reboot {
                return;
            }
            match self.protocol.receive(byte) {
                None => {}
                Some(Received::Message(sequence, HostMessage::Sample(sample))) => {
                    let (mailbox, clock) = (&mut mailboxes.learner, &self.board.clock);
                    let missed = self.protocol.counters.missed;
                    let arrived = Arrived {
                        sequence,
                        sample,
                        missed,
                    };
                    if let Some(tick) = self.controller.sample(arrived, mailbox, clock, sensor) {
                        self.send_tick(&tick, mailbox, out);
                    }
                }
                Some(Received::Message(sequence, message)) => {
                    let reply = match self.execute(sequence, message, mailboxes, sensor) {
                        Ok(Some(reply)) => reply,
                        Ok(None) => continue,
                        Err(reason) => BoardMessage::Nack(reason),
                    };
                    self.protocol.reply(sequence, &reply, out);
                }
                // The hello shows a host of another version what it is connected to.
                Some(Received::ForeignVersion) => self.send_hello(out),
            }
        }
    }

    /// Executes one command; `None` where the reply follows later.
    #[inline(never)]
    fn execute(
        &mut self,
        sequence: u16,
        message: HostMessage<N>,
        mailboxes: &mut Mailboxes<N, P>,
        sensor: &impl LocalSensor<N>,
    ) -> Result<Option<BoardMessage<N>>, NackReason> {
        // The processor may neither stand still nor restart while a drive is on.
        let interruptible = || match sensor.is_off() {
            true => Ok(()),
            false => Err(NackReason::Unsafe(SafetyReason::StillRamping)),
        };
        let (mailbox, parameters) = (&mut mailboxes.learner, &mut mailboxes.parameters);
        let Self {
            board,
            protocol,
            controller,
            ..
        } = self;
        if board.write_key.is_some()
            && let Some(order) = message.protected()
        {
            protocol.permitted(order)?;
        }
        match message {
            HostMessage::Hello => {
                // A host that begins anew inherits no torque and no motion.
                controller.safety.disarm();
                controller.stop_motion();
                // The next gap counts as a long one, and no reply has the number of another host's sample.
                controller.gaps.interrupt();
                controller.last_sequence = 0;
                return Ok(Some(self.hello()));
            }
            // A tick; `receive` runs it.
            HostMessage::Sample(_) => return Ok(None),
            HostMessage::Evaluate(motion) => {
                return Ok(Some(BoardMessage::Evaluated(controller.evaluate(&motion))));
            }
            HostMessage::Configure(wanted) => {
                parameters.undisturbed()?;
                controller.configurable(&wanted)?;
                board.sustains(wanted.period_us)?;
                if wanted.pacing == Pacing::SysTick {
                    board.require(Capabilities::TIMER)?;
                }
                controller.configure(wanted, board.write_key.is_some(), mailbox)?;
                protocol.stream.end();
            }
            HostMessage::Learning { on } => {
                if on {
                    board.require(Capabilities::LEARNING)?;
                    parameters.undisturbed()?;
                }
                controller.feed_forward.set_learning(on);
            }
            HostMessage::BankWrite { offset, bytes } => {
                controller.writable()?;
                parameters.idle()?;
                parameters.transfer.write(offset, &bytes)?;
            }
            HostMessage::BankCommit { length, crc, mac }
            | HostMessage::ExcitationLoad { length, crc, mac } => {
                controller.writable()?;
                parameters.idle()?;
                parameters.transfer.end(length)?;
                let signature = protocol.signature(board.write_key.as_ref(), mac)?;
                let upload = Upload { crc, signature };
                let order = match message {
                    HostMessage::BankCommit { .. } => Order::Commit(upload),
                    _ => Order::Excitation(upload),
                };
                return self.order(sequence, order, parameters);
            }
            HostMessage::BankRead { source, offset: 0 } => {
                parameters.idle()?;
                let state = controller.feed_forward.state();
                let set = match source {
                    BankSource::Live => &state.active,
                    BankSource::Committed => state.committed(),
                    BankSource::Stored => {
                        return self.order(sequence, Order::ReadStored, parameters);
                    }
                };
                parameters.read(sequence, Order::Read, set)?;
                return Ok(None);
            }
            HostMessage::BankRead { offset, .. } => {
                parameters.idle()?;
                return parameters.transfer.chunk(offset).map(Some);
            }
            HostMessage::Statistics => {
                let statistics = self.statistics(mailbox);
                return Ok(Some(BoardMessage::Statistics(statistics)));
            }
            HostMessage::Reset => {
                controller.at_rest()?;
                parameters.post(sequence, Order::Reset)?;
                return Ok(None);
            }
            HostMessage::Arm => {
                // The processor stands still while the flash is written.
                parameters.undisturbed()?;
                board.sustains(controller.configuration.period_us)?;
                controller.safety.arm().map_err(NackReason::Unsafe)?;
            }
            HostMessage::Disarm => controller.safety.disarm(),
            HostMessage::Stop => controller.stop(mailbox),
            HostMessage::ClearFault => {
                board.sound()?;
                controller.safety.clear().map_err(NackReason::Unsafe)?;
            }
            HostMessage::Request { code } => controller.request(code, mailbox)?,
            HostMessage::Save => {
                controller.writable()?;
                interruptible()?;
                if board.require(Capabilities::TIMER).is_ok() {
                    let left_us = SAVE_INTERVAL_US.saturating_sub(self.rested_us);
                    let seconds = left_us.div_ceil(1_000_000) as u8;
                    if seconds > 0 {
                        return Err(NackReason::Wait { seconds });
                    }
                }
                let state = controller.feed_forward.state();
                // With a key, learning starts at a signed set after every start.
                let set = match board.write_key {
                    Some(_) => state.loaded(),
                    None => state.committed(),
                };
                parameters.read(sequence, Order::Save, set)?;
                self.rested_us = 0;
                return Ok(None);
            }
            HostMessage::Restore => {
                return self.order(sequence, Order::Restore, parameters);
            }
            HostMessage::Telemetry { fields, every } => {
                let allowance = self.allowance();
                let stream = &mut self.protocol.stream;
                stream.begin::<N>(fields, every, allowance)?;
            }
            HostMessage::Challenge => {
                let key = board.write_key.as_ref().ok_or(NackReason::NotCapable)?;
                let seed = board.seed.as_ref().ok_or(NackReason::NotCapable)?;
                let nonce = protocol.challenge(key, seed);
                return Ok(Some(BoardMessage::Challenge { nonce }));
            }
            HostMessage::Unlock { order, mac } => {
                let key = board.write_key.as_ref().ok_or(NackReason::NotCapable)?;
                protocol.unlock(key, A::hash(), order, &mac)?;
            }
            HostMessage::Reboot => {
                parameters.undisturbed()?;
                controller.at_rest()?;
                interruptible()?;
                board.require(Capabilities::REBOOT)?;
                self.reboot = true;
            }
            HostMessage::Excitation(command) => {
                if command == ExcitationCommand::Start
                    && sensor.holds()
                    && controller.safety.at_rest()
                {
                    return Err(NackReason::Unsafe(SafetyReason::Disarmed));
                }
                return controller
                    .play(command)
                    .map(|state| Some(BoardMessage::Excitation(state)));
            }
        }
        Ok(Some(BoardMessage::Ack))
    }

    /// Bytes of telemetry that the link carries in one period besides the reply.
    fn allowance(&self) -> usize {
        let configuration = self.configuration();
        let reply = match configuration.reply {
            ReplyMode::Decimated => size::torque(N),
            ReplyMode::Full => size::full_torque(N),
        };
        self.board.link.left(configuration.period_us, reply)
    }
}
