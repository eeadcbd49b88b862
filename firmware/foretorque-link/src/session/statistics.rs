use super::{Clock, LearnerMailbox, Session};
use crate::telemetry::{Cost, Statistics};
use crate::wire::SampleFrame;
use foretorque::arm::Arm;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Counts a missed deadline or a receive overrun of the link.
    pub fn note_overrun(&mut self) {
        let overruns = &mut self.protocol.link.counters.overruns;
        *overruns = overruns.saturating_add(1);
    }

    /// Counts a reply for which the link had no space.
    pub fn note_reply_lost(&mut self) {
        let lost = &mut self.protocol.link.counters.replies_lost;
        *lost = lost.saturating_add(1);
    }

    /// Takes the owner's measurements of the link: cost of receiving one byte, and time from the end of a frame until its
    /// reply is queued.
    pub fn note_line(&mut self, receive_cost: Cost, reply_latency: Cost) {
        let counters = &mut self.protocol.link.counters;
        (counters.receive_cost, counters.reply_latency) = (receive_cost, reply_latency);
    }

    /// Takes the number of watchdog feeds since boot.
    pub fn note_feeds(&mut self, feeds: u32) {
        self.protocol.link.counters.watchdog_feeds = feeds;
    }

    /// Takes the counts from the first instructions to the first hello.
    pub fn note_boot(&mut self, counts: u32) {
        self.boot_counts = counts;
    }

    /// Counters since boot or reset.
    pub fn statistics(&self, mailbox: &LearnerMailbox<N, P>) -> Statistics {
        let ticks = &self.controller.counters;
        let temperatures = self.temperatures_c().iter().copied();
        Statistics {
            bytes_lost: self.protocol.bytes_lost(),
            overtaken: ticks.overtaken,
            stale_ticks: ticks.stale,
            ticks: ticks.ticks,
            late_sets: self.feed_forward().state().late_sets,
            learning_samples_lost: mailbox.samples_lost(),
            tick_cost: ticks.cost.cost(),
            learn_cost: mailbox.learn_cost(),
            hottest_c: temperatures.fold(SampleFrame::<N>::NO_TEMPERATURE, i8::max),
            implausible: self.controller.safety.implausible(),
            records_lost: self.protocol.stream.lost(),
            ..self.protocol.link.counters
        }
    }
}
