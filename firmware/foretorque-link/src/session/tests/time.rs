//! The board's timer beside the samples, as on silicon: the promises of docs/safety.md in both pacings.

use super::*;
use crate::safety::promises::{Promises, Timing};
use proptest::prelude::RngExt as _;
use proptest::test_runner::{RngAlgorithm, TestRng};

const PACINGS: [Pacing; 2] = [Pacing::Link, Pacing::SysTick];

/// A board, its timer, a host that sends one sample a period, and the line between them.
struct Timeline {
    board: Board,
    promises: Promises<N>,
    /// Number of the sample of the next period, and of the first that has not arrived.
    next: u32,
    arrives: u32,
    random: TestRng,
}

impl Timeline {
    fn new(pacing: Pacing) -> Self {
        Self::braked(pacing, 0)
    }

    fn braked(pacing: Pacing, brake_close_ms: u16) -> Self {
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
            random: TestRng::deterministic_rng(RngAlgorithm::XorShift),
        };
        timeline.timer();
        timeline
    }

    fn armed(pacing: Pacing) -> Self {
        let mut timeline = Self::new(pacing);
        (0..ARM_SAMPLES).for_each(|_| timeline.period(Timing::Exact));
        timeline.request(HostMessage::Arm);
        (0..50).for_each(|_| timeline.period(Timing::Exact));
        assert!(timeline.torque() > 20.0, "{pacing:?}");
        timeline
    }

    fn torque(&self) -> f32 {
        self.board.session.torque_output().abs().sum()
    }

    fn state(&self) -> SafetyState {
        self.board.session.safety().state
    }

    fn observe(&mut self, replies: &Replies) {
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

    fn timer(&mut self) -> usize {
        self.promises.period();
        let replies = self.board.timer();
        self.observe(&replies);
        replies.len()
    }

    fn request(&mut self, message: HostMessage<N>) -> BoardMessage<N> {
        let arms = message == HostMessage::Arm;
        if message == HostMessage::Stop {
            self.promises.stop();
        }
        let reply = self.board.request(message);
        if arms && reply == ACK {
            self.promises.permit();
        }
        self.observe(&Vec::new());
        reply
    }

    fn send(&mut self, frame: SampleFrame<N>) -> usize {
        let replies = self.board.send(&HostMessage::Sample(frame));
        self.observe(&replies);
        replies.len()
    }

    /// One period of host, line and timer.
    fn period(&mut self, timing: Timing) {
        self.next += 1;
        let count = timing.arriving(self.next - self.arrives, self.random.random());
        for _ in 0..count {
            let frame = SampleFrame::new(&slow(self.arrives)).in_period(self.arrives as u8);
            self.arrives += 1;
            self.next = self.next.max(self.arrives);
            self.send(frame);
        }
        self.timer();
    }

    /// A period in which the host sends nothing.
    fn silence(&mut self) {
        self.next += 1;
        self.arrives = self.next;
        self.timer();
    }
}

/// A motion slow enough for a joint at any number of samples at once.
fn slow(k: u32) -> JointSample<N> {
    let t = k as f32 * 1e-3;
    let q = JointVector::from_fn(|j, _| (t + j as f32).sin());
    let mut sample = sample(0);
    sample.desired.q = q;
    sample.measured.as_mut().unwrap().q = q;
    sample
}

#[test]
fn every_promise_holds_at_every_timing_in_both_pacings() {
    let all = PACINGS.map(|p| [0, 25].map(|brake| Timing::ALL.map(|t| (p, brake, t))));
    for &(pacing, brake, timing) in all.as_flattened().as_flattened() {
        let mut torques = 0;
        let mut timeline = Timeline::braked(pacing, brake);
        let mut gap = 0;
        for k in 0..3000_u32 {
            if gap > 0 {
                gap -= 1;
                timeline.silence();
            } else {
                timeline.period(timing);
            }
            let random: u32 = timeline.random.random();
            if timing == Timing::Silence && random.is_multiple_of(97) {
                gap = random / 97 % 150;
            }
            match timeline.state() {
                SafetyState::Disarmed if k % 5 == 0 => _ = timeline.request(HostMessage::Arm),
                SafetyState::Fault if k % 5 == 0 => _ = timeline.request(HostMessage::ClearFault),
                SafetyState::Armed if random % 1009 == 1 => _ = timeline.request(HostMessage::Stop),
                SafetyState::Armed if random % 499 == 2 => {
                    _ = timeline.request(HostMessage::Disarm)
                }
                _ => {}
            }
            torques += u32::from(timeline.torque() > 10.0);
        }
        assert!(torques > 500, "{pacing:?}, {timing:?}: {torques} torques");
    }
}

