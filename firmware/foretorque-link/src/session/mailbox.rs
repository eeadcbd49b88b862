use super::Clock;
use super::protocol::{Signature, Transfer};
use crate::bank::Parameters;
use crate::telemetry::CostMeter;
use crate::wire::NackReason;
use foretorque::arm::Arm;
use foretorque::learning::{Exchange, Learner, LearningSample, ParameterSet, StartDeviations};
use heapless::spsc::Queue;

/// Everything that the tick shares with tasks of lower priority; on a board the one locked resource. Empty by default.
///
/// Every lock is a copy at most, but the first after a restart was asked for: the learner starts over in it. No torque flows
/// then. The learner's task is
///
/// ```text
/// while let Some(sample) = lock(|mailboxes| mailboxes.learner.begin(&mut learner)) {
///     learner.study(&sample);                               // the tick may interrupt this
///     lock(|mailboxes| mailboxes.learner.finish(&mut learner, cost));
/// }
/// if lock(|mailboxes| mailboxes.learner.release_reply()) { … }    // wake the sender of replies
/// ```
///
/// and that of the housekeeping, which encodes and checks banks and alone writes the flash,
///
/// ```text
/// if lock(|mailboxes| housekeeping.begin(&mut mailboxes.parameters)) {
///     let outcome = housekeeping.execute();                 // the tick may interrupt this
///     lock(|mailboxes| housekeeping.finish(&mut mailboxes.parameters, outcome));
/// }                                                         // wake the tick: the session replies
/// ```
#[derive(Default)]
pub struct Mailboxes<const N: usize, const P: usize> {
    /// Between tick and learner.
    pub learner: LearnerMailbox<N, P>,
    /// Between tick and housekeeping.
    pub parameters: ParameterMailbox<N, P>,
}

/// Mailbox between tick and learner: learning samples one way, learnt sets the other.
#[derive(Default)]
pub struct LearnerMailbox<const N: usize, const P: usize> {
    samples: Queue<LearningSample<N>, 16>,
    /// Sets on their way between tick and learner.
    pub(crate) exchange: Exchange<N, P>,
    /// Period, s, set and deviations from which the learner restarts.
    restart: Option<(f32, ParameterSet<N, P>, StartDeviations<N, P>)>,
    /// The reply of a tick waits for its learning step.
    pub(super) held: bool,
    pub(super) samples_lost: u32,
    pub(super) learn_cost: CostMeter,
}

impl<const N: usize, const P: usize> LearnerMailbox<N, P> {
    /// The content of the reply buffer must wait until the learner has called [`release_reply`](Self::release_reply).
    pub fn holds_reply(&self) -> bool {
        self.held
    }

    /// Called by the learner after its last sample; true when everything is learnt and a reply has waited for it.
    pub fn release_reply(&mut self) -> bool {
        self.samples.is_empty() && core::mem::take(&mut self.held)
    }

    pub(super) fn reset_counters(&mut self) {
        self.samples_lost = 0;
        self.learn_cost = CostMeter::default();
    }

    /// Restarts the learner as asked. A function of its own: its stack is not that of a learning step.
    #[inline(never)]
    fn restart_learner<A: Arm<N, P>>(&mut self, learner: &mut Learner<A, N, P>) {
        if let Some((period_s, set, start)) = self.restart.take() {
            // The learner accepts every period that the session accepts. If it refused one, it would learn nothing: the
            // samples that follow do not belong to its set.
            let _ = learner.restart_for_arm(period_s, &set, &start);
        }
    }

