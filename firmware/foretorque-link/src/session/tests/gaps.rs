//! A lost sample on a board that samples pace, against the tick without a sample of a board that its timer paces.

use super::*;
use crate::safety::promises::{Promises, Timing};
use crate::wire::SampleFlags;
use foretorque::learning::{MAX_BRIDGED, TAPS};
use proptest::prelude::*;

/// Length of the motion filter at 1 kHz, ticks.
const FILTER: u32 = 2 * TAPS as u32;

/// A board that its timer paces, or one that samples pace and a host that numbers its periods.
struct Paced {
    board: Board,
    pacing: Pacing,
    period: u8,
}

impl Paced {
    fn armed(pacing: Pacing) -> Self {
        let mut paced = Self {
            board: Board::new(),
            pacing,
            period: 0,
        };
        // A restart for both: it is counted in the learner's state.
        paced.board.pace(pacing);
        (0..ARM_SAMPLES).for_each(|_| _ = paced.sample(0));
        paced.board.acknowledged(HostMessage::Arm);
        paced.board.acknowledged(HostMessage::Learning { on: true });
        paced
    }

    fn sample(&mut self, k: u32) -> TorqueFrame<N> {
        let frame = SampleFrame::new(&swinging(k)).in_period(self.period);
        self.period = self.period.wrapping_add(1);
        let torque = match self.pacing {
            Pacing::Link => torque(&self.board.request(HostMessage::Sample(frame))),
            Pacing::SysTick => self.board.period(Some(swinging(k))).unwrap(),
        };
        self.board.learn();
        torque
    }

    /// Samples `first` to `last - 1`; how many rows the learner has accepted in them.
    fn accepted(&mut self, samples: core::ops::Range<u32>) -> u32 {
        let before = self.board.learner.state().statistics.accepted;
        samples.for_each(|k| _ = self.sample(k));
        self.board.learner.state().statistics.accepted - before
    }

    /// A sample that does not arrive; with a timer its period is a tick.
    fn lose(&mut self) {
        self.period = self.period.wrapping_add(1);
        match self.pacing {
            Pacing::Link => self.board.sequence += 1,
            Pacing::SysTick => {
                self.board.period(None).unwrap();
                self.board.learn();
            }
        }
    }
}

/// A motion fast enough to learn from, with the torques of an arm that is a tenth heavier.
fn swinging(k: u32) -> JointSample<N> {
    let t = k as f32 * 1e-3;
    let rate = |j: usize| 2.0 + 0.3 * j as f32;
    let phase = |j: usize| rate(j) * t + j as f32;
    let desired = JointMotion {
        q: JointVector::from_fn(|j, _| phase(j).sin()),
        qd: JointVector::from_fn(|j, _| rate(j) * phase(j).cos()),
        qdd: JointVector::from_fn(|j, _| -rate(j) * rate(j) * phase(j).sin()),
    };
    let mut truth = ParameterSet::nominal::<Ur5>(NETWORK_SEED);
    truth.rigid *= 1.1;
    let tau = foretorque::feedforward::evaluate::<Ur5, N, P>(&truth, &desired).total;
    JointSample {
        desired,
        measured: Some(JointMeasurement { q: desired.q, tau }),
    }
}

/// Runs both boards through 600 ticks, those in `lost` without a sample; returns whether their torques were equal.
fn together(lost: &[u32]) -> (Paced, Paced, bool) {
    let [mut timed, mut linked] = [Pacing::SysTick, Pacing::Link].map(Paced::armed);
    let mut same = true;
    for k in 0..600 {
        if lost.contains(&k) {
            timed.lose();
            linked.lose();
            continue;
        }
        let torques = [timed.sample(k), linked.sample(k)];
        let [expected, given] = torques.map(|it| (it.tick, it.flags, it.total));
        same &= given == expected;
    }
    (timed, linked, same)
}

#[test]
fn a_lost_sample_acts_as_a_tick_without_sample() {
    // One, two and three in a row, and close together, at every place of a round.
    let lost: Vec<u32> = (0..6)
        .flat_map(|place| {
            let first = 40 + 91 * place;
            [0, 20, 21, 40, 41, 42, 50, 52].map(|later| first + later)
        })
        .collect();
    let (timed, linked, same) = together(&lost);
    assert!(same, "a torque differs");
    assert!(timed.board.learner.state() == linked.board.learner.state());
    let seen = timed.board.learner.state().statistics;
    assert!(seen.accepted > 400, "{seen:?}");
    let stale = linked.board.statistics().stale_ticks;
    assert_eq!(stale, lost.len() as u32);
}

#[test]
fn a_gap_that_cannot_be_bridged_empties_the_window_on_both() {
    // The set of a round that closes in such a gap can be a round late, so the torques may differ; the learners do not.
    for first in 200..206 {
        let lost: Vec<u32> = (first..=first + MAX_BRIDGED as u32).collect();
        let (timed, linked, _) = together(&lost);
        assert!(timed.board.learner.state() == linked.board.learner.state());
    }
    let mut linked = Paced::armed(Pacing::Link);
    assert!(linked.accepted(0..200) > 0);
    (0..20).for_each(|_| linked.lose());
    // The last sample before the gap serves the joints whose turn is in it.
    assert!(linked.accepted(220..221) <= MAX_BRIDGED as u32);
    assert_eq!(linked.accepted(221..219 + FILTER), 0);
    assert!(linked.accepted(219 + FILTER..225 + FILTER) > 0);
}

