//! Samples that never came, where samples pace the board and no tick runs without one.

use crate::wire::SampleFlags;
use foretorque::learning::BRIDGED;

/// Most ticks that are made up for. After as many without a measurement nothing that the learner has seen counts any more,
/// and it cannot tell a longer gap from this one; it is also what keeps the time of a tick bounded, whatever a host says.
pub(super) const MAX_FILLED: u32 = BRIDGED as u32 + 1;

/// The host's count of its periods, as far as samples have told it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SampleGaps {
    last: Option<u8>,
    /// The link's count of missed frames at that sample.
    missed: u32,
    /// Nobody knows what went by since then.
    interrupted: bool,
}

impl SampleGaps {
    /// Before the first sample, which nothing was lost before.
    pub(super) const fn new() -> Self {
        Self {
            last: None,
            missed: 0,
            interrupted: false,
        }
    }

    /// Somebody else may be talking now.
    pub(super) fn interrupt(&mut self) {
        self.interrupted = true;
    }

    /// Takes the number of a sample that has come; the periods that went by without theirs, [`MAX_FILLED`] for more.
    ///
    /// The link's own numbers would not do: a lost command is no lost sample, and a host that sends nothing in a period
    /// leaves out none of them.
    ///
    /// * `missed` frames of any kind that never came, so far
    pub(super) fn lost(&mut self, flags: SampleFlags, missed: u32) -> u32 {
        let number = flags.period();
        let Some(last) = self.last.replace(number) else {
            *self = Self {
                missed,
                interrupted: false,
                ..*self
            };
            return 0;
        };
        let unheard = missed.wrapping_sub(core::mem::replace(&mut self.missed, missed));
        let ahead = number.wrapping_sub(last) % SampleFlags::PERIODS;
        // As many frames may hide a whole round of the numbers.
        let around = unheard >= u32::from(SampleFlags::PERIODS) - 1;
        if core::mem::take(&mut self.interrupted) || around {
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
        let mut periods = SampleGaps::new();
        samples
            .iter()
            .map(|&(period, missed)| periods.lost(flags(period), missed))
            .collect()
    }

    #[test]
    fn a_number_left_out_is_a_sample_lost_whether_the_line_lost_it_or_the_host_sent_none() {
        assert_eq!(lost(&[(7, 0), (8, 0), (10, 1), (13, 1)]), [0, 0, 1, 2]);
        assert_eq!(lost(&[(30, 0), (31, 0), (32, 0), (34, 1)]), [0, 0, 0, 1]);
    }

    #[test]
    fn a_lost_command_is_no_lost_sample_and_a_host_that_does_not_count_loses_none() {
        assert_eq!(lost(&[(1, 0), (2, 3), (3, 30)]), [0, 0, 0]);
        assert_eq!(lost(&[(0, 0), (0, 1), (0, 9)]), [0, 0, 0]);
    }

    #[test]
    fn more_than_can_be_bridged_is_all_the_same_and_so_is_what_nobody_knows() {
        assert_eq!(lost(&[(1, 0), (8, 6), (7, 6)]), [0, MAX_FILLED, MAX_FILLED]);
        assert_eq!(lost(&[(1, 0), (2, 32), (3, 32)]), [0, MAX_FILLED, 0]);
        let mut periods = SampleGaps::new();
        periods.interrupt();
        assert_eq!(periods.lost(flags(1), 0), 0, "there was nothing before");
        periods.interrupt();
        assert_eq!(periods.lost(flags(2), 0), MAX_FILLED);
        assert_eq!(periods.lost(flags(3), 0), 0);
    }

    #[test]
    fn no_numbers_make_a_tick_longer_than_bounded() {
        for last in 0..=u8::MAX {
            for next in 0..=u8::MAX {
                for missed in [0, 1, 31, u32::MAX] {
                    let said = lost(&[(last, 5), (next, missed)]);
                    assert!(said.iter().all(|&lost| lost <= MAX_FILLED));
                }
            }
        }
    }
}
