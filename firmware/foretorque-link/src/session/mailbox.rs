use super::Clock;
use crate::store::StoreMailbox;
use crate::telemetry::{Cost, CostMeter};
use foretorque::arm::Arm;
use foretorque::learning::{
    Exchange, Learner, LearnerConfig, LearningSample, ParameterSet, StartDeviations,
};
use heapless::spsc::Queue;

/// Period, and set with its deviations, from which the learner restarts.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Restart<const N: usize, const P: usize> {
    period_s: f32,
    set: ParameterSet<N, P>,
    start: StartDeviations<N, P>,
}

/// Everything that the tick shares with tasks of lower priority; on a board the one locked resource.
///
/// Every lock is a copy at most. The learner's task is
///
/// ```text
/// while let Some(sample) = lock(|mailboxes| mailboxes.learner.begin(&mut learner)) {
///     learner.study(&sample);                               // the tick may interrupt this
///     lock(|mailboxes| mailboxes.learner.finish(&mut learner, cost));
/// }
/// if lock(|mailboxes| mailboxes.learner.release_reply()) { … }    // wake the sender of replies
/// ```
///
/// and that of the housekeeping, which alone writes the flash,
///
/// ```text
/// if let Some(mut job) = lock(|mailboxes| mailboxes.store.begin()) {
///     let outcome = job.execute(&mut store, arm_hash);      // the tick may interrupt this
///     lock(|mailboxes| mailboxes.store.finish(&job, outcome));
/// }
/// ```
#[derive(Default)]
pub struct Mailboxes<const N: usize, const P: usize> {
    /// Between tick and learner.
    pub learner: LearnerMailbox<N, P>,
    /// Between tick and housekeeping.
    pub store: StoreMailbox,
}

impl<const N: usize, const P: usize> Mailboxes<N, P> {
    /// Empty mailboxes.
    pub const fn new() -> Self {
        Self {
            learner: LearnerMailbox::new(),
            store: StoreMailbox::new(),
        }
    }
}

/// Mailbox between tick and learner: learning samples one way, learnt sets the other.
pub struct LearnerMailbox<const N: usize, const P: usize> {
    samples: Queue<LearningSample<N>, 16>,
    pub(super) exchange: Exchange<N, P>,
    restart: Option<Restart<N, P>>,
    /// The reply of a tick waits for its learning step.
    held: bool,
    samples_lost: u32,
    learn_cost: CostMeter,
}

impl<const N: usize, const P: usize> LearnerMailbox<N, P> {
    /// An empty mailbox.
    pub const fn new() -> Self {
        Self {
            samples: Queue::new(),
            exchange: Exchange::new(),
            restart: None,
            held: false,
            samples_lost: 0,
            learn_cost: CostMeter::new(),
        }
    }

    /// Learning samples waiting.
    pub fn waiting(&self) -> usize {
        self.samples.len()
    }

    /// The content of the reply buffer must wait until the learner has called [`release_reply`](Self::release_reply).
    pub fn holds_reply(&self) -> bool {
        self.held
    }

    /// Called by the learner after its last sample; true when everything is learnt and a reply has waited for it.
    pub fn release_reply(&mut self) -> bool {
        self.samples.is_empty() && core::mem::take(&mut self.held)
    }

    pub(super) fn hold_reply(&mut self) {
        self.held = true;
    }

    pub(super) fn samples_lost(&self) -> u32 {
        self.samples_lost
    }

    pub(super) fn learn_cost(&self) -> Cost {
        self.learn_cost.cost()
    }

    pub(super) fn reset_counters(&mut self) {
        self.samples_lost = 0;
        self.learn_cost = CostMeter::new();
    }

    /// The next learning sample; before it, the learner takes over a restart or request. One copy at most.
    pub fn begin<A: Arm<N, P>>(
        &mut self,
        learner: &mut Learner<A, N, P>,
    ) -> Option<LearningSample<N>> {
        if let Some(Restart {
            period_s,
            set,
            start,
        }) = self.restart.take()
        {
            // The learner accepts the configuration of every period that the session accepts. If it refused one, it would
            // learn nothing: the samples that follow do not belong to its set.
            let _ = learner.restart_with(LearnerConfig::for_arm::<A>(period_s), &set, &start);
        }
        let sample = self.samples.dequeue()?;
        learner.collect(&sample, &mut self.exchange);
        Some(sample)
    }

    /// Takes over the learner's result; `cost` in counts of the board's counter.
    pub fn finish<A: Arm<N, P>>(&mut self, learner: &mut Learner<A, N, P>, cost: u32) {
        self.learn_cost.note(cost);
        // A set learnt before a restart must not reach the ticks after it.
        if self.restart.is_none() {
            learner.publish(&mut self.exchange);
        }
    }

    /// Learns from all samples waiting, where tick and learner take turns.
    pub fn work<A: Arm<N, P>>(&mut self, learner: &mut Learner<A, N, P>, clock: &impl Clock) {
        while let Some(sample) = self.begin(learner) {
            let start = clock.now();
            learner.study(&sample);
            self.finish(learner, clock.now().wrapping_sub(start));
        }
        self.release_reply();
    }

    pub(crate) fn post(&mut self, sample: LearningSample<N>) {
        if self.samples.enqueue(sample).is_err() {
            self.samples_lost = self.samples_lost.saturating_add(1);
        }
    }

    /// Sets on their way between tick and learner.
    pub(crate) fn exchange(&mut self) -> &mut Exchange<N, P> {
        &mut self.exchange
    }

    /// Drops all samples and sets; the learner restarts from `set` at `period_s`.
    #[inline(never)]
    pub(super) fn restart(
        &mut self,
        period_s: f32,
        set: &ParameterSet<N, P>,
        start: StartDeviations<N, P>,
    ) {
        while self.samples.dequeue().is_some() {}
        self.exchange = Exchange::new();
        self.restart = Some(Restart {
            period_s,
            set: *set,
            start,
        });
    }
}

impl<const N: usize, const P: usize> Default for LearnerMailbox<N, P> {
    fn default() -> Self {
        Self::new()
    }
}
