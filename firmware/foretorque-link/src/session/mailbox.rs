use super::Clock;
use crate::store::StoreMailbox;
use crate::telemetry::CostMeter;
use foretorque::arm::Arm;
use foretorque::learning::{Exchange, Learner, LearnerConfig, Lesson, ParameterSet};
use heapless::spsc::Queue;

/// A new period for the learner, which then starts over from a set.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Restart<const N: usize, const P: usize> {
    period_s: f32,
    set: ParameterSet<N, P>,
}

/// What tick and learner share: lessons one way, learnt sets the other.
///
/// Where they run at different priorities this is the one locked resource, and every lock is a copy at most. The learner's
/// task is
///
/// ```text
/// while let Some(lesson) = lock(|mailbox| mailbox.begin(&mut learner)) {
///     learner.study(&lesson);                               // the tick may run in the middle of it
///     lock(|mailbox| mailbox.finish(&mut learner, cost));
/// }
/// if lock(|mailbox| mailbox.release_reply()) { … }               // wake who sends
/// ```
pub struct LearnerMailbox<const N: usize, const P: usize> {
    lessons: Queue<Lesson<N>, 16>,
    pub(super) exchange: Exchange<N, P>,
    restart: Option<Restart<N, P>>,
    /// The answer of a tick waits for its lesson.
    held: bool,
    /// Orders for the store, which the housekeeping carries out.
    pub store: StoreMailbox,
    pub(super) learning_samples_lost: u32,
    pub(super) learn_cost: CostMeter,
}

impl<const N: usize, const P: usize> LearnerMailbox<N, P> {
    /// An empty mailbox.
    pub const fn new() -> Self {
        Self {
            lessons: Queue::new(),
            exchange: Exchange::new(),
            restart: None,
            held: false,
            store: StoreMailbox::new(),
            learning_samples_lost: 0,
            learn_cost: CostMeter::new(),
        }
    }

    /// Lessons waiting.
    pub fn waiting(&self) -> usize {
        self.lessons.len()
    }

    /// The host wants its answer when everything is learnt: what lies in the reply buffer is to be sent once the learner has
    /// called [`release_reply`](Self::release_reply), and not before.
    pub fn holds_reply(&self) -> bool {
        self.held
    }

    /// Called by the learner after every lesson it found. True when everything is learnt and an answer has waited for it.
    pub fn release_reply(&mut self) -> bool {
        self.lessons.is_empty() && core::mem::take(&mut self.held)
    }

    pub(super) fn hold_answer(&mut self) {
        self.held = true;
    }

    /// The next lesson, and whatever the learner has to take over before it. Touches `learner` for one copy at most.
    pub fn begin<A: Arm<N, P>>(&mut self, learner: &mut Learner<A, N, P>) -> Option<Lesson<N>> {
        if let Some(Restart { period_s, set }) = self.restart.take() {
            // A period that the session has accepted makes a configuration that the learner accepts.
            // Should it refuse, it learns nothing: lessons from then on are not of its set.
            let _ = learner.restart(LearnerConfig::for_arm::<A>(period_s), &set);
        }
        let lesson = self.lessons.dequeue()?;
        learner.collect(&lesson, &mut self.exchange);
        Some(lesson)
    }

    /// Takes over what the learner made of the lesson. `cost` counts on the board's counter; 0 where there is none.
    pub fn finish<A: Arm<N, P>>(&mut self, learner: &mut Learner<A, N, P>, cost: u32) {
        self.learn_cost.note(cost);
        // What was learnt for ticks before a restart must not meet the ticks after it.
        if self.restart.is_none() {
            learner.publish(&mut self.exchange);
        }
    }

    /// Works through all lessons waiting, where tick and learner take turns. `clock` is the board's counter.
    pub fn work<A: Arm<N, P>>(&mut self, learner: &mut Learner<A, N, P>, clock: &impl Clock) {
        while let Some(lesson) = self.begin(learner) {
            let start = clock.now();
            learner.study(&lesson);
            self.finish(learner, clock.now().wrapping_sub(start));
        }
        self.release_reply();
    }

    pub(super) fn post(&mut self, lesson: Lesson<N>) {
        if self.lessons.enqueue(lesson).is_err() {
            self.learning_samples_lost = self.learning_samples_lost.saturating_add(1);
        }
    }

    /// Forgets all lessons and sets; the learner starts over from `set` at `period_s`.
    #[inline(never)]
    pub(super) fn restart(&mut self, period_s: f32, set: &ParameterSet<N, P>) {
        while self.lessons.dequeue().is_some() {}
        self.exchange = Exchange::new();
        self.restart = Some(Restart {
            period_s,
            set: *set,
        });
    }
}

impl<const N: usize, const P: usize> Default for LearnerMailbox<N, P> {
    fn default() -> Self {
        Self::new()
    }
}
