//! Messages of the host to protocol and controller.

use super::protocol::Received;
use super::{Clock, LocalSensor, Mailboxes, Session};
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
        sensor: &mut impl LocalSensor,
    ) {
        for &byte in bytes {
            if self.reboot {
                return;
            }
            match self.protocol.receive(byte) {
                None => {}
                Some(Received::Message(sequence, HostMessage::Sample(sample))) => {
                    let mailbox = &mut mailboxes.learner;
                    let (missed, clock) = (self.protocol.link.missed, &self.board.clock);
                    let tick = self
                        .controller
                        .sample(sequence, sample, missed, mailbox, clock, sensor);
                    if let Some(tick) = tick {
                        self.send_tick(&tick, mailbox, out);
                    }
                }
                Some(Received::Message(sequence, message)) => {
                    let reply = match self.execute(sequence, message, mailboxes) {
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
    ) -> Result<Option<BoardMessage<N>>, NackReason> {
        let Self {
            board,
            protocol,
            controller,
            ..
        } = self;
        let mailbox = &mut mailboxes.learner;
        match message {
            HostMessage::Hello => {
                controller.interrupt_samples();
                // A host that begins anew inherits no torque.
                controller.disarm();
                return Ok(Some(self.hello()));
            }
            // A tick; `receive` runs it.
            HostMessage::Sample(_) => return Ok(None),
            HostMessage::Evaluate(motion) => {
                return Ok(Some(BoardMessage::Evaluated(controller.evaluate(&motion))));
            }
            HostMessage::Configure(wanted) => {
                controller.configurable(&wanted)?;
                if wanted.pacing == Pacing::SysTick {
                    board.require(Capabilities::TIMER)?;
                }
                controller.configure(wanted, mailbox)?;
                protocol.stream.end();
            }
            HostMessage::Learning { on } => {
                if on {
                    board.require(Capabilities::LEARNING)?;
                    // An upload is refused while learning: half of one must not wait until learning ends.
                    protocol.transfer.abort();
                }
                controller.set_learning(on);
            }
            HostMessage::BankWrite { offset, bytes } => {
                controller.writable()?;
                protocol.transfer.write(offset, &bytes)?;
            }
            HostMessage::BankCommit { length, crc, mac } => {
                controller.writable()?;
                protocol.authorise(board.write_key.as_ref(), mac, A::hash())?;
                protocol
                    .transfer
                    .commit(length, crc, controller.incoming())?;
                controller.take_over(mailbox)?;
            }
            HostMessage::BankRead { source, offset } => {
                if offset == 0 {
                    let bank = match source {
                        BankSource::Live => controller.active_bank(),
                        BankSource::Committed => controller.committed_bank(),
                        BankSource::Stored => {
                            self.restore_from_store(sequence, true, &mut mailboxes.store)?;
                            return Ok(None);
                        }
                    };
                    protocol.transfer.hold_bank(bank)?;
                }
                return protocol.transfer.chunk(offset).map(Some);
            }
            HostMessage::Statistics => {
                let statistics = self.statistics(mailbox);
                return Ok(Some(BoardMessage::Statistics(statistics)));
            }
            HostMessage::Reset => {
                controller.reset(mailbox)?;
                protocol.reset(sequence);
            }
            HostMessage::Arm => {
                // The processor stands still while the flash is written.
                if mailboxes.store.is_busy() {
                    return Err(NackReason::Busy);
                }
                controller.arm()?;
            }
            HostMessage::Disarm => controller.disarm(),
            HostMessage::Stop => controller.stop(mailbox),
            HostMessage::ClearFault => controller.clear_fault()?,
            HostMessage::Request { code } => controller.request(code, mailbox)?,
            HostMessage::Save => {
                self.save_to_store(sequence, &mut mailboxes.store)?;
                return Ok(None);
            }
            HostMessage::Restore => {
                self.restore_from_store(sequence, false, &mut mailboxes.store)?;
                return Ok(None);
            }
            HostMessage::Telemetry { fields, every } => {
                let allowance = self.allowance();
                let mtu = self.board.link.mtu;
                let stream = &mut self.protocol.stream;
                stream.begin::<N>(fields, every, allowance, mtu)?;
            }
            HostMessage::Challenge => {
                let key = board.write_key.as_ref().ok_or(NackReason::NotCapable)?;
                let nonce = protocol.challenge(key, &board.seed);
                return Ok(Some(BoardMessage::Challenge { nonce }));
            }
            HostMessage::Reboot => {
                board.require(Capabilities::REBOOT)?;
                controller.at_rest()?;
                self.reboot = true;
            }
            HostMessage::ExcitationLoad { length, crc, mac } => {
                controller.writable()?;
                protocol.authorise(board.write_key.as_ref(), mac, A::hash())?;
                controller.load_excitation(&protocol.transfer.program(length, crc)?)?;
            }
            HostMessage::Excitation(command) => {
                let state = controller.excite(command)?;
                return Ok(Some(BoardMessage::Excitation(state)));
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
