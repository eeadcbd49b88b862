//! The tick of a board: sample in, feed-forward, safety, torque out.

use super::stream::Instant;
use super::{Clock, LearnerMailbox, LocalSensor, NoLocalSensor, Session};
use crate::safety::SafetyReason;
use crate::wire::{
    BoardMessage, ExcitedFrame, FrameBuffer, FullTorqueFrame, Pacing, ReplyMode, SampleFlags,
    SampleFrame, TorqueFrame,
};
use foretorque::arm::Arm;
use foretorque::joint::JointSample;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// The board's timer, once a period: runs the tick on the newest sample where the timer paces. Where the link paces it
    /// only watches for silence, which ends a torque that flows and lets samples grow too old to arm on.
    pub fn timer_tick(&mut self, mailbox: &mut LearnerMailbox<N, P>, out: &mut FrameBuffer) {
        self.timer_tick_with(mailbox, out, &mut NoLocalSensor);
    }

    /// The same on a board that measures a joint itself.
    pub fn timer_tick_with(
        &mut self,
        mailbox: &mut LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
        own: &mut impl LocalSensor,
    ) {
        match self.configuration.pacing {
            Pacing::SysTick => {
                let sample = self.newest.take();
                if sample.is_none() {
                    self.link.stale_ticks = self.link.stale_ticks.saturating_add(1);
                }
                self.tick(sample, mailbox, out, own);
            }
            Pacing::Link => {
                self.safety.silence();
                self.feed_forward.applied(self.safety.output());
            }
        }
    }

    pub(super) fn sample(
        &mut self,
        sequence: u16,
        sample: SampleFrame<N>,
        mailbox: &mut LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
        own: &mut impl LocalSensor,
    ) {
        let joint = usize::from(sequence) % N;
        if let Some(slot) = self.temperatures_c.get_mut(joint) {
            *slot = sample.temperature_c;
        }
        self.safety.note_temperature(joint, sample.temperature_c);
        match self.configuration.pacing {
            Pacing::Link => {
                let lost = self.periods.lost(sample.flags, self.link.missed);
                self.fill_lost_ticks(lost, mailbox);
                self.tick(Some((sequence, sample)), mailbox, out, own);
            }
            Pacing::SysTick => {
                if self.newest.replace((sequence, sample)).is_some() {
                    self.link.overtaken = self.link.overtaken.saturating_add(1);
                }
            }
        }
    }

    /// Runs the ticks whose samples were lost, as a timer would have: for the learner they are ticks without a measurement.
    /// The torque goes on from where it is; what silence does to it was the timer's business.
    ///
    /// Cost: one tick without a sample for each of the lost ones, [`MAX_FILLED`](super::MAX_FILLED) at most.
    #[inline(never)]
    fn fill_lost_ticks(&mut self, lost: u32, mailbox: &mut LearnerMailbox<N, P>) {
        for _ in 0..lost {
            self.feed_forward.adopt(&mut mailbox.exchange);
            self.feed_forward.step_stale();
            mailbox.post(self.feed_forward.lesson(None));
            self.ticks = self.ticks.wrapping_add(1);
            self.link.stale_ticks = self.link.stale_ticks.saturating_add(1);
        }
        self.feed_forward.applied(self.safety.output());
    }

    /// One tick. Its deadline is the period.
    fn tick(
        &mut self,
        sample: Option<(u16, SampleFrame<N>)>,
        mailbox: &mut LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
        own: &mut impl LocalSensor,
    ) {
        self.feed_forward.adopt(&mut mailbox.exchange);
        // A host numbers its frames, one sample a period at most: the numbers bound how long ago the last one was.
        let before = self.last_sequence;
        let periods = sample.map_or(1, |(sequence, _)| sequence.wrapping_sub(before));
        if let Some((sequence, _)) = sample {
            self.last_sequence = sequence;
        }
        let patient =
            sample.is_some_and(|(_, frame)| frame.flags.contains(SampleFlags::AFTER_LEARNING));
        let mut heard: Option<JointSample<N>> = sample.map(|(_, frame)| frame.sample(&self.gains));
        let sensor = own.measure(heard.as_mut(), self.safety.at_rest());
        if sensor != SafetyReason::None
            && let Some(sample) = &mut heard
        {
            sample.measured = None;
        }
        let excited = self.player.step(heard.as_ref());
        if let (Some(sample), Some(desired)) = (&mut heard, excited) {
            sample.desired = desired;
        }
        let sample = self.safety.admit_from(heard, u32::from(periods), sensor);
        let start = self.board.clock.now();
        let mut torque = match &sample {
            Some(sample) => self.feed_forward.step(sample),
            None => self.feed_forward.step_stale(),
        };
        torque.total = self.safety.release(&torque.total);
        let cost = self.board.clock.now().wrapping_sub(start);
        self.feed_forward.applied(&torque.total);
        self.tick_cost.note(cost);
        self.ticks = self.ticks.wrapping_add(1);
        mailbox.post(
            self.feed_forward
                .lesson(sample.and_then(|sample| sample.measured)),
        );
        if patient {
            mailbox.hold_answer();
        }
        let status = self.safety.status();
        let reply = match (excited, self.configuration.reply) {
            (Some(desired), _) => {
                let frame = TorqueFrame::new(&torque, status);
                BoardMessage::Excited(ExcitedFrame::new(frame, self.player.state(), &desired))
            }
            (None, ReplyMode::Decimated) => BoardMessage::Torque(TorqueFrame::new(&torque, status)),
            (None, ReplyMode::Full) => {
                BoardMessage::FullTorque(FullTorqueFrame::new(&torque, status))
            }
        };
        self.answer(self.last_sequence, &reply, out);
        if self.stream.due(torque.tick) {
            let instant = Instant {
                torque: &torque,
                status,
                sample: &sample,
                report: &self.feed_forward.state().report,
                costs: [cost, mailbox.learn_cost.cost().mean],
                losses: self.losses(),
                temperatures_c: &self.temperatures_c,
            };
            self.stream.record(&instant);
        }
        self.send_telemetry(out);
    }

    /// Frames missed and refused, replies lost and overruns; the low halves of their counters.
    fn losses(&self) -> [u16; 4] {
        let link = &self.link;
        let refused = link.crc_errors.wrapping_add(link.framing_errors);
        [link.missed, refused, link.replies_lost, link.overruns].map(|count| count as u16)
    }
}