#[test]
fn a_lost_command_costs_no_learning_sample() {
    let [mut whole, mut commanded] = [Pacing::Link; 2].map(Paced::armed);
    for k in 0..100 {
        whole.sample(k);
        commanded.sample(k);
        // The number of a command that never arrived.
        commanded.board.sequence += 1;
    }
    assert!(whole.board.learner.state() == commanded.board.learner.state());
}

#[test]
fn after_a_hello_the_window_is_empty() {
    let mut linked = Paced::armed(Pacing::Link);
    // The samples before the motion are copies, so the window fills twice.
    assert!(linked.accepted(0..200) > 0);
    linked.board.request(HostMessage::Hello);
    assert!(linked.accepted(200..201) <= MAX_BRIDGED as u32);
    assert_eq!(linked.accepted(201..199 + FILTER), 0);
}

/// A board, its timer, a host that sends one sample a period, and the line between them.
pub(super) struct Timeline {
    pub(super) board: Board,
    pub(super) promises: Promises<N>,
    /// Number of the sample of the next period, and of the first that has not arrived.
    pub(super) next: u32,
    pub(super) arrives: u32,
    random: u32,
}

impl Timeline {
    pub(super) fn new(pacing: Pacing, seed: u32) -> Self {
        Self::braked(pacing, 0, seed)
    }

    pub(super) fn braked(pacing: Pacing, brake_close_ms: u16, seed: u32) -> Self {
        let mut board = Board::new();
        board.acknowledged(configure(|wanted| {
            (wanted.pacing, wanted.brake_close_ms) = (pacing, brake_close_ms);
        }));
        let close_us = 1000 * u32::from(brake_close_ms);
        let limits = SafetyLimits::for_arm::<Ur5, P>(1000).with_brake(close_us, 1000);
        let promises = Promises::new(limits, board.session.feed_forward().config());
        let mut timeline = Self {
            board,
            promises,
            next: 0,
            arrives: 0,
            random: seed,
        };
        timeline.timer();
        timeline
    }

    pub(super) fn armed(pacing: Pacing) -> Self {
        let mut timeline = Self::new(pacing, 1);
        (0..ARM_SAMPLES).for_each(|_| timeline.period(Timing::Exact));
        timeline.request(HostMessage::Arm);
        (0..50).for_each(|_| timeline.period(Timing::Exact));
        assert!(timeline.torque() > 20.0, "{pacing:?}");
        timeline
    }

    pub(super) fn random(&mut self) -> u32 {
        self.random = self
            .random
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        self.random >> 8
    }

    pub(super) fn torque(&self) -> f32 {
        self.board.session.torque_output().abs().sum()
    }

    pub(super) fn state(&self) -> SafetyState {
        self.board.session.safety().state
    }

    pub(super) fn observe(&mut self, replies: &Replies) {
        let used = replies.iter().any(|(_, reply)| {
            let stale = |torque: &TorqueFrame<N>| Flags(torque.flags).contains(Flags::STALE_SAMPLE);
            matches!(reply, BoardMessage::Torque(torque) if !stale(torque))
        });
        let session = &self.board.session;
        let (torque, enabled) = (*session.torque_output(), session.torque_enabled());
        let safety = session.safety();
        let checked = self.promises.check(&torque, enabled, safety, used);
        assert_eq!(checked, Ok(()), "sample {}, {safety}", self.next);
    }

    pub(super) fn timer(&mut self) -> usize {
        self.promises.period();
        let replies = self.board.timer();
        self.observe(&replies);
        replies.len()
    }

    pub(super) fn request(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        let arms = message == HostMessage::Arm;
        let reply = self.board.request(message);
        if arms && reply == ACK {
            self.promises.permit();
        }
        self.observe(&Vec::new());
        reply
    }

    pub(super) fn send(&mut self, frame: SampleFrame<N>) -> usize {
        let replies = self.board.send(&HostMessage::Sample(frame));
        self.observe(&replies);
        replies.len()
    }

    /// One period of host, line and timer.
    pub(super) fn period(&mut self, timing: Timing) {
        self.next += 1;
        let random = self.random();
        let count = timing.arriving(self.next - self.arrives, random);
        for _ in 0..count {
            let frame = SampleFrame::new(&slow(self.arrives)).in_period(self.arrives as u8);
            self.arrives += 1;
            self.next = self.next.max(self.arrives);
            self.send(frame);
        }
        self.timer();
    }

    /// A period in which the host sends nothing.
    pub(super) fn silence(&mut self) {
        self.next += 1;
        self.arrives = self.next;
        self.timer();
    }
}

/// A motion slow enough for a joint at any number of samples at once.
pub(super) fn slow(k: u32) -> JointSample<N> {
    let t = k as f32 * 1e-3;
    let q = JointVector::from_fn(|j, _| (t + j as f32).sin());
    let mut sample = sample(0);
    sample.desired.q = q;
    sample.measured.as_mut().unwrap().q = q;
    sample
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_numbers_make_a_sample_cost_many_ticks(
        frames in prop::collection::vec((any::<u16>(), any::<u8>()), 1..60),
    ) {
        let mut board = Board::new();
        for (sequence, flags) in frames {
            let mut sample = SampleFrame::new(&sample(0));
            sample.flags = SampleFlags(flags);
            let before = board.statistics().ticks;
            board.receive(&frame(sequence, &HostMessage::Sample(sample)));
            let ran = board.statistics().ticks - before;
            prop_assert!(ran <= MAX_BRIDGED as u32 + 2, "{} ticks", ran);
            prop_assert!(board.mailboxes.learner.waiting() <= MAX_BRIDGED + 2);
            board.learn();
        }
    }
}
