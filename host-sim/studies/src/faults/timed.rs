//! Time beside the samples: the board's timer runs in its own periods, and samples come early, late, in bursts, damaged or
//! not at all. Every promise of docs/safety.md about torque and time is checked after every call of the board.

use super::Campaign;
use super::damage::{BadLine, DAMAGES, Damage};
use super::link::{CLEAN_TICKS, motion, order};
use crate::StudyError;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::learning::ConfigError;
use foretorque::limits::Flags;
use foretorque_link::safety::promises::{Broken, Promises, Timing};
use foretorque_link::safety::{SafetyLimits, SafetyReason, SafetyState};
use foretorque_link::session::{BoardDescription, NoClock, NoLocalSensor};
use foretorque_link::wire::{
    BoardMessage, Capabilities, Configuration, Decoder, FrameBuffer, HostMessage, MAX_FRAME,
    Pacing, SampleFrame, encode,
};
use foretorque_workbench::board::{Native, Transport};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// Ways in which samples arrive at other times, with their names in a report.
const TIMINGS: [(Timing, &str); 5] = [
    (Timing::Jitter, "jitter"),
    (Timing::Early, "early samples"),
    (Timing::Late, "late samples"),
    (Timing::Bursts, "bursts out of a buffer"),
    (Timing::Silence, "no samples"),
];

