//! What the session counts, and what its owner measures for it.

use super::{Clock, LearnerMailbox, Session};
use crate::telemetry::{Cost, Statistics};
use crate::wire::SampleFrame;
use foretorque::arm::Arm;

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// Counts a missed deadline or a receive overrun of the line.
    pub fn note_overrun(&mut self) {
        self.link.overruns = self.link.overruns.saturating_add(1);
    }

    /// Counts a reply that the line had no room for.
    pub fn note_reply_lost(&mut self) {
        self.link.replies_lost = self.link.replies_lost.saturating_add(1);
    }

    /// Takes what the owner of the line measured: the cost of receiving one byte, and the time from the end of a frame to
    /// its answer being queued.
    pub fn note_line(&mut self, receive_cost: Cost, reply_latency: Cost) {
        self.receive_cost = receive_cost;
        self.reply_latency = reply_latency;
    }

    /// Takes how often the watchdog was fed since boot.
    pub fn note_feeds(&mut self, feeds: u32) {
        self.watchdog_feeds = feeds;
    }

    /// Takes the counts from the first instructions to the first hello.
    pub fn note_boot(&mut self, counts: u32) {
        self.boot_counts = counts;
    }

    /// Counters since boot or reset.
    pub fn statistics(&self, mailbox: &LearnerMailbox<N, P>) -> Statistics {
        Statistics {
            frames: self.link.frames,
            crc_errors: self.link.crc_errors,
            framing_errors: self.link.framing_errors,
            foreign_version: self.link.foreign_version,
            unknown: self.link.unknown,
            missed: self.link.missed,
            repeated: self.link.repeated,
            bytes_lost: self.decoder.bytes_lost(),
            overtaken: self.link.overtaken,
            stale_ticks: self.link.stale_ticks,
            overruns: self.link.overruns,
            replies_lost: self.link.replies_lost,
            ticks: self.ticks,
            late_sets: self.feed_forward.state().late_sets,
            learning_samples_lost: mailbox.learning_samples_lost,
            tick_cost: self.tick_cost.cost(),
            learn_cost: mailbox.learn_cost.cost(),
            receive_cost: self.receive_cost,
            hottest_c: self
                .temperatures_c
                .iter()
                .copied()
                .fold(SampleFrame::<N>::NO_TEMPERATURE, i8::max),
            reply_latency: self.reply_latency,
            implausible: self.safety.implausible(),
            watchdog_feeds: self.watchdog_feeds,
            records_lost: self.stream.lost(),
            store: self.store,
        }
    }
}