/// One hold time for both pacings.
#[test]
fn m1_a_silent_host_loses_its_torque_equally_fast_in_both_pacings() {
    for pacing in PACINGS {
        let mut timeline = Timeline::armed(pacing);
        let full = timeline.torque();
        let [mut falls, mut ends, mut leaves] = [0; 3];
        for k in 1..=60 {
            timeline.silence();
            let torque = timeline.torque();
            let first = |place: &mut u32, now: bool| {
                if now && *place == 0 {
                    *place = k;
                }
            };
            first(&mut falls, torque < full);
            first(&mut ends, torque == 0.0);
            first(&mut leaves, timeline.state() != SafetyState::Armed);
        }
        // The page gives 10, 30 at most, and 50 ms.
        let context = format!("{pacing:?}: {falls}, {ends}, {leaves} ms");
        assert!((11..=12).contains(&falls), "{context}");
        assert!(ends > falls && ends <= 33, "{context}");
        assert!((50..=51).contains(&leaves), "{context}");
    }
}

/// A task that takes too long costs the timer periods, and not the samples their age.
#[test]
fn periods_that_the_board_misses_count_for_the_time_out() {
    for pacing in PACINGS {
        let mut timeline = Timeline::armed(pacing);
        let misses = |timeline: &mut Timeline| {
            let tick = |timeline: &Timeline| timeline.board.session.feed_forward().state().tick;
            let before = tick(timeline);
            (0..4).for_each(|_| timeline.promises.period());
            timeline.board.session.note_missed(4);
            timeline.silence();
            // The learner sees the gap where these would have been ticks.
            let passed = tick(timeline) - before;
            assert_eq!(passed, if pacing == Pacing::SysTick { 5 } else { 0 });
            timeline.state() != SafetyState::Armed
        };
        let rounds = (1..60).find(|_| misses(&mut timeline)).unwrap();
        // 50 or 51 ms, in rounds of 5.
        assert!((10..=11).contains(&rounds), "{pacing:?}: {rounds}");
        assert_eq!(
            timeline.board.statistics().overruns,
            4 * rounds,
            "{pacing:?}"
        );
    }
}

/// Samples beyond their period are not fresh, and the torque of all of them is one slew step.
#[test]
fn m3_a_burst_out_of_a_buffer_is_not_played_at_line_speed() {
    for (pacing, at_once) in [(Pacing::Link, 2), (Pacing::SysTick, 0)] {
        let mut timeline = Timeline::armed(pacing);
        (0..8).for_each(|_| timeline.silence());
        let before = timeline.board.statistics().overtaken;
        timeline.promises.period();
        timeline.board.timer();
        let mut answered = 0;
        for k in 0..20 {
            answered += timeline.send(SampleFrame::new(&slow(50 + k)).in_period(k as u8));
        }
        assert_eq!(answered, at_once, "{pacing:?}");
        assert_eq!(timeline.timer(), 1, "the newest runs with the timer");
        let overtaken = timeline.board.statistics().overtaken - before;
        assert_eq!(overtaken as usize, 19 - at_once, "{pacing:?}");
        // The timer goes on when the same pacing is configured again.
        let mut timeline = Timeline::new(pacing);
        timeline.board.pace(pacing);
        let frames = (0..20).map(|k| SampleFrame::new(&slow(k)).in_period(k as u8));
        let answered: usize = frames.map(|frame| timeline.send(frame)).sum();
        assert_eq!(answered, at_once, "{pacing:?}");
    }
}

/// Commands use up numbers of frames, but no time.
#[test]
fn m10_commands_widen_no_plausibility_check() {
    for pacing in PACINGS {
        let mut timeline = Timeline::armed(pacing);
        for _ in 0..200 {
            timeline.request(HostMessage::Statistics);
        }
        let mut moved = slow(timeline.arrives);
        moved.measured.as_mut().unwrap().q[0] += 0.05;
        let frame = SampleFrame::new(&moved).in_period(timeline.arrives as u8);
        timeline.send(frame);
        timeline.timer();
        let reason = timeline.board.session.safety().reason;
        assert_eq!(reason, SafetyReason::PositionJump, "{pacing:?}");
    }
}

