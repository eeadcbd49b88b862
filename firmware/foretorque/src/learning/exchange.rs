use super::decision::DecisionLog;
use super::parameters::{ParameterSet, StartDeviations};
use super::quality::ModelQuality;
use super::shares::LearntShare;
use crate::dynamics::BaseParameters;
use crate::joint::JointMeasurement;
use crate::limits::Flags;

/// Output of one tick for the learner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearningSample<const N: usize> {
    /// Counter of the tick.
    pub tick: u32,
    /// Number of the last load before the tick; a learner uses only samples of its own load.
    pub generation: u32,
    /// Number of requests made before the tick.
    pub requests: u32,
    /// Measurement; `None` without a fresh one.
    pub measured: Option<JointMeasurement<N>>,
    /// True if learning is switched on.
    pub enabled: bool,
    /// Flags of the tick.
    pub flags: Flags,
}

impl<const N: usize> LearningSample<N> {
    /// Ticks after which the counter may wrap: whole rounds of `N`, and whole periods of all that the learner does at times.
    pub(crate) const WHOLE_TICKS: u32 = 16_000 * N as u32;
    /// Last value of the counter of the tick.
    pub(crate) const LAST_TICK: u32 = u32::MAX / Self::WHOLE_TICKS * Self::WHOLE_TICKS - 1;

    /// Counter of the tick after `tick`.
    pub(crate) const fn tick_after(tick: u32) -> u32 {
        if tick >= Self::LAST_TICK { 0 } else { tick + 1 }
    }
}

/// Range of motion for which the model has been learnt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionRange<const N: usize> {
    /// Largest speed of each joint, rad/s.
    pub velocity: [f32; N],
    /// Largest acceleration of each joint, rad/s².
    pub acceleration: [f32; N],
}

impl<const N: usize> MotionRange<N> {
    /// Empty range.
    pub const NONE: Self = Self {
        velocity: [0.0; N],
        acceleration: [0.0; N],
    };
}

/// Report of the learner, published with every set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LearnerReport<const N: usize> {
    /// Agreement of the active set with the measured torques.
    pub quality: ModelQuality<N>,
    /// Decisions of the supervisor.
    pub decisions: DecisionLog,
}

impl<const N: usize> LearnerReport<N> {
    /// Report before the first sample.
    pub const fn new() -> Self {
        Self {
            quality: ModelQuality::new(),
            decisions: DecisionLog::new(),
        }
    }
}

/// Published set of a closed round; the tick adopts all of it or nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Publication<const N: usize, const P: usize> {
    /// Last tick of the round.
    pub closed: u32,
    /// Number of the load that the set was learnt from; after another load it is discarded.
    pub generation: u32,
    /// Learnt set, with the networks of the torque.
    pub set: ParameterSet<N, P>,
    /// Its share in the torque.
    pub share: LearntShare<N>,
    /// Base parameters of the payload, to be added to those of the set.
    pub payload: BaseParameters<P>,
    /// Range of motion for which the set has been learnt.
    pub range: MotionRange<N>,
    /// True if set and share become the committed ones as well.
    pub commit: bool,
    /// Report of the learner.
    pub report: LearnerReport<N>,
}

/// Request to the learner by the owner of the board.
///
/// It takes effect with the learning sample of a given tick, so that the result does not depend on the learner's speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Request {
    /// Copy the active set to the snapshot.
    Snapshot = 1,
    /// Return to the snapshot, bit for bit.
    Rollback = 2,
    /// Commit the active set: the bound on learnt change is centred at it from then on.
    Commit = 3,
    /// Set the payload to zero: the hand is empty.
    ZeroPayload = 4,
    /// Emergency stop: drop what was learnt in the last moments, and learn nothing until learning is switched off and on.
    Stop = 5,
}

impl Request {
    /// Request with the wire code `code`; `None` for an unknown code.
    pub const fn from_code(code: u8) -> Option<Self> {
        Some(match code {
            1 => Self::Snapshot,
            2 => Self::Rollback,
            3 => Self::Commit,
            4 => Self::ZeroPayload,
            5 => Self::Stop,
            _ => return None,
        })
    }
}

/// Request rejected: the one before has not taken effect yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RequestPending;

impl core::fmt::Display for RequestPending {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the previous request is still pending")
    }
}

impl core::error::Error for RequestPending {}

/// Mailbox between tick and learner, their only shared state; each locks it for one copy.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exchange<const N: usize, const P: usize> {
    /// Finished set, from the learner to the tick.
    pub published: Option<Publication<N, P>>,
    /// Loaded set with its deviations, from the tick to the learner, and the number of its load.
    pub reload: Option<(u32, ParameterSet<N, P>, StartDeviations<N, P>)>,
    /// Request to the learner, with its number.
    pub request: Option<(u32, Request)>,
}

impl<const N: usize, const P: usize> Exchange<N, P> {
    /// Empty mailbox.
    pub const fn new() -> Self {
        Self {
            published: None,
            reload: None,
            request: None,
        }
    }

    /// Discard everything in it.
    pub fn clear(&mut self) {
        // One after the other: an empty mailbox as a value would be copied whole.
        self.published = None;
        self.reload = None;
        self.request = None;
    }

    /// Post request number `number`, to take effect with the first sample whose [`LearningSample::requests`] equals it.
    ///
    /// Errors: the previous request is pending; it stays.
    pub fn post_request(&mut self, number: u32, request: Request) -> Result<(), RequestPending> {
        if self.request.is_some() {
            return Err(RequestPending);
        }
        self.request = Some((number, request));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_maps_to_its_request_or_to_none() {
        let known = [
            Request::Snapshot,
            Request::Rollback,
            Request::Commit,
            Request::ZeroPayload,
            Request::Stop,
        ];
        for code in 0..=u8::MAX {
            let expected = known.into_iter().find(|&request| request as u8 == code);
            assert_eq!(Request::from_code(code), expected, "{code}");
        }
    }
}
