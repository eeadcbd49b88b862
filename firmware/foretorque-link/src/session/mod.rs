//! The board's side of the link, without the link: bytes in, ticks run, bytes out.
//!
//! | part | task |
//! |---|---|
//! | `protocol` | bytes to messages and back: sequence numbers, transfers, telemetry |
//! | `controller` | samples to torques: player, safety, feed-forward, learning |
//! | [`Session`] | owner of both: passes messages one way, results the other |

mod board;
mod controller;
mod dispatch;
mod housekeeping;
mod mailbox;
mod protocol;

pub use board::{BoardDescription, Clock, LocalSensor, NoClock, NoLocalSensor};
pub use housekeeping::{Housekeeping, NoFlash};
pub use mailbox::{LearnerMailbox, Mailboxes, ParameterMailbox};

use crate::safety::{SafetyReason, SafetyStatus};
use crate::telemetry::{Cost, Statistics};
use crate::wire::{BoardMessage, Configuration, FrameBuffer, SampleFrame};
use controller::{Controller, TickResult};
use core::mem::MaybeUninit;
use foretorque::arm::Arm;
use foretorque::feedforward::FeedForward;
use foretorque::joint::{JointMotion, JointVector};
use foretorque::learning::ConfigError;
use protocol::{Instant, Protocol};