/// Name, times of the samples, and damage to the line: one of both is wrong.
pub(super) type TimedFault = (&'static str, Timing, Option<Damage>);

pub(super) fn timed_faults() -> impl Iterator<Item = TimedFault> {
    let timings = TIMINGS.map(|(timing, name)| (name, timing, None));
    let damages = DAMAGES.map(|(damage, name)| (name, Timing::Exact, Some(damage)));
    timings.into_iter().chain(damages)
}

/// A board with a timer, its host, and the observer of both.
struct Timeline {
    board: Native<Ur5, JOINTS, PARAMETERS>,
    promises: Promises<JOINTS>,
    listener: Decoder,
    sequence: u16,
    /// Number of the frame that may arm.
    arming: Option<u16>,
    /// Samples of the host's periods, and those that have been sent on.
    periods: u32,
    sent: u32,
    campaign: Campaign,
}

impl Timeline {
    fn new(pacing: Pacing, name: &str) -> Result<Self, ConfigError> {
        let mut description = BoardDescription::plain(NoClock);
        description.capabilities = description.capabilities | Capabilities::TIMER;
        let board = Native::described(description, NoLocalSensor)?;
        let limits = SafetyLimits::for_arm::<Ur5, PARAMETERS>(1000);
        let promises = Promises::new(limits, board.session.feed_forward().config());
        let place = match pacing {
            Pacing::Link => "native, link",
            Pacing::SysTick => "native, timer",
        };
        let mut timeline = Self {
            board,
            promises,
            listener: Decoder::new(),
            sequence: 0,
            arming: None,
            periods: 0,
            sent: 0,
            campaign: Campaign::new(name, place),
        };
        let configuration = Configuration {
            pacing,
            ..Configuration::default()
        };
        for message in [
            HostMessage::Configure(configuration),
            HostMessage::Learning { on: true },
        ] {
            let frame = timeline.frame(&message);
            timeline.deliver(&frame);
        }
        Ok(timeline)
    }

    fn frame(&mut self, message: &HostMessage<JOINTS>) -> Vec<u8> {
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        if *message == HostMessage::Arm {
            self.arming = Some(self.sequence);
        }
        let mut buffer = [0; MAX_FRAME];
        let bytes = encode(self.sequence, message, &mut buffer);
        bytes.unwrap_or_default().to_vec()
    }

    fn state(&self) -> SafetyState {
        self.board.session.safety().state
    }

    /// Frame of the next sample that has not been sent on.
    fn sample(&mut self) -> Vec<u8> {
        let frame = SampleFrame::new(&motion(self.sent)).in_period(self.sent as u8);
        self.sent += 1;
        self.periods = self.periods.max(self.sent);
        self.frame(&HostMessage::Sample(frame))
    }

    /// Frame of the order that the host gives in this period.
    fn command(&mut self) -> Option<Vec<u8>> {
        let message = order(self.periods, self.state())?;
        Some(self.frame(&message))
    }

    fn deliver(&mut self, bytes: &[u8]) {
        // Frame by frame, as the board acts on them.
        for piece in bytes.split_inclusive(|&byte| byte == 0) {
            let _ = self.board.send(piece);
            self.observe();
        }
    }

    fn timer(&mut self) {
        self.promises.period();
        self.board.timer();
        self.observe();
    }

    /// Checks the board after a call of it.
    fn observe(&mut self) {
        let mut buffer = [0; FrameBuffer::CAPACITY];
        let count = self.board.receive(&mut buffer, Duration::ZERO).unwrap_or(0);
        let mut used = false;
        for &byte in buffer.get(..count).unwrap_or_default() {
            let Some(Ok(frame)) = self.listener.push(byte) else {
                continue;
            };
            match frame.message::<BoardMessage<JOINTS>>() {
                Ok(BoardMessage::Torque(torque)) => {
                    used |= !Flags(torque.flags).contains(Flags::STALE_SAMPLE);
                }
                Ok(BoardMessage::Ack) if self.arming == Some(frame.sequence) => {
                    self.promises.permit();
                }
                _ => {}
            }
        }
        let session = &self.board.session;
        let (torque, enabled) = (*session.torque_output(), session.torque_enabled());
        let status = session.safety();
        let campaign = &mut self.campaign;
        campaign.promised += u64::from(enabled);
        match self.promises.check(&torque, enabled, status, used) {
            Ok(()) => {}
            Err(Broken::Permission) => campaign.without_permission += 1,
            Err(Broken::Rearmed) => campaign.rearmed += 1,
            Err(Broken::TimeOut) => campaign.mistimed += 1,
            Err(_) => campaign.wrong_torques += 1,
        }
        if used {
            campaign.recover();
        }
    }

    /// An undamaged period.
    fn work(&mut self) {
        self.periods += 1;
        self.sent = self.sent.max(self.periods - 1);
        let mut line = self.sample();
        line.extend(self.command().unwrap_or_default());
        self.deliver(&line);
        self.timer();
    }

    /// Undamaged periods, in which the board must come back to torque; the campaign's counts.
    fn close(mut self) -> Campaign {
        for _ in 0..CLEAN_TICKS {
            self.work();
        }
        let back = self.state() == SafetyState::Armed;
        self.campaign.ended(back)
    }
}

/// `ticks` periods of a board with a timer, whose samples suffer a fault.
///
/// Errors: the first limit of the arm that cannot work.
pub(super) fn timed(
    pacing: Pacing,
    (name, timing, damage): TimedFault,
    ticks: u32,
    seed: u64,
) -> Result<Campaign, StudyError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut line = damage.map(|damage| BadLine::new(damage, ChaCha8Rng::seed_from_u64(seed)));
    let mut timeline = Timeline::new(pacing, name)?;
    let (mut silent, mut timed_out) = (0, false);
    for _ in 0..ticks {
        timeline.periods += 1;
        if timing == Timing::Silence && silent == 0 && random.random_ratio(1, 200) {
            silent = random.random_range(1..150);
        }
        let mut count = timing.arriving(timeline.periods - timeline.sent, random.random());
        if silent > 0 {
            silent -= 1;
            timeline.sent = timeline.periods;
            count = 0;
        }
        let before = line.as_ref().map_or(0, |line| line.injected);
        let samples = (0..count).map(|_| timeline.sample()).collect::<Vec<_>>();
        for frame in samples.into_iter().chain(timeline.command()) {
            let bytes = match &mut line {
                Some(line) => line.carry(&frame),
                None => frame,
            };
            timeline.deliver(&bytes);
        }
        let faults = match &line {
            Some(line) => line.injected - before,
            None => u64::from(count != 1),
        };
        timeline.campaign.inject(faults);
        timeline.timer();
        let ended = timeline.board.session.safety().reason == SafetyReason::CommandTimeout;
        timeline.campaign.timeouts += u64::from(ended && !timed_out);
        timed_out = ended;
    }
    Ok(timeline.close())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_that_ages_too_slowly_breaks_the_promise_of_the_time_out() {
        let mut timeline = Timeline::new(Pacing::Link, "slow timer").unwrap();
        for _ in 0..20 {
            timeline.work();
        }
        assert_eq!(timeline.state(), SafetyState::Armed);
        for k in 0..100 {
            // Every other period of the board's timer is missing.
            timeline.promises.period();
            if k % 2 == 0 {
                timeline.board.timer();
            }
            timeline.observe();
        }
        let campaign = timeline.campaign;
        let noticed = campaign.mistimed > 0 && campaign.wrong_torques > 0;
        assert!(noticed, "{campaign:?}");
    }
}