/// Temperatures reach every joint, whatever the numbers of frames.
#[test]
fn m11_the_temperatures_of_all_joints_arrive_between_commands() {
    for pacing in PACINGS {
        let mut timeline = Timeline::new(pacing);
        for k in 0..N as u8 {
            let mut frame = SampleFrame::new(&slow(0)).in_period(k);
            frame.temperature_c = 60 + k as i8;
            timeline.send(frame);
            timeline.timer();
            timeline.request(HostMessage::Statistics);
        }
        let temperatures = timeline.board.session.controller.temperatures_c;
        assert_eq!(temperatures, [60, 61, 62, 63, 64, 65], "{pacing:?}");
    }
}

#[test]
fn a_reboot_waits_for_the_end_of_the_torque() {
    let mut board = Board::with(|board| board.capabilities = Capabilities::REBOOT);
    board.arm();
    assert_eq!(board.request(HostMessage::Reboot), nack(NackReason::Armed));
    assert!(!board.session.reboot_wanted());
    board.acknowledged(HostMessage::Disarm);
    board.acknowledged(HostMessage::Reboot);
    assert!(board.session.reboot_wanted());
}

#[test]
fn a_repeated_disarm_and_another_hello_end_the_torque() {
    let mut board = Board::armed();
    let disarm = frame(board.sequence, &HostMessage::Disarm);
    assert_eq!(board.receive(&disarm), [(board.sequence, ACK)]);
    assert_eq!(board.session.safety().state, SafetyState::RampDown);
    let mut board = Board::armed();
    board.request(HostMessage::Hello);
    assert_eq!(board.session.safety().state, SafetyState::RampDown);
}

/// A joint without its gravity share is a reason, not only a flag.
#[test]
fn an_armed_board_without_its_gravity_share_latches() {
    for pacing in PACINGS {
        let mut timeline = Timeline::armed(pacing);
        let mut set = timeline.board.session.feed_forward().state().active;
        set.rigid.fill(1e30);
        let board = &mut timeline.board;
        let exchange = &mut board.mailboxes.learner.exchange;
        board.session.controller.feed_forward.load(set, exchange);
        (0..20).for_each(|_| timeline.period(Timing::Exact));
        let latched = timeline.board.session.latched_fault();
        assert_eq!(latched, SafetyReason::GravityLost, "{pacing:?}");
        assert_eq!(timeline.torque(), 0.0);
    }
}

/// Frame numbers wrap and leave out 0, period numbers wrap at 32; lost samples in between count as ever.
#[test]
fn across_the_wraps_of_sequence_and_period_the_torques_are_those_of_a_twin() {
    let run = |sequence: u16| -> Vec<[f32; N]> {
        let mut board = Board::new();
        board.sequence = sequence;
        board.arm();
        board.acknowledged(HostMessage::Learning { on: true });
        let mut torques = Vec::new();
        for k in 0..150_u8 {
            let frame = SampleFrame::new(&slow(k.into())).in_period(k + 1);
            if k % 16 == 9 || k % 31 < 2 {
                board.numbered(&HostMessage::Statistics);
                continue;
            }
            torques.push(torque(&board.request(HostMessage::Sample(frame))).total);
            board.learn();
        }
        torques
    };
    let twin = run(100);
    for sequence in [65_400, 65_440, 65_521, 65_526, 65_534] {
        assert!(run(sequence) == twin, "from frame {sequence}");
    }
}

/// Cells of the table of the page that begins with `head`.
fn rows(head: &str) -> Vec<Vec<&'static str>> {
    let page = include_str!("../../../../../docs/safety.md");
    let rows = page.split(head).nth(1).unwrap().lines().skip(2);
    let rows = rows.take_while(|row| row.starts_with('|'));
    rows.map(|row| row.split('|').map(str::trim).collect())
        .collect()
}

