use super::{Clock, LearnerMailbox, Session};
use crate::telemetry::{Cost, Statistics};
use crate::wire::SampleFrame;
use foretorque::arm::Arm;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Counts a missed deadline or a receive overrun of the link.
    pub fn note_overrun(&mut self) {
        let overruns = &mut self.protocol.link.overruns;
        *overruns = overruns.saturating_add(1);
    }

    /// Counts a reply for which the link had no space.
    pub fn note_reply_lost(&mut self) {
        let lost = &mut self.protocol.link.replies_lost;
        *lost = lost.saturating_add(1);
    }

    /// Takes the owner's measurements of the link: cost of receiving one byte, and time from the end of a frame until its
    /// reply is queued.
    pub fn note_line(&mut self, receive_cost: Cost, reply_latency: Cost) {
        self.receive_cost = receive_cost;
        self.reply_latency = reply_latency;
    }

    /// Takes the number of watchdog feeds since boot.
    pub fn note_feeds(&mut self, feeds: u32) {
        self.watchdog_feeds = feeds;
    }

    /// Takes the counts from the first instructions to the first hello.
    pub fn note_boot(&mut self, counts: u32) {
        self.boot_counts = counts;
    }

    /// Counters since boot or reset.
    pub fn statistics(&self, mailbox: &LearnerMailbox<N, P>) -> Statistics {
        let link = &self.protocol.link;
        let counters = self.controller.counters();
        let temperatures = self.temperatures_c().iter().copied();
        Statistics {
            frames: link.frames,
            crc_errors: link.crc_errors,
            framing_errors: link.framing_errors,
            foreign_version: link.foreign_version,
            unknown: link.unknown,
            missed: link.missed,
            repeated: link.repeated,
            bytes_lost: self.protocol.bytes_lost(),
            overtaken: counters.overtaken,
            stale_ticks: counters.stale,
            overruns: link.overruns,
            replies_lost: link.replies_lost,
            ticks: counters.ticks,
            late_sets: self.feed_forward().state().late_sets,
            learning_samples_lost: mailbox.samples_lost(),
            tick_cost: counters.cost.cost(),
            learn_cost: mailbox.learn_cost(),
            receive_cost: self.receive_cost,
            hottest_c: temperatures.fold(SampleFrame::<N>::NO_TEMPERATURE, i8::max),
            reply_latency: self.reply_latency,
            implausible: self.controller.safety().implausible(),
            watchdog_feeds: self.watchdog_feeds,
            records_lost: self.protocol.stream.lost(),
            store: self.store,
        }
    }
}
