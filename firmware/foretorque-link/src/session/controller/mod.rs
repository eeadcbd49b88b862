//! Samples to torques: player, plausibility, feed-forward, safety, learning mailbox. Works on messages, never bytes.

mod parameters;

use super::{Clock, LearnerMailbox, LocalSensor, seconds};
use crate::bank::{JointBounds, NETWORK_SEED};
use crate::excitation::{ExcitationState, Player};
use crate::safety::{Safety, SafetyLimits, SafetyReason, SafetyStatus};
use crate::telemetry::CostMeter;
use crate::wire::{
    BoardMessage, Configuration, ExcitedFrame, FullTorqueFrame, Pacing, ReplyMode, SampleFlags,
    SampleFrame, TorqueFrame,
};
use foretorque::arm::Arm;
use foretorque::feedforward::{FeedForward, FeedForwardConfig, Torque};
use foretorque::joint::{JointMotion, JointSample};
use foretorque::learning::{ConfigError, MAX_BRIDGED, ParameterSet, StartDeviations};

/// Result of one tick, from which reply and telemetry are made.
pub(super) struct TickResult<const N: usize> {
    /// Sequence number of the last sample.
    pub(super) sequence: u16,
    pub(super) torque: Torque<N>,
    pub(super) status: SafetyStatus,
    /// The sample as far as it was plausible.
    pub(super) sample: Option<JointSample<N>>,
    pub(super) excitation: ExcitationState,
    /// Desired motion of the excitation, while it replaces that of the sample.
    pub(super) excited: Option<JointMotion<N>>,
    /// Counts of the board's counter.
    pub(super) cost: u32,
}

impl<const N: usize> TickResult<N> {
    pub(super) fn reply(&self, mode: ReplyMode) -> BoardMessage<N> {
        let short = || TorqueFrame::new(&self.torque, self.status);
        match (&self.excited, mode) {
            (Some(desired), _) => {
                BoardMessage::Excited(ExcitedFrame::new(short(), self.excitation, desired))
            }
            (None, ReplyMode::Decimated) => BoardMessage::Torque(short()),
            (None, ReplyMode::Full) => {
                BoardMessage::FullTorque(FullTorqueFrame::new(&self.torque, self.status))
            }
        }
    }
}

/// Counters of the ticks since boot or reset.
#[derive(Clone, Copy, Default)]
pub(super) struct TickCounters {
    /// Ticks run, with a sample or without. Wraps.
    pub(super) ticks: u32,
    /// Ticks without a sample.
    pub(super) stale: u32,
    /// Samples replaced by a newer one before the timer ran a tick.
    pub(super) overtaken: u32,
    pub(super) cost: CostMeter,
}

/// A sample of the host.
pub(super) struct Arrived<const N: usize> {
    pub(super) sequence: u16,
    pub(super) sample: SampleFrame<N>,
    /// Frames of any kind that the link had missed by then.
    pub(super) missed: u32,
}

