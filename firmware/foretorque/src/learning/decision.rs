use core::fmt;

/// Declares the reasons with their codes and texts, in the order of their codes.
macro_rules! reasons {
    ($($(#[$attribute:meta])* $reason:ident = $code:literal, $text:literal;)*) => {
        /// Reason code of a supervisor decision. A code is part of the wire format and is never reused.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[repr(u8)]
        pub enum Reason {
            $($(#[$attribute])* $reason = $code,)*
        }

        impl Reason {
            /// Every reason, in the order of their codes, which begin at 1.
            pub const ALL: [Self; 26] = [$(Self::$reason),*];
        }

        impl fmt::Display for Reason {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self {
                    $(Self::$reason => $text,)*
                })
            }
        }
    };
}

reasons! {
    /// Alarm of change detection. Figure: CUSUM.
    Alarm = 1, "alarm";
    /// Payload promoted: it enters the torque. Figure: mass, kg.
    Promoted = 2, "payload promoted";
    /// Payload hypothesis refused: outside the plausible range. Figure: mass, kg.
    Implausible = 3, "payload refused: implausible";
    /// Payload hypothesis refused: uncertain mass. Figure: standard deviation of the mass, kg.
    Uncertain = 4, "payload refused: uncertain";
    /// Payload hypothesis refused: large residual. Figure: ratio of its mean square residual to that of the active set.
    Residual = 5, "payload refused: residual";
    /// Transient disturbance: it ended before a promotion. Figure: seconds since the alarm.
    Transient = 6, "transient disturbance";
    /// Rollback to the snapshot, on request.
    RolledBack = 7, "rolled back";
    /// Payload released: the rigid body is that of before it, friction stays. Figure: mass, kg.
    Released = 8, "payload released";
    /// Commit of the active set, on request.
    Committed = 9, "committed on request";
    /// Snapshot of the active set, on request.
    SnapshotTaken = 10, "snapshot taken";
    /// Payload set to zero, on request. Figure: mass before, kg.
    PayloadZeroed = 11, "payload set to zero";
    /// Request refused: no snapshot to roll back to, or an emergency stop. Figure: code of the request.
    RequestRefused = 12, "request refused";
    /// Learning frozen: saturated torque.
    FrozenSaturated = 13, "frozen: torque saturated";
    /// Learning frozen: no fresh sample.
    FrozenStale = 14, "frozen: no fresh sample";
    /// Learning frozen: a number is not finite.
    FrozenNotFinite = 15, "frozen: not finite";
    /// Learning stopped by an emergency stop.
    FrozenStopped = 16, "frozen: emergency stop";
    /// Learning resumed after a freeze or an emergency stop.
    Resumed = 17, "learning resumed";
    /// Relearning begins: the change is no payload. The estimate learns it.
    Relearning = 18, "relearning begins";
    /// Relearning ends; change detection restarts. Figure: the common learnt share by the evidence.
    RelearningEnded = 19, "relearning ends";
    /// Network candidate promoted. Figure: ratio of mean squares, candidate to active network.
    NetworkPromoted = 20, "network promoted";
    /// Active network silenced: the torque is better without. Figure: ratio of mean squares, with to without network.
    NetworkSilenced = 21, "network silenced";
    /// Trust below its threshold. Figure: trust.
    TrustLost = 22, "trust lost";
    /// Trust above its threshold again. Figure: trust.
    TrustRegained = 23, "trust regained";
    /// Measured torques oppose those of the loaded set: a reversed sign, which keeps learnt sets out of the torque.
    /// Figure: −1.
    Reversed = 24, "torques reversed";
    /// The common learnt share rises above one half. Figure: the share.
    FollowingBegan = 25, "following begins";
    /// The common learnt share falls below a quarter. Figure: the share.
    FollowingEnded = 26, "following ends";
}

impl Reason {
    /// The reason of a code; `None` for 0, which is no decision, and for an unknown code.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code).checked_sub(1)?).copied()
    }
}

/// Decision of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Decision {
    /// Tick of the learning sample.
    pub tick: u32,
    /// Reason code.
    pub reason: Reason,
    /// Joint that caused it, base to tool from 0; `None` if it concerns the arm.
    pub joint: Option<u8>,
    /// Figure named by the reason; 0 if it names none.
    pub figure: f32,
}

/// Number of logged decisions.
pub const DECISION_CAPACITY: usize = 8;

/// Optional [`Decision`]. All-zero memory is a valid value, because boards initialise the learner's static with zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Slot {
    tick: u32,
    reason: Option<Reason>,
    joint: Option<u8>,
    figure: f32,
}

impl Slot {
    const EMPTY: Self = Self {
        tick: 0,
        reason: None,
        joint: None,
        figure: 0.0,
    };
}

/// Ring of the newest decisions, with their number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DecisionLog {
    ring: [Slot; DECISION_CAPACITY],
    count: u32,
}

impl DecisionLog {
    /// Empty log.
    pub const fn new() -> Self {
        Self {
            ring: [Slot::EMPTY; DECISION_CAPACITY],
            count: 0,
        }
    }

    /// Append a decision in place of the oldest.
    pub(super) fn push(&mut self, decision: Decision) {
        if let Some(slot) = self.ring.get_mut(self.count as usize % DECISION_CAPACITY) {
            *slot = Slot {
                tick: decision.tick,
                reason: Some(decision.reason),
                joint: decision.joint,
                figure: decision.figure,
            };
        }
        self.count = self.count.wrapping_add(1);
    }

    /// Number of decisions so far; wraps.
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Decision number `index`, counted from 0; `None` if it is overwritten or not made yet.
    pub fn get(&self, index: u32) -> Option<Decision> {
        let age = self.count.wrapping_sub(index);
        if age == 0 || age > DECISION_CAPACITY as u32 {
            return None;
        }
        let slot = self.ring.get(index as usize % DECISION_CAPACITY)?;
        Some(Decision {
            tick: slot.tick,
            reason: slot.reason?,
            joint: slot.joint,
            figure: slot.figure,
        })
    }

    /// Decisions from number `index` on that are still in the ring, the oldest first.
    pub fn since(&self, index: u32) -> impl Iterator<Item = Decision> {
        (index..self.count).filter_map(|index| self.get(index))
    }

    /// Newest decision.
    pub fn newest(&self) -> Option<Decision> {
        self.get(self.count.wrapping_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_means_its_reason() {
        for (code, reason) in (1..).zip(Reason::ALL) {
            assert_eq!(reason as u8, code);
            assert_eq!(Reason::from_code(code), Some(reason));
        }
        assert_eq!([0, 27].map(Reason::from_code), [None; 2]);
    }

    #[test]
    fn the_log_holds_the_newest_decisions_only() {
        let mut log = DecisionLog::new();
        assert_eq!(log.newest(), None);
        for tick in 0..20 {
            log.push(Decision {
                tick,
                reason: Reason::Alarm,
                joint: None,
                figure: 0.0,
            });
            assert_eq!(log.newest().map(|decision| decision.tick), Some(tick));
        }
        for index in 0..25 {
            let logged = log.get(index).map(|decision| decision.tick);
            let kept = (12..20).contains(&index).then_some(index);
            assert_eq!(logged, kept, "{index}");
        }
    }
}
