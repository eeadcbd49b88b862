//! Ticks and counters; a lost sample on a board that samples pace, against the tick without a sample of a board that its
//! timer paces.

use super::*;
use crate::telemetry::Cost;
use foretorque::learning::{MAX_BRIDGED, TAPS};

#[test]
fn the_timer_runs_the_newest_sample_once_and_none_from_before_a_configuration() {
    let mut board = Board::new();
    board.pace(Pacing::SysTick);
    for k in 0..2 {
        assert!(board.send(&sample_message(k)).is_empty());
    }
    for (tick, stale) in [(0, false), (1, true)] {
        let replies = board.timer();
        let (sequence, reply) = &replies[0];
        let torque = torque(reply);
        assert_eq!((*sequence, torque.tick), (3, tick));
        assert_eq!(Flags(torque.flags).contains(Flags::NO_MEASUREMENT), stale);
    }
    let statistics = board.statistics();
    assert_eq!((statistics.overtaken, statistics.stale_ticks), (1, 1));
    assert!(board.send(&sample_message(2)).is_empty());
    board.pace(Pacing::SysTick);
    let flags = Flags(torque(&board.timer()[0].1).flags);
    assert!(flags.contains(Flags::STALE_SAMPLE));
    // Until a host that begins anew has sent a sample, no tick has a number of its own.
    board.hello();
    assert_eq!(board.timer()[0].0, 0);
}

/// Every counter counts what it is called, by one, and a reset sets all of them back.
#[test]
fn counters_count_and_a_reset_clears_them() {
    let mut board = Board::new();
    board.session.note_boot(77);
    board.pace(Pacing::SysTick);
    // The learner never runs, and its queue takes 15.
    for k in 0..20_u8 {
        let mut frame = SampleFrame::new(&sample(0)).in_period(k);
        frame.temperature_c = 60;
        board.send(&HostMessage::Sample(frame));
        board.timer();
    }
    let mut bad = sample(0);
    bad.measured.as_mut().unwrap().tau[5] = 90.0;
    for _ in 0..3 {
        board.session.note_overruns(1);
        board.session.note_reply_lost();
        board.timer();
        board.send(&HostMessage::Sample(SampleFrame::new(&bad)));
        board.timer();
        let mut damaged = board.numbered(&HostMessage::Hello);
        damaged[5] ^= 1;
        board.receive(&damaged);
        board.receive(&[1, 0]);
    }
    let repeated = frame(board.sequence - 1, &HostMessage::Statistics);
    board.receive(&repeated);
    let clock = |costs: [u32; 2]| Cost {
        mean: costs[0],
        max: costs[1],
    };
    board.session.note_line(clock([3, 4]), clock([5, 6]));
    board.session.note_feeds(9);
    board.mailboxes.learner.begin(&mut board.learner);
    board.mailboxes.learner.finish(&mut board.learner, 1000);
    let counted = board.statistics();
    let expected = Statistics {
        frames: 25,
        crc_errors: 3,
        framing_errors: 3,
        missed: 2,
        repeated: 1,
        stale_ticks: 3,
        overruns: 3,
        replies_lost: 3,
        ticks: 26,
        learning_samples_lost: 11,
        learn_cost: counted.learn_cost,
        hottest_c: 60,
        implausible: 3,
        receive_cost: clock([3, 4]),
        reply_latency: clock([5, 6]),
        watchdog_feeds: 9,
        bytes_lost: counted.bytes_lost,
        ..Board::new().statistics()
    };
    assert_eq!(counted, expected);
    assert_eq!(counted.learn_cost.max, 1000);
    assert!(counted.bytes_lost > 0);
    board.acknowledged(HostMessage::Reset);
    let cleared = Statistics {
        // What the owner counts stays.
        receive_cost: clock([3, 4]),
        reply_latency: clock([5, 6]),
        watchdog_feeds: 9,
        ..Board::new().statistics()
    };
    assert_eq!(board.statistics(), cleared);
    assert_eq!(board.hello().boot_counts, 77);
}

#[test]
fn every_constant_follows_the_period() {
    let mut board = Board::new();
    board.acknowledged(configure(|wanted| wanted.period_us = 4000));
    let bank = ParameterBank::nominal::<Ur5, N, P>();
    let wanted = bank.feed_forward_config::<Ur5, N, P>(4e-3).unwrap();
    assert_eq!(*board.session.feed_forward().config(), wanted);
    // The learner restarts too: it closes and publishes a round from its new tick 0.
    for k in 0..6 {
        board.sample(k);
        board.learn();
    }
    assert_eq!(board.learner.state().statistics.published, 1);
}

