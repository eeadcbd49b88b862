//! State between ticks: the parameters in force, and the torque of the last tick.

use super::Torque;
use super::model::{Difference, LearntRange};
use super::shares::{evaluate, gravity};
use crate::arm::Arm;
use crate::dynamics::{BaseParameters, rnea};
use crate::joint::{JointMotion, JointVector};
use crate::learning::{LearnerReport, LearntShare, LinearParameters, ParameterSet};
use crate::limits::Flags;

/// State between ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardState<const N: usize, const P: usize> {
    /// Single set for reports and storage: loaded and learnt parameters by their shares.
    pub active: ParameterSet<N, P>,
    /// The fallback; see [`committed`](Self::committed).
    pub(super) committed: ParameterSet<N, P>,
    /// Counter of the tick to come.
    pub tick: u32,
    /// Learning is switched on.
    pub learning: bool,
    /// Ticks to end before the learner takes samples again.
    pub(super) off_ticks: u8,
    /// Number of sets that were missing at the tick of their adoption.
    pub late_sets: u32,
    /// Report of the supervisor that came with the set in force.
    pub report: LearnerReport<N>,
    /// Base parameters that the payload adds.
    pub payload: BaseParameters<P>,
    /// Torque of the payload in the last tick, after its bound, N × N·m; part of the rigid-body share.
    pub payload_torque: JointVector<N>,
    /// The motion for which the active set has been learnt.
    pub(super) range: LearntRange<N>,
    /// The set that was last loaded: what was learnt is measured from it.
    pub(super) loaded: ParameterSet<N, P>,
    pub(super) active_difference: Difference<N, P>,
    pub(super) committed_difference: Difference<N, P>,
    /// Learnt part in the torque of the last tick, payload included.
    pub(super) learned: JointVector<N>,
    /// The learnt part of the last tick does not count in the next: of other parameters, or too old.
    pub(super) fresh: bool,
    pub(super) committing: Committing,
    pub(super) last: Torque<N>,
    pub(super) stale_ticks: u32,
    /// Number of the last load.
    pub(super) generation: u32,
    pub(super) requests: u32,
    /// Rounds to come in which no set is due yet.
    pub(super) rounds_without_set: u32,
    pub(super) adoption: Flags,
}

/// Progress of a commit, by which the active set becomes the committed one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Committing {
    No,
    /// Waits for a tick with a sample, which compares the two sets.
    Compare,
    /// Compared; the set is copied before the next tick, so that no tick lasts longer for it.
    Copy,
}

/// Rounds after a load in which no set is due: the first may be cut short, and the next then closes too late.
const ROUNDS_WITHOUT_SET: u32 = 2;

impl<const N: usize, const P: usize> FeedForwardState<N, P> {
    /// At tick 0, torque zero, learning frozen, with `set` both active and committed.
    pub fn new(set: ParameterSet<N, P>) -> Self {
        Self {
            active: set,
            committed: set,
            tick: 0,
            learning: false,
            off_ticks: 0,
            late_sets: 0,
            report: LearnerReport::new(),
            payload: BaseParameters::zeros(),
            payload_torque: JointVector::zeros(),
            range: LearntRange::none(),
            loaded: set,
            active_difference: Difference::none(),
            committed_difference: Difference::none(),
            learned: JointVector::zeros(),
            fresh: true,
            committing: Committing::No,
            last: Torque::zero(),
            stale_ticks: 0,
            generation: 0,
            requests: 0,
            rounds_without_set: ROUNDS_WITHOUT_SET,
            adoption: Flags::NONE,
        }
    }

    /// Back to what [`new`](Self::new) makes of `set`, in place: a board does it in the tick, whose stack is small. The
    /// numbers of loads and requests go on.
    #[inline(never)]
    pub(super) fn restart(&mut self, set: &ParameterSet<N, P>) {
        self.tick = 0;
        self.load(set);
        self.learning = false;
        self.off_ticks = 0;
        self.late_sets = 0;
        self.report = LearnerReport::new();
        self.payload_torque = JointVector::zeros();
        self.learned = JointVector::zeros();
        self.last = Torque::zero();
        self.stale_ticks = 0;
        self.adoption = Flags::NONE;
    }

    /// Makes `set` loaded, active and committed from the tick to come on; the hand is empty.
    pub(super) fn load(&mut self, set: &ParameterSet<N, P>) {
        self.loaded = *set;
        self.payload.fill(0.0);
        self.range = LearntRange::none();
        self.fresh = true;
        self.committing = Committing::No;
        self.active = *set;
        self.committed = *set;
        self.active_difference = Difference::none();
        self.committed_difference = Difference::none();
        self.generation = self.generation.wrapping_add(1);
        self.rounds_without_set = ROUNDS_WITHOUT_SET;
    }

    /// Torque of the parameters in force for `motion`, N × N·m: loaded set, learnt change by the share of each joint, and
    /// payload, without limits other than the network's bound.
    pub fn torque<A: Arm<N, P>>(&self, motion: &JointMotion<N>) -> JointVector<N> {
        let mut set = self.active;
        set.rigid = self.loaded.rigid + self.payload;
        set.friction = self.active_difference.friction_over(&self.loaded.friction);
        let mut torque = evaluate::<A, N, P>(&set, motion).total;
        let learnt = rnea::<A, N, P>(&self.active_difference.rigid, motion);
        for (joint, share) in self.active_difference.share.iter().enumerate() {
            torque[joint] += share * learnt[joint];
        }
        torque
    }

    /// Bring the learnt `set` into the torque with its `share`.
    pub(super) fn set_active(&mut self, set: &ParameterSet<N, P>, share: &LearntShare<N>) {
        self.active_difference
            .update(set, &share.joint, &self.loaded);
        self.active = *set;
        let loaded = LinearParameters::of(&self.loaded);
        let single = share.single_set(&loaded, &LinearParameters::of(set));
        single.write(&mut self.active);
    }

    /// The set that was last loaded, without what was learnt since.
    pub fn loaded(&self) -> &ParameterSet<N, P> {
        &self.loaded
    }

    /// Torque of gravity at the position `q`, N × rad, by the committed set and the payload, N × N·m; 0 where it is not
    /// plausible.
    pub fn gravity<A: Arm<N, P>>(&self, q: &JointVector<N>) -> JointVector<N> {
        gravity::<A, N, P>(&(self.committed().rigid + self.payload), q)
    }

    /// The set that stands in for the active one: the one that was last loaded or committed.
    pub fn committed(&self) -> &ParameterSet<N, P> {
        // The active set waits to become it.
        match self.committing {
            Committing::No => &self.committed,
            Committing::Compare | Committing::Copy => &self.active,
        }
    }

    /// Make what is active the fallback, and the centre of the bound on learnt change.
    pub(super) fn commit(&mut self) {
        self.committing = Committing::No;
        self.committed = self.active;
        self.committed_difference = self.active_difference;
    }
}
