use super::detector::{ChangeDetector, Decimator, Slice};
use super::evidence::Evidence;
use super::guard_config::SupervisorConfig;
use super::payload::{PAYLOAD_PARAMETERS, Payload, PayloadFilter, payload_sigma};
use super::stacked::LinearParameters;
use super::trial::Trial;
use crate::dynamics::BaseParameters;
use crate::joint::zero_vector;

/// Linear parameters of one instant: what the estimate was and what was in the torque.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Checkpoint<const N: usize, const P: usize> {
    pub(super) estimate: LinearParameters<N, P>,
    pub(super) active: LinearParameters<N, P>,
    pub(super) committed: LinearParameters<N, P>,
    pub(super) payload: Payload,
}

/// Slices for which a payload has to be carried for the arm's own parameters to be learnt on, and for the friction learnt
/// then to stay: half a minute.
const LONG_CARRIED_SLICES: u32 = 3000;
/// Rows after which a set that need not be followed is good enough for networks to be trained on what it leaves.
const TRAINING_ROWS: u32 = 4096;

/// What the guard carries from lesson to lesson.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Guard<const N: usize, const P: usize> {
    pub(super) detector: ChangeDetector<N>,
    pub(super) decimator: Decimator<N>,
    /// The slice that is being worked through, a joint a tick, and the joint whose turn it is.
    pub(super) waiting: Option<(Slice<N>, usize)>,
    /// The payload in the torque, and what it adds to the base parameters.
    pub(super) payload: Payload,
    pub(super) payload_base: BaseParameters<P>,
    /// Weighs on after a payload was believed.
    pub(super) filter: PayloadFilter,
    pub(super) slices_carried: u32,
    pub(super) trial: Trial,
    /// Mean square of each joint's slices while nothing happens, in units of the configured noise, and how many of them
    /// it is the mean of.
    pub(super) slice_variance: [(f32, u32); N],
    /// From before the payload in the torque.
    pub(super) unloaded: Option<Checkpoint<N, P>>,
    /// From the last and the last but one checkpoint: an alarm comes after the change.
    pub(super) checkpoints: [Checkpoint<N, P>; 2],
    /// The estimate against the committed set.
    pub(super) evidence: Evidence<N>,
    pub(super) committed: LinearParameters<N, P>,
    /// The active set follows the estimate.
    pub(super) following: bool,
    /// Ticks for which the estimate has been followed since the last commit.
    pub(super) followed: u32,
    /// Ticks for which alarms are not listened to after a change that is no payload.
    pub(super) relearning: u32,
    /// Next friction column whose doubt is raised after such a change.
    pub(super) reopen: usize,
    /// A common factor on all torques was found, and said so.
    pub(super) gain_fault: bool,
}

impl<const N: usize, const P: usize> Guard<N, P> {
    /// Begins with `set` active, committed and estimated, and an empty hand.
    pub(super) const fn new(config: &SupervisorConfig, set: &LinearParameters<N, P>) -> Self {
        let nothing = [0.0; PAYLOAD_PARAMETERS];
        let checkpoint = Checkpoint {
            estimate: *set,
            active: *set,
            committed: *set,
            payload: nothing,
        };
        Self {
            detector: ChangeDetector::new(),
            decimator: Decimator::new(),
            waiting: None,
            payload: nothing,
            payload_base: zero_vector(),
            filter: PayloadFilter::new(&nothing, &payload_sigma(config.max_payload_mass)),
            slices_carried: 0,
            trial: Trial::new(config, &nothing),
            slice_variance: [(1.0, 0); N],
            unloaded: None,
            checkpoints: [checkpoint; 2],
            evidence: Evidence::NONE,
            committed: *set,
            following: false,
            followed: 0,
            relearning: 0,
            reopen: usize::MAX,
            gain_fault: false,
        }
    }

    /// Something is in the hand.
    pub(super) fn loaded(&self) -> bool {
        self.unloaded.is_some()
    }

    /// The linear parameters in the torque are good enough for the networks to learn what they leave.
    pub(super) fn trains(&self) -> bool {
        let settled = self.following || self.evidence.rows() >= TRAINING_ROWS;
        settled && !self.gain_fault && self.relearning == 0
    }

    /// The payload is still being weighed.
    pub(super) fn weighing(&self, config: &SupervisorConfig) -> bool {
        self.loaded() && self.slices_carried < config.payload_update_blocks
    }

    /// The arm's own parameters rest while a payload is carried, unless for long. On release they are again what they were
    /// before it: rows learnt meanwhile would be lost, but their covariance would go on as if they were known.
    pub(super) fn resting(&self) -> bool {
        self.loaded() && self.slices_carried < LONG_CARRIED_SLICES
    }

    /// What was gathered of the torques does not join on to what comes.
    pub(super) fn forget_slices(&mut self) {
        self.decimator.reset();
        self.waiting = None;
    }
}