    /// The next learning sample; before it, the learner takes over a request, one copy at most, or starts over.
    pub fn begin<A: Arm<N, P>>(
        &mut self,
        learner: &mut Learner<A, N, P>,
    ) -> Option<LearningSample<N>> {
        if self.restart.is_some() {
            self.restart_learner(learner);
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

    /// Drops all samples and sets; the learner restarts from `set` at `period_s`.
    #[inline(never)]
    pub(super) fn restart(
        &mut self,
        period_s: f32,
        set: &ParameterSet<N, P>,
        start: StartDeviations<N, P>,
    ) {
        while self.samples.dequeue().is_some() {}
        self.exchange.clear();
        self.restart = Some((period_s, *set, start));
    }
}

/// An upload as its last frame announces it.
#[derive(Clone, Copy)]
pub(super) struct Upload {
    /// CRC-32 over the bytes.
    pub(super) crc: u32,
    /// `None` on a board without a key.
    pub(super) signature: Option<Signature>,
}

/// Order of the session to the housekeeping.
#[derive(Clone, Copy)]
pub(super) enum Order {
    /// Encode a set.
    Read,
    /// Load the stored bank to read it.
    ReadStored,
    /// Encode a set and store it.
    Save,
    /// Load and check the stored bank.
    Restore,
    /// Return the bank of the firmware.
    Reset,
    /// Check the uploaded bank.
    Commit(Upload),
    /// Check the uploaded excitation.
    Excitation(Upload),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Free,
    Waiting,
    Running,
    Done(Result<(), NackReason>),
}

/// Mailbox between the session, which takes orders in the tick, and the [`Housekeeping`](super::Housekeeping).
pub struct ParameterMailbox<const N: usize, const P: usize> {
    phase: Phase,
    order: Order,
    requester: u16,
    pub(super) transfer: Transfer,
    pub(super) parameters: Parameters<N, P>,
}

impl<const N: usize, const P: usize> ParameterMailbox<N, P> {
    /// Accepts an order of frame `requester`.
    ///
    /// Errors: [`NackReason::Busy`] until the order before is answered.
    pub(super) fn post(&mut self, requester: u16, order: Order) -> Result<(), NackReason> {
        self.idle()?;
        (self.requester, self.order, self.phase) = (requester, order, Phase::Waiting);
        Ok(())
    }

    /// Accepts an order of frame `requester` that encodes `set`.
    ///
    /// Errors: as [`post`](Self::post).
    pub(super) fn read(
        &mut self,
        requester: u16,
        order: Order,
        set: &ParameterSet<N, P>,
    ) -> Result<(), NackReason> {
        self.post(requester, order)?;
        self.parameters.set = *set;
        Ok(())
    }

    /// Errors: [`NackReason::Busy`] until the last order is answered.
    pub(super) fn idle(&self) -> Result<(), NackReason> {
        (self.phase == Phase::Free)
            .then_some(())
            .ok_or(NackReason::Busy)
    }

    /// Errors: [`NackReason::Busy`] while an order is executed that needs a board at rest.
    pub(super) fn undisturbed(&self) -> Result<(), NackReason> {
        match self.order {
            Order::Read => Ok(()),
            _ => self.idle(),
        }
    }

    /// The order that waits, with the bytes of the transfer and the set.
    pub(super) fn begin(&mut self) -> Option<(Order, &[u8], &ParameterSet<N, P>)> {
        (self.phase == Phase::Waiting).then(|| {
            self.phase = Phase::Running;
            (self.order, self.transfer.content(), &self.parameters.set)
        })
    }

    /// Takes the result of the order: bytes to read, and the parameters in force.
    pub(super) fn finish(
        &mut self,
        bytes: &[u8],
        parameters: &Parameters<N, P>,
        outcome: Result<(), NackReason>,
    ) {
        match self.order {
            Order::Read | Order::ReadStored => self.transfer.hold(bytes),
            Order::Restore | Order::Reset | Order::Commit(_) => self.parameters = *parameters,
            Order::Save | Order::Excitation(_) => {}
        }
        self.phase = Phase::Done(outcome);
    }

    /// Order, sequence number of its frame and result, once.
    pub(super) fn collect(&mut self) -> Option<(Order, u16, Result<(), NackReason>)> {
        let Phase::Done(outcome) = self.phase else {
            return None;
        };
        self.phase = Phase::Free;
        Some((self.order, self.requester, outcome))
    }
}

impl<const N: usize, const P: usize> Default for ParameterMailbox<N, P> {
    /// Without an order.
    fn default() -> Self {
        Self {
            phase: Phase::Free,
            order: Order::Read,
            requester: 0,
            transfer: Transfer::new(),
            parameters: Parameters::zero(),
        }
    }
}