/// State of one board's torque: parameters, player, safety, and what the ticks have seen of the samples.
pub(super) struct Controller<A: Arm<N, P>, const N: usize, const P: usize> {
    pub(super) configuration: Configuration,
    pub(super) feed_forward: FeedForward<A, N, P>,
    pub(super) safety: Safety<N>,
    pub(super) player: Player<N>,
    /// Drive gains, N × N·m/A.
    pub(super) gains: [f32; N],
    /// Limits of the bank in force.
    bounds: [JointBounds; N],
    /// Limits of the drives, N × N·m; infinite where the board has none.
    drive_limits: [f32; N],
    /// Deviations of the bank in force, from which learning starts.
    start: StartDeviations<N, P>,
    /// The newest sample that no tick has used yet.
    newest: Option<Arrived<N>>,
    /// Desired motion of the last tick's sample.
    pub(super) desired: Option<JointMotion<N>>,
    /// Samples that may still run at once where samples pace the board; the timer adds one a period. `None` before the
    /// timer's first period: then samples are all the time there is.
    credit: Option<u8>,
    /// A tick ran in this period.
    ticked: bool,
    /// Periods that the timer has missed and the sensor does not know of.
    missed: u32,
    /// The torque flowed after the last tick.
    flowed: bool,
    pub(super) gaps: SampleGaps,
    pub(super) last_sequence: u16,
    pub(super) temperatures_c: [i8; N],
    pub(super) counters: TickCounters,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Controller<A, N, P> {
    /// The feed-forward of a controller at tick 0, made apart because of its size.
    pub(super) fn first_tick() -> Result<FeedForward<A, N, P>, ConfigError> {
        let config = FeedForwardConfig::for_arm::<A, P>(seconds(&Configuration::default()));
        FeedForward::new(config, ParameterSet::nominal::<A>(NETWORK_SEED))
    }

    #[inline(always)]
    pub(super) fn new(feed_forward: FeedForward<A, N, P>, first_fault: SafetyReason) -> Self {
        let configuration = Configuration::default();
        let limits = SafetyLimits::for_arm::<A, P>(configuration.period_us);
        Self {
            configuration,
            feed_forward,
            safety: Safety::new(limits, first_fault),
            player: Player::new::<A, P>(configuration.period_us),
            gains: [0.0; N],
            bounds: JointBounds::widest::<A, N, P>(),
            drive_limits: [f32::INFINITY; N],
            start: StartDeviations::PRIOR,
            newest: None,
            desired: None,
            credit: None,
            ticked: false,
            missed: 0,
            flowed: false,
            gaps: SampleGaps::default(),
            last_sequence: 0,
            temperatures_c: [SampleFrame::<N>::NO_TEMPERATURE; N],
            counters: TickCounters::default(),
        }
    }

    /// Takes a sample: runs the tick where samples pace the board, keeps the sample for the timer otherwise, and where more
    /// samples arrive than periods pass.
    pub(super) fn sample<S: LocalSensor<N>>(
        &mut self,
        arrived: Arrived<N>,
        mailbox: &mut LearnerMailbox<N, P>,
        clock: &impl Clock,
        sensor: &mut S,
    ) -> Option<TickResult<N>> {
        let joint = usize::from(arrived.sample.flags.period()) % N;
        self.note_temperature(joint, arrived.sample.temperature_c);
        let runs = self.configuration.pacing == Pacing::Link
            && match &mut self.credit {
                None => {
                    self.safety.period();
                    true
                }
                Some(0) => false,
                Some(credit) => {
                    *credit -= 1;
                    true
                }
            };
        if runs {
            return Some(self.tick(Some(arrived), mailbox, clock, sensor));
        }
        if self.newest.replace(arrived).is_some() {
            self.counters.overtaken = self.counters.overtaken.saturating_add(1);
        }
        None
    }

    /// Takes the temperature of a motor, °C, that host or board has measured.
    pub(super) fn note_temperature(&mut self, joint: usize, celsius: i8) {
        if celsius != SampleFrame::<N>::NO_TEMPERATURE
            && let Some(slot) = self.temperatures_c.get_mut(joint)
        {
            *slot = celsius;
        }
        self.safety.note_temperature(joint, celsius);
    }

    /// One period of the board's timer: the tick on the newest sample where the timer paces the board. Where samples pace
    /// it, the tick on a sample that came too early, or the supervision of silence.
    pub(super) fn timer<S: LocalSensor<N>>(
        &mut self,
        mailbox: &mut LearnerMailbox<N, P>,
        clock: &impl Clock,
        sensor: &mut S,
    ) -> Option<TickResult<N>> {
        self.safety.period();
        let paced = self.configuration.pacing == Pacing::SysTick;
        let sample = self.newest.take();
        if paced && sample.is_none() {
            self.counters.stale = self.counters.stale.saturating_add(1);
        }
        sensor.miss(core::mem::take(&mut self.missed));
        if paced || sample.is_some() {
            let tick = self.tick(sample, mailbox, clock, sensor);
            // Without samples at once this was the tick of the period that has ended, and not of the next.
            self.ticked &= S::SAMPLES_AT_ONCE > 0;
            return Some(tick);
        }
        let credit = self.credit.unwrap_or(S::SAMPLES_AT_ONCE);
        self.credit = Some(S::SAMPLES_AT_ONCE.min(credit + 1));
        self.safety.supervise();
        let ticked = core::mem::take(&mut self.ticked);
        if !ticked {
            sensor.silence();
        }
        if !self.safety.at_rest() {
            let mut wanted = *self.safety.output();
            if !ticked {
                let torque = self.feed_forward.pause();
                let state = self.feed_forward.state();
                wanted = self.safety.with_brakes::<A, P>(&torque, state);
            }
            self.safety.release(&wanted);
        }
        self.feed_forward
            .applied_within_limits(self.safety.output());
        None
    }

    /// Takes periods of the timer in which nothing ran: the input ages, a torque without samples is held less long, and the
    /// learner sees a gap where these were ticks.
    pub(super) fn miss(&mut self, periods: u32) {
        self.safety.miss(periods);
        self.feed_forward.miss(periods);
        self.missed = self.missed.saturating_add(periods);
        if self.configuration.pacing == Pacing::SysTick {
            self.feed_forward.skip(periods);
        }
    }

    /// Runs the ticks whose samples were lost, as a timer would have: for the learner they are ticks without a
    /// measurement. The torque continues from its present value; its reaction to silence is the timer's task.
    ///
    /// Cost: one tick without a sample for each lost one, [`MAX_FILLED`] at most.
    #[inline(never)]
    fn fill_lost_ticks(&mut self, lost: u32, mailbox: &mut LearnerMailbox<N, P>) {
        for _ in 0..lost {
            self.feed_forward.adopt(&mut mailbox.exchange);
            self.feed_forward.step_stale();
            mailbox.post(self.feed_forward.learning_sample(None));
            self.counters.ticks = self.counters.ticks.wrapping_add(1);
            self.counters.stale = self.counters.stale.saturating_add(1);
        }
        self.feed_forward
            .applied_within_limits(self.safety.output());
    }

    /// One tick. Its deadline is the period.
    fn tick<S: LocalSensor<N>>(
        &mut self,
        arrived: Option<Arrived<N>>,
        mailbox: &mut LearnerMailbox<N, P>,
        clock: &impl Clock,
        sensor: &mut S,
    ) -> TickResult<N> {
        let mut periods = 1;
        if let Some(arrived) = &arrived {
            self.last_sequence = arrived.sequence;
            let gap = self.gaps.take(arrived.sample.flags, arrived.missed);
            let paced = self.configuration.pacing == Pacing::SysTick;
            periods = match paced || self.credit.is_some() {
                true => gap.counted,
                false => gap.most,
            };
            if !paced {
                self.ticked = true;
                self.fill_lost_ticks(gap.lost, mailbox);
            }
        }
        self.feed_forward.adopt(&mut mailbox.exchange);
        let sample = arrived.map(|arrived| arrived.sample);
        let reply_waits =
            sample.is_some_and(|frame| frame.flags.contains(SampleFlags::AFTER_LEARNING));
        let mut sample = sample.map(|frame| frame.sample(&self.gains));
        let sensor_fault = sensor.measure(&mut sample, self.safety.at_rest());
        if sensor_fault != SafetyReason::None
            && let Some(sample) = &mut sample
        {
            sample.measured = None;
        }
        if self.flowed && !self.safety.brake_released() {
            self.flowed = false;
            self.stop_motion();
        }
        let held = sensor.holds();
        if held && self.safety.at_rest() {
            // A motion that waits for drives does not wait for the next arming.
            self.stop_motion();
        }
        let excited = self.player.step(sample.as_ref().filter(|_| !held));
        if let (Some(sample), Some(desired)) = (&mut sample, excited) {
            sample.desired = desired;
        }
        let sample = self.safety.admit(sample, periods, sensor_fault);
        if held {
            self.safety.hold();
        }
        self.desired = sample.map(|sample| sample.desired);
        let start = clock.now();
        let torque = self.safety.step(&mut self.feed_forward, sample.as_ref());
        self.flowed |= self.safety.brake_released();
        let cost = clock.now().wrapping_sub(start);
        self.counters.cost.note(cost);
        self.counters.ticks = self.counters.ticks.wrapping_add(1);
        let measured = sample.and_then(|sample| sample.measured);
        mailbox.post(self.feed_forward.learning_sample(measured));
        if reply_waits {
            mailbox.held = true;
        }
        TickResult {
            sequence: self.last_sequence,
            torque,
            status: self.safety.status(),
            sample,
            excitation: self.player.state(),
            excited,
            cost,
        }
    }
}

/// Largest number of ticks that are filled in: after as many without a measurement the learner's window is empty, so a
/// longer gap has no other effect. It also bounds the time of a tick, whatever the host sends.
const MAX_FILLED: u32 = MAX_BRIDGED as u32 + 1;

/// Gap before a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Gap {
    /// Periods without a sample, [`MAX_FILLED`] for more.
    lost: u32,
    /// Periods since the sample before by the host's numbers.
    counted: u32,
    /// The most that they can be as far as numbers show, for a board without a clock.
    most: u32,
}