/// One connection of a board to a host: protocol, controller and counters.
///
/// Sans-IO: the owner passes in bytes as they arrive and afterwards sends the content of the [`FrameBuffer`]. No bytes
/// make it fail or panic.
///
/// ```
/// use foretorque::arm::ur5::Ur5;
/// use foretorque_link::session::{BoardDescription, Mailboxes, NoClock, NoLocalSensor, Session};
/// use foretorque_link::wire::{FrameBuffer, HostMessage};
/// let mut session = Session::<Ur5, 6, 40>::new(BoardDescription::plain(NoClock))?;
/// let (mut mailboxes, mut request, mut reply) = (Mailboxes::default(), FrameBuffer::new(), FrameBuffer::new());
/// request.push(1, &HostMessage::<6>::Hello)?;
/// session.receive(request.as_bytes(), &mut mailboxes, &mut reply, &mut NoLocalSensor);
/// assert_eq!(reply.as_bytes().last(), Some(&0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Session<A: Arm<N, P>, const N: usize, const P: usize, C: Clock = NoClock> {
    board: BoardDescription<C>,
    protocol: Protocol,
    controller: Controller<A, N, P>,
    boot_counts: u32,
    reboot: bool,
    /// Time since the last save by the board's timer, µs.
    rested_us: u32,
}

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// A session at tick 0 with the bank of the firmware, learning off, 1 kHz, paced by the link.
    ///
    /// Errors: the first limit of the arm that cannot work.
    pub fn new(board: BoardDescription<C>) -> Result<Self, ConfigError> {
        Ok(Self::around(board, Controller::first_tick()?))
    }

    /// Initialises a session in place; it is too large for the board's stack.
    ///
    /// Errors: the first limit of the arm that cannot work.
    #[inline(never)]
    pub fn init_in_place(
        place: &mut MaybeUninit<Self>,
        board: BoardDescription<C>,
    ) -> Result<&mut Self, ConfigError> {
        let feed_forward = Controller::first_tick()?;
        Ok(place.write(Self::around(board, feed_forward)))
    }

    #[inline(never)]
    fn around(board: BoardDescription<C>, feed_forward: FeedForward<A, N, P>) -> Self {
        let rested_us = board.rested_us();
        Self {
            controller: Controller::new(feed_forward, board.first_fault()),
            board,
            protocol: Protocol::default(),
            boot_counts: 0,
            reboot: false,
            rested_us,
        }
    }

    /// Lowers the torque limits to those of the board's drives, N × N·m, for good; before the first sample. Limits that no
    /// tick can work with latch [`SafetyReason::Drive`].
    pub fn limit_torques(&mut self, limits: [f32; N]) {
        self.controller.limit_torques(limits);
    }

    /// The torque has ended last by an emergency stop.
    pub fn stopped(&self) -> bool {
        self.controller.safety.stopped()
    }

    /// Period, pacing and reply mode; the owner sets the timer by it.
    pub fn configuration(&self) -> Configuration {
        self.controller.configuration
    }

    /// The feed-forward of the ticks.
    pub fn feed_forward(&self) -> &FeedForward<A, N, P> {
        &self.controller.feed_forward
    }

    /// Safety state, and its reason.
    pub fn safety(&self) -> SafetyStatus {
        self.controller.safety.status()
    }

    /// The enable pin of the motor stage may be on.
    pub fn torque_enabled(&self) -> bool {
        self.controller.safety.enabled()
    }

    /// A brake of the motor may be open. It closes with the end of the torque and not after it.
    pub fn brake_released(&self) -> bool {
        self.controller.safety.brake_released()
    }

    /// Torque of the last tick within the hard limits, N × N·m: the command of a board's own motor stage.
    pub fn torque_output(&self) -> &JointVector<N> {
        self.controller.safety.output()
    }

    /// The fault that has to be cleared before the board can be armed; [`SafetyReason::None`] when there is none.
    pub fn latched_fault(&self) -> SafetyReason {
        self.controller.safety.latched()
    }

    /// The fault to keep over a reset: the latched one. A damaged program is found anew at every start, and hides the fault
    /// that was kept before, which stands until the host clears it.
    pub fn kept_fault(&self) -> SafetyReason {
        match self.latched_fault() {
            SafetyReason::Image => self.board.kept_fault,
            fault => fault,
        }
    }

    /// Sets the torque to zero at once and latches a fault that the owner of the hardware has detected.
    pub fn torque_off(&mut self, fault: SafetyReason) {
        self.controller.torque_off(fault);
    }

    /// Latches a fault that the owner of the hardware has detected; the torque ramps to zero.
    pub fn trip(&mut self, fault: SafetyReason) {
        self.controller.safety.trip(fault);
    }

    /// Takes the temperature of one motor, °C, that the board has measured itself.
    pub fn note_temperature(&mut self, joint: usize, celsius: i8) {
        self.controller.note_temperature(joint, celsius);
    }

    /// Desired motion of the last tick, with that of an excitation; `None` where it had no usable sample.
    pub fn desired(&self) -> Option<&JointMotion<N>> {
        self.controller.desired.as_ref()
    }

    /// Samples arrive in time, or none have to because no torque flows: the link's part of the task check-in.
    pub fn link_alive(&self) -> bool {
        self.controller.safety.input_in_time()
    }

    /// The host has commanded a restart of the processor.
    pub fn reboot_wanted(&self) -> bool {
        self.reboot
    }

    /// Counts receive overruns of the link.
    pub fn note_overruns(&mut self, count: u32) {
        let overruns = &mut self.protocol.counters.overruns;
        *overruns = overruns.saturating_add(count);
    }

    /// Takes periods of the board's timer without a [`timer_tick`](Self::timer_tick), because a task before it took too long.
    /// They count as overruns, and the samples age by them.
    pub fn note_missed(&mut self, periods: u32) {
        self.note_overruns(periods);
        self.controller.miss(periods);
    }

    /// Counts a reply for which the link had no space.
    pub fn note_reply_lost(&mut self) {
        let lost = &mut self.protocol.counters.replies_lost;
        *lost = lost.saturating_add(1);
    }

    /// Takes the owner's measurements of the link: cost of receiving one byte, and time from the end of a frame until its
    /// reply is queued.
    pub fn note_line(&mut self, receive_cost: Cost, reply_latency: Cost) {
        let counters = &mut self.protocol.counters;
        (counters.receive_cost, counters.reply_latency) = (receive_cost, reply_latency);
    }

    /// Takes the number of watchdog feeds since boot.
    pub fn note_feeds(&mut self, feeds: u32) {
        self.protocol.counters.watchdog_feeds = feeds;
    }

    /// Takes the counts from the start of the counter to the first hello.
    pub fn note_boot(&mut self, counts: u32) {
        self.boot_counts = counts;
    }

    /// Counters since boot or reset.
    pub fn statistics(&self, mailbox: &LearnerMailbox<N, P>) -> Statistics {
        let ticks = &self.controller.counters;
        let temperatures = self.controller.temperatures_c.iter().copied();
        Statistics {
            bytes_lost: self.protocol.decoder.bytes_lost(),
            overtaken: ticks.overtaken,
            stale_ticks: ticks.stale,
            ticks: ticks.ticks,
            late_sets: self.feed_forward().state().late_sets,
            learning_samples_lost: mailbox.samples_lost,
            tick_cost: ticks.cost.cost(),
            learn_cost: mailbox.learn_cost.cost(),
            hottest_c: temperatures.fold(SampleFrame::<N>::NO_TEMPERATURE, i8::max),
            implausible: self.controller.safety.implausible(),
            records_lost: self.protocol.stream.lost,
            ..self.protocol.counters
        }
    }

    /// Sends the hello unasked, as a board does after boot.
    pub fn send_hello(&mut self, out: &mut FrameBuffer) {
        let hello = self.hello();
        self.protocol.reply(0, &hello, out);
    }

    fn hello(&self) -> BoardMessage<N> {
        let safety = self.safety();
        let hello = self
            .board
            .hello::<A, N, P>(self.configuration(), safety, self.boot_counts);
        BoardMessage::Hello(hello)
    }

    /// Runs one period of the board's timer: a tick on the newest sample where the timer paces the board. Where samples
    /// pace it, silence ends the torque, and samples grow too old to arm on.
    pub fn timer_tick(
        &mut self,
        mailboxes: &mut Mailboxes<N, P>,
        out: &mut FrameBuffer,
        sensor: &mut impl LocalSensor<N>,
    ) {
        let period_us = self.configuration().period_us;
        self.rested_us = self.rested_us.saturating_add(period_us);
        let mailbox = &mut mailboxes.learner;
        let tick = self.controller.timer(mailbox, &self.board.clock, sensor);
        if let Some(tick) = tick {
            self.send_tick(&tick, mailbox, out);
        }
    }

    /// Sends the reply of a tick, then telemetry within what the link has left.
    fn send_tick(
        &mut self,
        tick: &TickResult<N>,
        mailbox: &LearnerMailbox<N, P>,
        out: &mut FrameBuffer,
    ) {
        let reply = tick.reply(self.controller.configuration.reply);
        self.protocol.reply(tick.sequence, &reply, out);
        if self.protocol.stream.due(tick.torque.tick) {
            self.protocol.stream.record(&Instant {
                tick,
                report: &self.controller.feed_forward.state().report,
                learn_cost: mailbox.learn_cost.cost().mean,
                losses: self.protocol.losses(),
                temperatures_c: &self.controller.temperatures_c,
            });
        }
        self.protocol.stream.send::<N>(out);
    }
}

fn seconds(configuration: &Configuration) -> f32 {
    configuration.period_us as f32 * 1e-6
}

#[cfg(test)]
pub(crate) mod tests;
