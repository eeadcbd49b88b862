//! Samples that never arrived, where samples pace the board and no tick runs without one.

use crate::wire::SampleFlags;
use foretorque::learning::MAX_BRIDGED;

/// Largest number of ticks that are filled in: after as many without a measurement the learner's window is empty, so a
/// longer gap has no other effect. It also bounds the time of a tick, whatever the host sends.
pub(super) const MAX_FILLED: u32 = MAX_BRIDGED as u32 + 1;

/// Gaps in the host's numbers of its periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SampleGaps {
    last: Option<u8>,
    /// The link's count of missed frames at that sample.
    missed: u32,
    /// The number of periods since then is unknown.
    interrupted: bool,
}

impl SampleGaps {
    /// Before the first sample; nothing was lost before it.
    pub(super) const fn new() -> Self {
        Self {
            last: None,
            missed: 0,
            interrupted: false,
        }
    }

    /// Another host may be sending now.
    pub(super) fn interrupt(&mut self) {
        self.interrupted = true;
    }

    /// Takes the number of a sample; returns the periods without a sample before it, [`MAX_FILLED`] for more.
    ///
    /// The link's sequence numbers would not do: a lost command is no lost sample, and a host that sends nothing in a
    /// period leaves out none of them.
    ///
    /// * `missed` frames of any kind that the link has missed so far
    pub(super) fn lost(&mut self, flags: SampleFlags, missed: u32) -> u32 {
        let number = flags.period();
        let newly_missed = missed.wrapping_sub(core::mem::replace(&mut self.missed, missed));
        let interrupted = core::mem::take(&mut self.interrupted);
        let Some(last) = self.last.replace(number) else {
            return 0;
        };
        let ahead = number.wrapping_sub(last) % SampleFlags::PERIODS;
        // As many frames may hide a whole round of the numbers.
        let hidden_round = newly_missed >= u32::from(SampleFlags::PERIODS) - 1;
        if interrupted || hidden_round {
            return MAX_FILLED;
        }
        u32::from(ahead.saturating_sub(1)).min(MAX_FILLED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::SampleFrame;
    use foretorque::joint::{JointMotion, JointSample};

    fn flags(period: u8) -> SampleFlags {
        let sample = SampleFrame::<1>::new(&JointSample {
            desired: JointMotion::zero(),
            measured: None,
        });
        sample.in_period(period).flags
    }

    fn lost(samples: &[(u8, u32)]) -> std::vec::Vec<u32> {
        let mut gaps = SampleGaps::new();
        let lost = |&(period, missed)| gaps.lost(flags(period), missed);
        samples.iter().map(lost).collect()
    }

    #[test]
    fn a_period_left_out_is_a_lost_sample() {
        assert_eq!(lost(&[(7, 0), (8, 0), (10, 1), (13, 1)]), [0, 0, 1, 2]);
        assert_eq!(lost(&[(30, 0), (31, 0), (32, 0), (34, 1)]), [0, 0, 0, 1]);
    }

    #[test]
    fn lost_commands_and_hosts_that_do_not_count_lose_no_sample() {
        assert_eq!(lost(&[(1, 0), (2, 3), (3, 30)]), [0, 0, 0]);
        assert_eq!(lost(&[(0, 0), (0, 1), (0, 9)]), [0, 0, 0]);
    }

    #[test]
    fn long_and_unknown_gaps_count_as_the_largest() {
        assert_eq!(lost(&[(1, 0), (8, 6), (7, 6)]), [0, MAX_FILLED, MAX_FILLED]);
        assert_eq!(lost(&[(1, 0), (2, 32), (3, 32)]), [0, MAX_FILLED, 0]);
        let mut gaps = SampleGaps::new();
        gaps.interrupt();
        assert_eq!(gaps.lost(flags(1), 0), 0, "there was nothing before");
        gaps.interrupt();
        assert_eq!(gaps.lost(flags(2), 0), MAX_FILLED);
        assert_eq!(gaps.lost(flags(3), 0), 0);
    }

    #[test]
    fn no_numbers_exceed_the_bound() {
        for last in 0..=u8::MAX {
            for next in 0..=u8::MAX {
                for missed in [0, 1, 31, u32::MAX] {
                    let lost = lost(&[(last, 5), (next, missed)]);
                    assert!(lost.iter().all(|&lost| lost <= MAX_FILLED));
                }
            }
        }
    }
}
