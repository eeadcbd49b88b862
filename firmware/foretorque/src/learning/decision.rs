/// Why the guard did what it did. The numbers are part of the wire format: they are never given to another reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Reason {
    /// The innovations of a joint say that something changed. Figure: the detector's sum.
    Alarm = 1,
    /// A payload was believed and goes into the torque. Figure: its mass, kg.
    Promoted = 2,
    /// A candidate outside the plausibility box was refused. Figure: its mass, kg.
    Implausible = 3,
    /// A candidate whose mass was still uncertain was refused. Figure: standard deviation of the mass, kg.
    Uncertain = 4,
    /// A candidate that does not explain the torques was refused. Figure: its residual over that of the active set.
    Residual = 5,
    /// The disturbance was over before anything was promoted. Figure: seconds since the alarm.
    Transient = 6,
    /// The active set was taken back because the kept one explains the torques better, or on request.
    RolledBack = 7,
    /// The payload was put down: the parameters are again those from before it. Figure: the mass, kg.
    Released = 8,
    /// The active set became the committed one. Figure: its residual over that of the committed set before.
    Committed = 9,
    /// A set was kept on request.
    SnapshotTaken = 10,
    /// The payload was set to nothing on request. Figure: the mass it had, kg.
    PayloadZeroed = 11,
    /// What a request asks for is not there. Figure: the number of the request.
    RequestRefused = 12,
    /// Learning stopped because a torque was saturated.
    FrozenSaturated = 13,
    /// Learning stopped because no fresh sample came.
    FrozenStale = 14,
    /// Learning stopped because a number was not finite.
    FrozenNotFinite = 15,
    /// Learning stopped on an emergency stop.
    FrozenStopped = 16,
    /// Learning goes on after one of the stops above.
    Resumed = 17,
    /// The change stayed and is no payload: friction is learnt anew, out of sight of the torque.
    Relearning = 18,
    /// Time for relearning is over: alarms are listened to again. Figure: residual of the estimate over that of the
    /// committed set.
    RelearningEnded = 19,
    /// A trained network was believed. Figure: its residual over that of the one before.
    NetworkPromoted = 20,
    /// A network that made the torque worse was silenced. Figure: the residual with it over that without.
    NetworkSilenced = 21,
    /// The model explains a joint no longer well. Figure: the trust figure.
    TrustLost = 22,
    /// The model explains all joints well again. Figure: the trust figure.
    TrustRegained = 23,
    /// All measured torques are off by one factor: that is the sensors or the drives, not the arm. What is learnt from
    /// them stays out of the torque. Figure: the factor.
    CommonGain = 24,
    /// The estimate explains unseen rows better than the committed set: the active set follows it. Figure: its residual
    /// over that of the committed set.
    Followed = 25,
}

/// One decision of the guard.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Decision {
    /// Counter of the tick whose lesson brought it.
    pub tick: u32,
    /// What was decided and why.
    pub reason: Reason,
    /// The joint that gave rise to it, base to tool from 0; `None` where it concerns the arm.
    pub joint: Option<u8>,
    /// The figure the reason names; 0 where it names none.
    pub figure: f32,
}

/// Decisions that are kept.
pub const DECISION_CAPACITY: usize = 8;

/// Room for a [`Decision`], without one at first. Zeros have to be a value of it, as of everything in a learner: a board
/// makes room for one that is nothing but zeros.
#[derive(Clone, Copy, Debug, PartialEq)]
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

/// The newest decisions, and how many there were.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecisionLog {
    ring: [Slot; DECISION_CAPACITY],
    count: u32,
}

impl DecisionLog {
    /// No decision yet.
    pub const fn new() -> Self {
        Self {
            ring: [Slot::EMPTY; DECISION_CAPACITY],
            count: 0,
        }
    }

    /// Takes a decision; the oldest kept one gives way.
    pub(super) fn note(&mut self, decision: Decision) {
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

    /// How many decisions there were; wraps.
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Decision number `index`, counted from 0; `None` if it is not kept any more or not made yet.
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

    /// The newest decision.
    pub fn newest(&self) -> Option<Decision> {
        self.get(self.count.wrapping_sub(1))
    }
}

impl Default for DecisionLog {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_decisions_are_kept_and_older_ones_are_gone() {
        let mut log = DecisionLog::new();
        assert_eq!(log.newest(), None);
        for tick in 0..20 {
            log.note(Decision {
                tick,
                reason: Reason::Alarm,
                joint: None,
                figure: 0.0,
            });
            assert_eq!(log.newest().map(|decision| decision.tick), Some(tick));
        }
        for index in 0..25 {
            let kept = log.get(index).map(|decision| decision.tick);
            assert_eq!(kept, (12..20).contains(&index).then_some(index), "{index}");
        }
    }
}
