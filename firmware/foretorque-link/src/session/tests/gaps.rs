//! A lost sample on a board that samples pace, against the tick without a sample of a board that its timer paces.

use super::*;
use crate::wire::SampleFlags;
use foretorque::feedforward::Torque;
use foretorque::learning::{Exchange, MAX_BRIDGED, TAPS};
use proptest::prelude::*;

/// The ticks of an armed board that its timer paces, made of its parts without link and session.
struct Timed {
    safety: Safety<N>,
    feed_forward: FeedForward<Ur5, N, P>,
    learner: Box<Learner<Ur5, N, P>>,
    exchange: Exchange<N, P>,
}

impl Timed {
    fn armed() -> Self {
        let set = ParameterSet::nominal::<Ur5>(NETWORK_SEED);
        let config = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
        let limits = SafetyLimits::for_arm::<Ur5, P>(1000);
        let mut timed = Self {
            safety: Safety::new(limits, SafetyReason::None),
            feed_forward: FeedForward::new(config, set).unwrap(),
            learner: Box::new(Learner::new(LearnerConfig::for_arm::<Ur5>(1e-3), set).unwrap()),
            exchange: Exchange::new(),
        };
        for _ in 0..ARM_SAMPLES {
            timed.tick(Some(0));
        }
        timed.safety.arm().unwrap();
        timed.feed_forward.set_learning(true);
        timed
    }

    fn tick(&mut self, sample: Option<u32>) -> Torque<N> {
        let sample = sample.map(|k| SampleFrame::new(&swinging(k)).sample(&[0.0; N]));
        self.feed_forward.adopt(&mut self.exchange);
        self.safety.period();
        let sample = self.safety.admit(sample, 1, SafetyReason::None);
        let torque = self.safety.step(&mut self.feed_forward, sample.as_ref());
        let measured = sample.and_then(|sample| sample.measured);
        let learning_sample = self.feed_forward.learning_sample(measured);
        self.learner.learn(&learning_sample, &mut self.exchange);
        torque
    }
}

/// A board that samples pace, and a host that numbers its periods.
struct Linked {
    board: Board,
    period: u8,
}

impl Linked {
    fn armed() -> Self {
        let mut linked = Self {
            board: Board::new(),
            period: 0,
        };
        for _ in 0..ARM_SAMPLES {
            linked.sample(0);
        }
        linked.board.acknowledged(HostMessage::Arm);
        linked
            .board
            .acknowledged(HostMessage::Learning { on: true });
        linked
    }

    fn sample(&mut self, k: u32) -> TorqueFrame<N> {
        let frame = SampleFrame::new(&swinging(k)).in_period(self.period);
        self.period = self.period.wrapping_add(1);
        let reply = self.board.request(HostMessage::Sample(frame));
        self.board.learn();
        torque(&reply)
    }

    /// Samples `first` to `last - 1`; how many rows the learner has accepted in them.
    fn accepted(&mut self, samples: core::ops::Range<u32>) -> u32 {
        let before = self.board.learner.state().statistics.accepted;
        samples.for_each(|k| _ = self.sample(k));
        self.board.learner.state().statistics.accepted - before
    }

    /// A sample that does not arrive.
    fn lose(&mut self) {
        self.period = self.period.wrapping_add(1);
        self.board.sequence += 1;
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
fn together(lost: &[u32]) -> (Timed, Linked, bool) {
    let (mut timed, mut linked) = (Timed::armed(), Linked::armed());
    let mut same = true;
    for k in 0..600 {
        if lost.contains(&k) {
            timed.tick(None);
            linked.lose();
            continue;
        }
        let expected = timed.tick(Some(k));
        let given = linked.sample(k);
        same &= (given.tick, given.flags) == (expected.tick, expected.flags.0)
            && JointVector::from(given.total) == expected.total;
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
    assert!(timed.learner.state() == linked.board.learner.state());
    let seen = timed.learner.state().statistics;
    assert!(seen.accepted > 100 && seen.incomplete > 50, "{seen:?}");
    let stale = linked.board.statistics().stale_ticks;
    assert_eq!(stale, lost.len() as u32);
}

#[test]
fn a_gap_that_cannot_be_bridged_empties_the_window_on_both() {
    // The set of a round that closes in such a gap can be a round late, so the torques may differ; the learners do not.
    for first in 200..206 {
        let lost: Vec<u32> = (first..=first + MAX_BRIDGED as u32).collect();
        let (timed, linked, _) = together(&lost);
        assert!(timed.learner.state() == linked.board.learner.state());
    }
    let mut linked = Linked::armed();
    assert!(linked.accepted(0..200) > 0);
    (0..20).for_each(|_| linked.lose());
    assert_eq!(linked.accepted(220..219 + TAPS as u32), 0);
}

#[test]
fn a_lost_command_costs_no_learning_sample() {
    let (mut whole, mut commanded) = (Linked::armed(), Linked::armed());
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
    let mut linked = Linked::armed();
    assert!(linked.accepted(0..100) > 0);
    linked.board.request(HostMessage::Hello);
    assert_eq!(linked.accepted(100..99 + TAPS as u32), 0);
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
