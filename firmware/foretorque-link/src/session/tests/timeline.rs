//! A board with its timer and a host on one clock.

use super::*;
use crate::safety::promises::{Promises, Timing};

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
        board.acknowledged(HostMessage::Configure(Configuration {
            pacing,
            brake_close_ms,
            ..Configuration::default()
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
        self.board
            .session
            .torque_output()
            .iter()
            .map(|t| t.abs())
            .sum()
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
        let checked = self
            .promises
            .check(&torque, enabled, session.safety(), used);
        assert_eq!(
            checked,
            Ok(()),
            "sample {}, {}",
            self.next,
            session.safety()
        );
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
