//! Samples that never arrived, where samples pace the board and no tick runs without one.

use crate::wire::SampleFlags;
use foretorque::learning::MAX_BRIDGED;

/// Largest number of ticks that are filled in: after as many without a measurement the learner's window is empty, so a
/// longer gap has no other effect. It also bounds the time of a tick, whatever the host sends.
pub(super) const MAX_FILLED: u32 = MAX_BRIDGED as u32 + 1;

/// Gap before a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Gap {
    /// Periods without a sample, [`MAX_FILLED`] for more.
    pub(super) lost: u32,
    /// Periods since the sample before by the host's numbers.
    pub(super) counted: u32,
    /// The most that they can be as far as numbers show, for a board without a clock.
    pub(super) most: u32,
}

impl Gap {
    const NONE: Self = Self {
        lost: 0,
        counted: 1,
        most: 1,
    };
}

/// Gaps in the host's numbers of its periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::session) struct SampleGaps {
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
    pub(in crate::session) fn interrupt(&mut self) {
        self.interrupted = true;
    }

    /// Takes the number of a sample; returns the gap before it.
    ///
    /// The link's sequence numbers would not do: a lost command is no lost sample, and a host that sends nothing in a
    /// period leaves out none of them.
    ///
    /// * `missed` frames of any kind that the link has missed so far
    pub(super) fn take(&mut self, flags: SampleFlags, missed: u32) -> Gap {
        let number = flags.period();
        let newly_missed = missed.wrapping_sub(core::mem::replace(&mut self.missed, missed));
        let interrupted = core::mem::take(&mut self.interrupted);
        let Some(last) = self.last.replace(number) else {
            return Gap::NONE;
        };
        let ahead = u32::from(number.wrapping_sub(last) % SampleFlags::PERIODS);
        // As many frames may hide a whole round of the numbers.
        let hidden_round = newly_missed >= u32::from(SampleFlags::PERIODS) - 1;
        let lost = match interrupted || hidden_round {
            true => MAX_FILLED,
            false => ahead.saturating_sub(1).min(MAX_FILLED),
        };
        let most = match (interrupted, hidden_round || ahead == 0) {
            (true, _) => u32::MAX,
            (false, true) => newly_missed.saturating_add(1),
            (false, false) => ahead,
        };
        Gap {
            lost,
            counted: if interrupted { 1 } else { ahead },
            most,
        }
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
        let lost = |&(period, missed)| gaps.take(flags(period), missed).lost;
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
        assert_eq!(lost(&[(1, 0), (2, 31), (3, 31)]), [0, MAX_FILLED, 0]);
        assert_eq!(lost(&[(1, 0), (2, 30), (3, 30)]), [0, 0, 0]);
        let mut gaps = SampleGaps::new();
        gaps.interrupt();
        assert_eq!(gaps.take(flags(1), 0).lost, 0, "there was nothing before");
        gaps.interrupt();
        assert_eq!(gaps.take(flags(2), 0).lost, MAX_FILLED);
        assert_eq!(gaps.take(flags(3), 0).lost, 0);
    }

    #[test]
    fn periods_are_those_of_the_samples_own_numbers() {
        let mut gaps = SampleGaps::new();
        let mut take = |period, missed| {
            let gap = gaps.take(flags(period), missed);
            (gap.counted, gap.most)
        };
        assert_eq!(
            [take(1, 0), take(2, 30), take(5, 32)],
            [(1, 1), (1, 1), (3, 3)]
        );
        // A host that does not count, and more missed frames than its numbers can show.
        assert_eq!(
            [take(5, 32), take(5, 34), take(6, 70)],
            [(0, 1), (0, 3), (1, 37)]
        );
        gaps.interrupt();
        let gap = gaps.take(flags(9), 70);
        assert_eq!((gap.counted, gap.most), (1, u32::MAX));
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