/// Ends the torque of a board by `event`, in both pacings: for so many periods it is kept at least, or that of gravity at
/// the measured position, and zero at last.
fn ends(event: &str, close_ms: u16, (kept, zero): (u32, u32)) {
    let mut still = slow(0);
    // More than gravity in the torque.
    still.desired.qdd.fill(3.0);
    let received = SampleFrame::new(&still).sample(&[0.0; N]);
    let q = received.measured.unwrap().q;
    for pacing in PACINGS {
        let mut board = Timeline::braked(pacing, close_ms).board;
        (0..ARM_SAMPLES).for_each(|_| _ = board.period(Some(slow(0))));
        board.acknowledged(HostMessage::Arm);
        (0..60).for_each(|_| _ = board.period(Some(still)));
        assert!(board.session.brake_released());
        let gravity = board.session.feed_forward().state().gravity::<Ur5>(&q);
        let full = *board.session.torque_output();
        let silent = ["silence", "time-out"].contains(&event);
        match event {
            "silence" | "time-out" => {}
            "`Disarm`" => board.acknowledged(HostMessage::Disarm),
            "a fault that ramps" => board.session.trip(SafetyReason::MotorHot),
            "`Stop`" => board.acknowledged(HostMessage::Stop),
            "`Drive`" => board.session.torque_off(SafetyReason::Drive),
            "`Stage`" => board.session.torque_off(SafetyReason::Stage),
            // The pins of a board in reset are low.
            "restart" | "loss of power" => return,
            other => panic!("`{other}` has no test"),
        }
        let (mut held, mut lasted, mut periods) = (0, 0, 0);
        while board.session.torque_enabled() {
            board.period((!silent).then_some(still));
            let session = &board.session;
            let torque = session.torque_output();
            held += u32::from(*torque == gravity || *torque == full);
            lasted += u32::from(*torque != JointVector::<N>::zeros());
            periods += 1;
            let ended = session.safety().state != SafetyState::Armed;
            assert_ne!(session.brake_released(), ended);
            assert!(periods < 300, "the torque never ends");
        }
        let context = format!("{pacing:?}, {event}, {close_ms} ms: {held} {lasted}");
        // On its way from the full torque it is neither: a tenth at most.
        assert!(held + kept / 10 >= kept && lasted <= zero, "{context}");
        assert_eq!(*board.session.torque_output(), JointVector::<N>::zeros());
    }
}

/// Periods of a torque that is kept for 100 ms: from the time-out of silent samples, or from another event.
const CLOSING: [(u32, u32); 2] = [(147, 165), (99, 114)];

/// Every row of the page about what holds the arm.
#[test]
fn m8_the_arm_is_held_as_long_as_the_page_has_it() {
    let rows = rows("| brake | event |");
    assert_eq!(rows.len(), 5);
    for row in rows {
        let close_ms = if row[1] == "set" { 100 } else { 0 };
        let periods = match row[3] {
            "30 ms after the last sample" => (10, 33),
            "10 ms" => (0, 11),
            "50 ms and the closing time" => CLOSING[0],
            "the closing time" => CLOSING[1],
            "0 ms" => (0, 1),
            other => panic!("`{other}` has no test"),
        };
        row[2]
            .split(", ")
            .for_each(|event| ends(event, close_ms, periods));
    }
}

/// Every row of the page about the events that end the torque, with and without a brake.
#[test]
fn m8_a_torque_ends_as_the_page_has_it_with_and_without_a_brake() {
    let rows = rows("| event | without a brake |");
    assert_eq!(rows.len(), 3);
    for (row, (close_ms, column)) in rows.iter().flat_map(|row| [(row, (0, 2)), (row, (100, 3))]) {
        let events = row[1].trim_end_matches(", from 10 ms").split(", ");
        for event in events {
            let timed_out = event == "time-out";
            let periods = match row[column] {
                "the torque falls to zero" => (10, 33),
                "the torque becomes that of gravity, by the committed set and the payload, at the last plausible position" => {
                    CLOSING[0]
                }
                // After a time-out it was zero before.
                "the torque is zero after 10 ms" => (0, if timed_out { 33 } else { 11 }),
                "the brake closes; the torque of gravity is kept for the closing time, then falls to zero in 10 ms" => {
                    CLOSING[usize::from(!timed_out)]
                }
                "torque and enable off at once"
                | "torque and enable off at once; the brake closes" => (0, 1),
                other => panic!("`{other}` has no test"),
            };
            ends(event, close_ms, periods);
        }
    }
}
