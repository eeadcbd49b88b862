use crate::edge::wire::DecodeError;

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
        self.missed = self.missed.saturating_add(u32::from(step - 1));
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
