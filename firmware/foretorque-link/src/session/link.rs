use crate::wire::DecodeError;

/// Frames whose number lies at most this far back are repeats or latecomers; farther back, a host has started over.
const REPEAT_WINDOW: u16 = 16;

/// Where a frame stands in the host's count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// It is new.
    Forward,
    /// It was seen, or a later one was.
    Repeated,
}

/// Counters and sequence of the link.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LinkState {
    pub(super) frames: u32,
    pub(super) crc_errors: u32,
    pub(super) framing_errors: u32,
    pub(super) foreign_version: u32,
    pub(super) unknown: u32,
    pub(super) missed: u32,
    pub(super) repeated: u32,
    pub(super) overtaken: u32,
    pub(super) stale_ticks: u32,
    pub(super) overruns: u32,
    pub(super) replies_lost: u32,
    last: Option<u16>,
}

impl LinkState {
    /// Counters at zero, the count going on after `sequence`.
    pub(super) fn after(sequence: u16) -> Self {
        Self {
            last: Some(sequence),
            ..Self::default()
        }
    }

    /// Counts a good frame. `restart` begins the count of sequence numbers anew.
    pub(super) fn accept(&mut self, sequence: u16, restart: bool) -> Order {
        self.frames = self.frames.saturating_add(1);
        let step = match self.last {
            Some(last) if !restart => sequence.wrapping_sub(last),
            _ => 1,
        };
        if step == 0 || step > u16::MAX - REPEAT_WINDOW {
            self.repeated = self.repeated.saturating_add(1);
            return Order::Repeated;
        }
        // A host that wraps leaves out 0, which is the board's own number.
        let left_out = u16::from(!restart && self.last.is_some_and(|last| sequence < last));
        let missed = (step - 1).saturating_sub(left_out);
        self.missed = self.missed.saturating_add(u32::from(missed));
        self.last = Some(sequence);
        Order::Forward
    }

    pub(super) fn refuse(&mut self, error: DecodeError) {
        let counter = match error {
            DecodeError::Framing => &mut self.framing_errors,
            DecodeError::Checksum => &mut self.crc_errors,
            DecodeError::ForeignVersion(_) => &mut self.foreign_version,
            DecodeError::Unknown => &mut self.unknown,
        };
        *counter = counter.saturating_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(numbers: &[u16]) -> (u32, u32) {
        let mut link = LinkState::default();
        for &number in numbers {
            link.accept(number, false);
        }
        (link.missed, link.repeated)
    }

    #[test]
    fn gaps_and_repeats_are_counted() {
        for (numbers, missed_and_repeated) in [
            (&[1, 2, 3][..], (0, 0)),
            (&[900, 901], (0, 0)),
            (&[1, 4], (2, 0)),
            (&[1, 1, 2], (0, 1)),
            (&[1, 3, 2, 4], (1, 1)),
            (&[65534, 65535, 1, 2], (0, 0)),
            (&[65535, 3], (2, 0)),
            (&[65535, 1, 65535, 2], (0, 1)),
            (&[30_000, 100], (35_634, 0)),
        ] {
            assert_eq!(counted(numbers), missed_and_repeated, "{numbers:?}");
        }
    }

    #[test]
    fn hello_restarts_the_count() {
        let mut link = LinkState::default();
        link.accept(500, false);
        assert_eq!(link.accept(498, true), Order::Forward);
        assert_eq!(link.accept(499, false), Order::Forward);
        assert_eq!((link.missed, link.repeated), (0, 0));
    }
}