#[test]
fn torques_do_not_depend_on_the_delay_of_the_learner() {
    let run = |delay: u32| -> Vec<TorqueFrame<N>> {
        let mut board = Board::new();
        board.acknowledged(HostMessage::Learning { on: true });
        (0..400)
            .map(|k| {
                let torque = board.sample(k);
                // The last tick of a round, N - 1, is due N / 2 ticks later.
                if k % (delay + 1) == delay {
                    board.learn();
                }
                torque
            })
            .collect()
    };
    let prompt = run(0);
    assert_eq!(run(2), prompt);
    let adopted = |torque: &&TorqueFrame<N>| Flags(torque.flags).contains(Flags::SET_ADOPTED);
    assert!(prompt.iter().filter(adopted).count() > 60);
}

#[test]
fn a_set_learnt_before_a_restart_never_reaches_later_ticks() {
    let mut board = Board::new();
    board.acknowledged(HostMessage::Learning { on: true });
    for k in 0..5 {
        board.sample(k);
        board.learn();
    }
    board.sample(5);
    let sample = board.mailboxes.learner.begin(&mut board.learner).unwrap();
    board.learner.study(&sample);
    // The tick interrupts the learner here, at the end of a round.
    board.acknowledged(HostMessage::Learning { on: false });
    board.acknowledged(HostMessage::Reset);
    board.mailboxes.learner.finish(&mut board.learner, 0);
    assert_eq!(board.mailboxes.learner.exchange.published, None);
}

#[test]
fn a_sample_that_is_not_finite_gives_a_finite_torque() {
    let mut board = Board::new();
    let mut broken = sample(0);
    broken.desired.q[2] = f32::NAN;
    let reply = board.request(HostMessage::Sample(SampleFrame::new(&broken)));
    let torque = torque(&reply);
    assert!(torque.total.iter().all(|tau| tau.is_finite()));
    assert!(Flags(torque.flags).contains(Flags::NOT_FINITE));
}

/// A sample whose reply waits for the learner.
fn waiting_sample() -> HostMessage<N> {
    HostMessage::Sample(SampleFrame::new(&sample(1)).answered_after_learning())
}

#[test]
fn a_waiting_reply_is_held_until_everything_is_learnt_or_the_tick_restarts() {
    let mut board = Board::new();
    board.acknowledged(HostMessage::Learning { on: true });
    board.sample(0);
    assert!(!board.mailboxes.learner.holds_reply(), "not requested");
    board.request(waiting_sample());
    assert!(board.mailboxes.learner.holds_reply());
    // Two samples wait. A command interrupts the learner in the first one.
    for (interrupted, released) in [(true, false), (false, true)] {
        let sample = board.mailboxes.learner.begin(&mut board.learner).unwrap();
        if interrupted {
            board.request(HostMessage::Statistics);
        }
        board.learner.study(&sample);
        let mailbox = &mut board.mailboxes.learner;
        mailbox.finish(&mut board.learner, 0);
        assert_eq!(mailbox.release_reply(), released);
        assert_eq!(mailbox.holds_reply(), !released);
    }
    let mailbox = &mut board.mailboxes.learner;
    assert!(mailbox.begin(&mut board.learner).is_none());
    assert!(!mailbox.release_reply(), "it is sent once");
    board.acknowledged(HostMessage::Learning { on: false });
    board.request(waiting_sample());
    board.acknowledged(HostMessage::Reset);
    let mailbox = &mut board.mailboxes.learner;
    assert!(mailbox.begin(&mut board.learner).is_none());
    assert!(mailbox.release_reply());
}

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
    let [by_timer, by_link] = [&timed, &linked].map(|it| it.board.statistics());
    assert_eq!(by_link.stale_ticks, lost.len() as u32);
    assert_eq!(by_link.ticks, by_timer.ticks);
}

#[test]
fn a_gap_that_cannot_be_bridged_leaves_both_learners_equal() {
    // The set of a round that closes in such a gap can be a round late, so the torques may differ; the learners do not.
    for first in 200..206 {
        let lost: Vec<u32> = (first..=first + MAX_BRIDGED as u32).collect();
        let (timed, linked, _) = together(&lost);
        assert!(timed.board.learner.state() == linked.board.learner.state());
    }
}

#[test]
fn after_a_hello_or_a_gap_that_cannot_be_bridged_the_window_is_empty() {
    for (hello, after) in [(true, 200), (false, 220)] {
        let mut linked = Paced::armed(Pacing::Link);
        // The samples before the motion are copies, so the window fills twice.
        assert!(linked.accepted(0..200) > 0);
        if hello {
            linked.board.request(HostMessage::Hello);
        } else {
            (0..20).for_each(|_| linked.lose());
        }
        // The last sample before the gap serves the joints whose turn is in it.
        assert!(linked.accepted(after..after + 1) <= MAX_BRIDGED as u32);
        let full = after - 1 + FILTER;
        assert_eq!(linked.accepted(after + 1..full), 0);
        assert!(linked.accepted(full..full + 6) > 0);
    }
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
