//! Counters of the board.

use crate::div_u64_by_u32;
use crate::store::StoreHealth;
use serde::{Deserialize, Serialize};

/// Counters since boot or reset. All saturate or wrap; none stops the tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Statistics {
    /// Good frames received.
    #[serde(with = "postcard::fixint::le")]
    pub frames: u32,
    /// Frames with a wrong checksum.
    #[serde(with = "postcard::fixint::le")]
    pub crc_errors: u32,
    /// Frames cut short or too long.
    #[serde(with = "postcard::fixint::le")]
    pub framing_errors: u32,
    /// Sound frames of another protocol version.
    #[serde(with = "postcard::fixint::le")]
    pub foreign_version: u32,
    /// Sound frames with an unknown message.
    #[serde(with = "postcard::fixint::le")]
    pub unknown: u32,
    /// Sequence numbers that never arrived.
    #[serde(with = "postcard::fixint::le")]
    pub missed: u32,
    /// Frames that arrived twice or late, without effect.
    #[serde(with = "postcard::fixint::le")]
    pub repeated: u32,
    /// Bytes outside good frames.
    #[serde(with = "postcard::fixint::le")]
    pub bytes_lost: u32,
    /// Samples replaced by a newer one before the timer ran a tick.
    #[serde(with = "postcard::fixint::le")]
    pub overtaken: u32,
    /// Ticks without a sample: of the timer, and those filled in for lost samples.
    #[serde(with = "postcard::fixint::le")]
    pub stale_ticks: u32,
    /// Ticks that missed their deadline, and receive overruns of the link.
    #[serde(with = "postcard::fixint::le")]
    pub overruns: u32,
    /// Replies without space in the buffer.
    #[serde(with = "postcard::fixint::le")]
    pub replies_lost: u32,
    /// Ticks run, with a sample or without.
    #[serde(with = "postcard::fixint::le")]
    pub ticks: u32,
    /// Learnt sets that arrived late.
    #[serde(with = "postcard::fixint::le")]
    pub late_sets: u32,
    /// Learning samples without space in the mailbox.
    #[serde(with = "postcard::fixint::le")]
    pub learning_samples_lost: u32,
    /// Cost of a tick, in counts of the board's counter.
    pub tick_cost: Cost,
    /// Cost of a learning step, in counts of the board's counter.
    pub learn_cost: Cost,
    /// Cost of receiving one byte, in counts of the board's counter.
    pub receive_cost: Cost,
    /// Hottest motor by the temperatures known last, °C; -128 is unknown.
    pub hottest_c: i8,
    /// Time from the end of the last frame received until a reply is queued, in counts of the board's counter: where more frames
    /// have come behind the one that is answered, its reply took longer.
    pub reply_latency: Cost,
    /// Samples of which a part was implausible.
    #[serde(with = "postcard::fixint::le")]
    pub implausible: u32,
    /// Watchdog feeds since boot.
    #[serde(with = "postcard::fixint::le")]
    pub watchdog_feeds: u32,
    /// Telemetry records of which a part was not sent.
    #[serde(with = "postcard::fixint::le")]
    pub records_lost: u32,
    /// State of the store.
    pub store: StoreHealth,
}

/// Mean and largest cost, in counts of the board's counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cost {
    /// Mean.
    #[serde(with = "postcard::fixint::le")]
    pub mean: u32,
    /// Largest.
    #[serde(with = "postcard::fixint::le")]
    pub max: u32,
}

/// Mean and maximum of a series of costs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CostMeter {
    sum: u64,
    times: u32,
    max: u32,
}

impl CostMeter {
    /// Takes one cost.
    pub fn note(&mut self, cost: u32) {
        // The sum stops with `times`, so that their quotient stays the mean; the maximum continues.
        if self.times < u32::MAX {
            self.times += 1;
            self.sum += u64::from(cost);
        }
        self.max = self.max.max(cost);
    }

    /// Mean and largest cost so far; zero before the first.
    pub fn cost(&self) -> Cost {
        Cost {
            mean: div_u64_by_u32(self.sum, self.times.max(1)),
            max: self.max,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_lies_between_the_costs_and_the_largest_is_kept() {
        let mut meter = CostMeter::default();
        assert_eq!(meter.cost(), Cost::default());
        for cost in [10, 30, 20] {
            meter.note(cost);
        }
        assert_eq!(meter.cost(), Cost { mean: 20, max: 30 });
    }
}