impl Gap {
    const NONE: Self = Self {
        lost: 0,
        counted: 1,
        most: 1,
    };
}

/// Gaps in the host's numbers of its periods, where samples pace the board and no tick runs without one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SampleGaps {
    /// Number of the last sample; nothing was lost before the first.
    last: Option<u8>,
    /// The link's count of missed frames at that sample.
    missed: u32,
    /// The number of periods since then is unknown.
    interrupted: bool,
}

impl SampleGaps {
    /// Another host may be sending now.
    pub(super) fn interrupt(&mut self) {
        self.interrupted = true;
    }

    /// Takes the number of a sample; returns the gap before it.
    ///
    /// The link's sequence numbers would not do: a lost command is no lost sample, and a host that sends nothing in a
    /// period leaves out none of them.
    ///
    /// * `missed` frames of any kind that the link has missed so far
    fn take(&mut self, flags: SampleFlags, missed: u32) -> Gap {
        let number = flags.period();
        let newly_missed = missed.wrapping_sub(core::mem::replace(&mut self.missed, missed));
        let interrupted = core::mem::take(&mut self.interrupted);
        let Some(last) = self.last.replace(number) else {
            return Gap::NONE;
        };
        let ahead = u32::from(number.wrapping_sub(last) % SampleFlags::PERIODS);
        // As many frames may hide a whole round of the numbers.
        let hidden_round = newly_missed >= u32::from(SampleFlags::PERIODS) - 1;
        let lost = match interrupted || hidden_round {
            true => MAX_FILLED,
            false => ahead.saturating_sub(1).min(MAX_FILLED),
        };
        let most = match (interrupted, hidden_round || ahead == 0) {
            (true, _) => u32::MAX,
            (false, true) => newly_missed.saturating_add(1),
            (false, false) => ahead,
        };
        Gap {
            lost,
            counted: if interrupted { 1 } else { ahead },
            most,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The number of the period is in the upper five bits.
    fn flags(period: u8) -> SampleFlags {
        SampleFlags(period << 3)
    }

    fn lost(samples: &[(u8, u32)]) -> Vec<u32> {
        let mut gaps = SampleGaps::default();
        let lost = |&(period, missed)| gaps.take(flags(period), missed).lost;
        samples.iter().map(lost).collect()
    }

    #[test]
    fn periods_left_out_are_lost_samples_and_long_gaps_count_as_the_largest() {
        assert_eq!(lost(&[(7, 0), (8, 0), (10, 1), (13, 1)]), [0, 0, 1, 2]);
        assert_eq!(lost(&[(30, 0), (31, 0), (32, 0), (34, 1)]), [0, 0, 0, 1]);
        // Lost commands, and a host that does not count.
        assert_eq!(lost(&[(1, 0), (2, 30), (3, 33)]), [0, 0, 0]);
        assert_eq!(lost(&[(0, 0), (0, 1), (0, 9)]), [0, 0, 0]);
        assert_eq!(lost(&[(1, 0), (8, 6), (7, 6)]), [0, MAX_FILLED, MAX_FILLED]);
        assert_eq!(lost(&[(1, 0), (2, 31), (3, 31)]), [0, MAX_FILLED, 0]);
        assert_eq!(lost(&[(1, 0), (2, u32::MAX)]), [0, MAX_FILLED]);
        let mut gaps = SampleGaps::default();
        gaps.interrupt();
        assert_eq!(gaps.take(flags(1), 0).lost, 0, "there was nothing before");
        gaps.interrupt();
        assert_eq!(gaps.take(flags(2), 0).lost, MAX_FILLED);
        assert_eq!(gaps.take(flags(3), 0).lost, 0);
    }

    #[test]
    fn periods_are_those_of_the_samples_own_numbers() {
        let mut gaps = SampleGaps::default();
        let mut take = |period, missed| {
            let gap = gaps.take(flags(period), missed);
            (gap.counted, gap.most)
        };
        let counted = [take(1, 0), take(2, 30), take(5, 32)];
        assert_eq!(counted, [(1, 1), (1, 1), (3, 3)]);
        // A host that does not count, and more missed frames than its numbers can show.
        let counted = [take(5, 32), take(5, 34), take(6, 70)];
        assert_eq!(counted, [(0, 1), (0, 3), (1, 37)]);
        gaps.interrupt();
        let gap = gaps.take(flags(9), 70);
        assert_eq!((gap.counted, gap.most), (1, u32::MAX));
    }
}
