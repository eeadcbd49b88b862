//! From the bytes of the link to what they ask for.

use super::link::Order;
use super::{Clock, LearnerMailbox, LocalSensor, NoLocalSensor, Session};
use crate::wire::{BoardMessage, DecodeError, FrameBuffer, HostMessage, NackReason};
use foretorque::arm::Arm;
use foretorque::feedforward::evaluate;
use foretorque::joint::JointMotion;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Takes bytes from the link, acts on every frame they complete and answers into `out`.
    ///
    /// Cost: a few instructions a byte; the byte that ends a sample also runs the tick where the link paces.
    pub fn receive(
        &mut self,
        bytes: &[u8],
        mailbox: &mut LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
    ) {
        self.receive_with(bytes, mailbox, out, &mut NoLocalSensor);
    }

    /// The same on a board that measures a joint itself.
    pub fn receive_with(
        &mut self,
        bytes: &[u8],
        mailbox: &mut LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
        own: &mut impl LocalSensor,
    ) {
        for &byte in bytes {
            if self.reboot {
                return;
            }
            let received = match self.decoder.push(byte) {
                None => continue,
                Some(Ok(frame)) => frame
                    .message::<HostMessage<N>>()
                    .map(|message| (frame.sequence, message)),
                Some(Err(error)) => Err(error),
            };
            match received {
                Ok((sequence, message)) => {
                    let restart = matches!(message, HostMessage::Hello);
                    // A stop that comes late or twice is still a stop.
                    let urgent = matches!(message, HostMessage::Stop);
                    if self.link.accept(sequence, restart) == Order::Forward || urgent {
                        self.act(sequence, message, mailbox, out, own);
                    }
                }
                Err(error) => {
                    self.link.refuse(error);
                    if let DecodeError::ForeignVersion(_) = error {
                        // So that a host of another generation can say what is wrong.
                        self.send_hello(out);
                    }
                }
            }
        }
    }

    fn act(
        &mut self,
        sequence: u16,
        message: HostMessage<N>,
        mailbox: &mut LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
        own: &mut impl LocalSensor,
    ) {
        let done = match message {
            HostMessage::Sample(sample) => return self.sample(sequence, sample, mailbox, out, own),
            HostMessage::Hello => {
                self.periods.interrupt();
                return self.answer(sequence, &BoardMessage::Hello(self.hello()), out);
            }
            HostMessage::Evaluate(motion) => {
                let set = &self.feed_forward.state().active;
                let torque = evaluate::<A, N, P>(set, &JointMotion::from(&motion));
                return self.answer(sequence, &BoardMessage::Evaluated((&torque).into()), out);
            }
            HostMessage::Statistics => {
                let statistics = self.statistics(mailbox);
                return self.answer(sequence, &BoardMessage::Statistics(statistics), out);
            }
            HostMessage::BankRead { source, offset } => {
                return self.read(sequence, source, offset, mailbox, out);
            }
            HostMessage::Save => match self.save(sequence, mailbox) {
                Ok(()) => return,
                Err(reason) => Err(reason),
            },
            HostMessage::Restore => match self.fetch(sequence, false, mailbox) {
                Ok(()) => return,
                Err(reason) => Err(reason),
            },
            HostMessage::Excitation(command) => match self.excitation(command) {
                Ok(stage) => return self.answer(sequence, &stage, out),
                Err(reason) => Err(reason),
            },
            HostMessage::Challenge => match self.challenge() {
                Ok(nonce) => {
                    return self.answer(sequence, &BoardMessage::Challenge { nonce }, out);
                }
                Err(reason) => Err(reason),
            },
            message => self.command(sequence, message, mailbox),
        };
        let answer = match done {
            Ok(()) => BoardMessage::Ack,
            Err(reason) => BoardMessage::Nack(reason),
        };
        self.answer(sequence, &answer, out);
    }

    /// Does what is answered by ack or nack.
    fn command(
        &mut self,
        sequence: u16,
        message: HostMessage<N>,
        mailbox: &mut LearnerMailbox<N, P>,
    ) -> Result<(), NackReason> {
        match message {
            HostMessage::BankWrite { offset, bytes } => self.write(offset, &bytes),
            HostMessage::BankCommit { length, crc, mac } => self.commit(length, crc, mac, mailbox),
            HostMessage::ExcitationLoad { length, crc, mac } => {
                self.load_excitation(length, crc, mac)
            }
            HostMessage::Configure(configuration) => self.configure(configuration, mailbox),
            HostMessage::Learning { on } => self.set_learning(on),
            HostMessage::Reset => self.reset(sequence, mailbox),
            HostMessage::Arm => self.arm(mailbox),
            HostMessage::Disarm => {
                self.safety.disarm();
                Ok(())
            }
            HostMessage::Stop => {
                self.stop(mailbox);
                Ok(())
            }
            HostMessage::ClearFault => self.safety.clear().map_err(NackReason::Unsafe),
            HostMessage::Request { code } => self.request(code, mailbox),
            HostMessage::Telemetry { fields, every } => self.stream_telemetry(fields, every),
            HostMessage::Reboot => self.ask_for_reboot(),
            // Answered otherwise, above.
            HostMessage::Hello
            | HostMessage::Sample(_)
            | HostMessage::Evaluate(_)
            | HostMessage::Statistics
            | HostMessage::BankRead { .. }
            | HostMessage::Save
            | HostMessage::Restore
            | HostMessage::Excitation(_)
            | HostMessage::Challenge => Ok(()),
        }
    }

    pub(super) fn answer(
        &mut self,
        sequence: u16,
        message: &BoardMessage<N>,
        out: &mut FrameBuffer,
    ) {
        if out.push(sequence, message).is_err() {
            self.link.replies_lost = self.link.replies_lost.saturating_add(1);
        }
    }
}
