//! The board's side of the link, without the link: bytes in, ticks run, bytes out.

mod clock;
mod commands;
mod desk;
mod link;
mod stored;
mod transfer;

pub use clock::{Clock, NoClock};
pub use desk::Desk;

use crate::arm::Arm;
use crate::edge::bank::{NETWORK_SEED, ParameterBank, name};
use crate::edge::telemetry::{Cost, CostMeter, Statistics};
use crate::edge::wire::{
    BoardHello, BoardMessage, Capabilities, Configuration, CounterKind, DecodeError, Decoder,
    ExcitedFrame, FrameBuffer, FullTorqueFrame, HostMessage, Pacing, ReplyMode, ResetReason,
    SampleFrame, TorqueFrame,
};
use crate::excitation::Player;
use crate::feedforward::{FeedForward, FeedForwardConfig, evaluate};
use crate::joint::JointMotion;
use crate::learning::{ConfigError, ParameterSet};
use link::{LinkState, Order};
use transfer::Transfer;

/// What a board knows of itself.
#[derive(Clone, Copy, Debug)]
pub struct BoardDescription<C = NoClock> {
    /// Version of the firmware.
    pub firmware: &'static str,
    /// What it can do.
    pub capabilities: Capabilities,
    /// What its cost counter counts.
    pub counter: CounterKind,
    /// Counts per second.
    pub counter_hz: u32,
    /// The counter.
    pub clock: C,
    /// Why it started.
    pub reset_reason: ResetReason,
}

impl<C> BoardDescription<C> {
    /// A board that tells no rate of its counter and has no timer; with [`NoClock`] the one in the host's own process.
    pub const fn plain(clock: C) -> Self {
        Self {
            firmware: env!("CARGO_PKG_VERSION"),
            capabilities: Capabilities::LEARNING,
            counter: CounterKind::None,
            counter_hz: 0,
            clock,
            reset_reason: ResetReason::Unknown,
        }
    }
}

/// One conversation with a host: decoder, tick, parameter bank and counters of one board.
///
/// Sans-IO: the owner passes bytes in as they come and sends what lies in the [`FrameBuffer`] afterwards. No bytes can
/// make it fail or panic.
///
/// ```
/// use foretorque::arm::ur5::Ur5;
/// use foretorque::edge::session::{BoardDescription, Desk, NoClock, Session};
/// use foretorque::edge::wire::{FrameBuffer, HostMessage};
/// let mut session = Session::<Ur5, 6, 40>::new(BoardDescription::plain(NoClock))?;
/// let (mut desk, mut request, mut reply) = (Desk::new(), FrameBuffer::new(), FrameBuffer::new());
/// request.push(1, &HostMessage::<6>::Hello)?;
/// session.receive(request.as_bytes(), &mut desk, &mut reply);
/// assert_eq!(reply.as_bytes().last(), Some(&0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Session<A: Arm<N, P>, const N: usize, const P: usize, C: Clock = NoClock> {
    board: BoardDescription<C>,
    configuration: Configuration,
    decoder: Decoder,
    link: LinkState,
    feed_forward: FeedForward<A, N, P>,
    gains: [f32; N],
    player: Player<N>,
    bank: ParameterBank,
    /// Room for a bank on its way in, which is not believed before all of it is.
    incoming: ParameterBank,
    transfer: Transfer,
    /// The newest sample that no timer tick has used yet, with its sequence number.
    newest: Option<(u16, SampleFrame<N>)>,
    last_sequence: u16,
    temperatures_c: [i8; N],
    ticks: u32,
    tick_cost: CostMeter,
    receive_cost: Cost,
}

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// A session at tick 0 with the bank of the firmware, learning off, 1 kHz, paced by the link.
    ///
    /// Errors: the first limit of the arm that cannot work.
    pub fn new(board: BoardDescription<C>) -> Result<Self, ConfigError> {
        let configuration = Configuration::default();
        let bank = ParameterBank::nominal::<A, N, P>();
        let config = FeedForwardConfig::for_arm::<A, P>(seconds(&configuration));
        Ok(Self {
            board,
            configuration,
            decoder: Decoder::new(),
            link: LinkState::default(),
            feed_forward: FeedForward::new(config, ParameterSet::nominal::<A>(NETWORK_SEED))?,
            gains: [0.0; N],
            player: Player::new::<A, P>(configuration.period_us),
            bank,
            incoming: ParameterBank::empty(),
            transfer: Transfer::new(),
            newest: None,
            last_sequence: 0,
            temperatures_c: [SampleFrame::<N>::NO_TEMPERATURE; N],
            ticks: 0,
            tick_cost: CostMeter::new(),
            receive_cost: Cost::default(),
        })
    }

    /// The bank in force, as it was loaded, with the values of the active set.
    pub fn bank(&mut self) -> &ParameterBank {
        let active = &self.feed_forward.state().active;
        self.bank.refresh::<A, N, P>(active);
        &self.bank
    }

    /// How the board shall run; its owner sets the timer by it.
    pub fn configuration(&self) -> Configuration {
        self.configuration
    }

    /// The tick inside.
    pub fn feed_forward(&self) -> &FeedForward<A, N, P> {
        &self.feed_forward
    }

    /// Last reported motor temperatures, °C; -128 where not known.
    pub fn temperatures_c(&self) -> &[i8; N] {
        &self.temperatures_c
    }

    /// Counts a missed deadline or a receive overrun of the line.
    pub fn note_overrun(&mut self) {
        self.link.overruns = self.link.overruns.saturating_add(1);
    }

    /// Counts a reply that the line had no room for.
    pub fn note_reply_lost(&mut self) {
        self.link.replies_lost = self.link.replies_lost.saturating_add(1);
    }

    /// Takes what the owner of the line measured: the cost of receiving one byte.
    pub fn note_receive_cost(&mut self, cost: Cost) {
        self.receive_cost = cost;
    }

    /// Says hello unasked, as a board does after boot.
    pub fn greet(&mut self, out: &mut FrameBuffer) {
        self.answer(0, &BoardMessage::Hello(self.hello()), out);
    }

    /// Takes bytes from the link, acts on every frame they complete and answers into `out`.
    ///
    /// Cost: a few instructions a byte; the byte that ends a sample also runs the tick where the link paces.
    pub fn receive(&mut self, bytes: &[u8], desk: &mut Desk<N, P>, out: &mut FrameBuffer) {
        for &byte in bytes {
            let received = match self.decoder.push(byte) {
                None => continue,
                Some(Ok(frame)) => frame
                    .message::<HostMessage<N>>()
                    .map(|message| (frame.sequence, message)),
                Some(Err(error)) => Err(error),
            };
            match received {
                Ok((sequence, message)) => {
                    let restart = matches!(message, HostMessage::Hello);
                    if self.link.accept(sequence, restart) == Order::Forward {
                        self.act(sequence, message, desk, out);
                    }
                }
                Err(error) => {
                    self.link.refuse(error);
                    if let DecodeError::ForeignVersion(_) = error {
                        // So that a host of another generation can say what is wrong.
                        self.greet(out);
                    }
                }
            }
        }
    }

    /// The board's timer: runs the tick on the newest sample where the timer paces, else does nothing.
    pub fn timer_tick(&mut self, desk: &mut Desk<N, P>, out: &mut FrameBuffer) {
        if self.configuration.pacing == Pacing::SysTick {
            let sample = self.newest.take();
            if let Some((sequence, _)) = sample {
                self.last_sequence = sequence;
            } else {
                self.link.stale_ticks = self.link.stale_ticks.saturating_add(1);
            }
            self.tick(sample.map(|(_, sample)| sample), desk, out);
        }
    }

    /// Counters since boot or reset.
    pub fn statistics(&self, desk: &Desk<N, P>) -> Statistics {
        Statistics {
            frames: self.link.frames,
            crc_errors: self.link.crc_errors,
            framing_errors: self.link.framing_errors,
            foreign_version: self.link.foreign_version,
            unknown: self.link.unknown,
            missed: self.link.missed,
            repeated: self.link.repeated,
            bytes_lost: self.decoder.bytes_lost(),
            overtaken: self.link.overtaken,
            stale_ticks: self.link.stale_ticks,
            overruns: self.link.overruns,
            replies_lost: self.link.replies_lost,
            ticks: self.ticks,
            late_sets: self.feed_forward.state().late_sets,
            lessons_lost: desk.lessons_lost,
            tick_cost: self.tick_cost.cost(),
            learn_cost: desk.learn_cost.cost(),
            receive_cost: self.receive_cost,
            hottest_c: self
                .temperatures_c
                .iter()
                .copied()
                .fold(SampleFrame::<N>::NO_TEMPERATURE, i8::max),
        }
    }

    fn act(
        &mut self,
        sequence: u16,
        message: HostMessage<N>,
        desk: &mut Desk<N, P>,
        out: &mut FrameBuffer,
    ) {
        let done = match message {
            HostMessage::Sample(sample) => return self.sample(sequence, sample, desk, out),
            HostMessage::Hello => {
                return self.answer(sequence, &BoardMessage::Hello(self.hello()), out);
            }
            HostMessage::Evaluate(motion) => {
                let set = &self.feed_forward.state().active;
                let torque = evaluate::<A, N, P>(set, &JointMotion::from(&motion));
                return self.answer(sequence, &BoardMessage::Evaluated((&torque).into()), out);
            }
            HostMessage::Statistics => {
                let statistics = self.statistics(desk);
                return self.answer(sequence, &BoardMessage::Statistics(statistics), out);
            }
            HostMessage::BankRead { offset } => match self.read(offset) {
                Ok(chunk) => return self.answer(sequence, &chunk, out),
                Err(reason) => Err(reason),
            },
            HostMessage::BankWrite { offset, bytes } => self
                .frozen()
                .and_then(|()| self.transfer.write(offset, &bytes)),
            HostMessage::ExcitationLoad { length, crc } => self.load_excitation(length, crc),
            HostMessage::Excitation(cue) => match self.excitation(cue) {
                Ok(stage) => return self.answer(sequence, &stage, out),
                Err(reason) => Err(reason),
            },
            HostMessage::BankCommit { length, crc } => self.commit(length, crc, desk),
            HostMessage::Configure(configuration) => self.configure(configuration, desk),
            HostMessage::Learning { on } => self.set_learning(on),
            HostMessage::Reset => self.reset(sequence, desk),
        };
        let answer = match done {
            Ok(()) => BoardMessage::Ack,
            Err(reason) => BoardMessage::Nack(reason),
        };
        self.answer(sequence, &answer, out);
    }

    fn answer(&mut self, sequence: u16, message: &BoardMessage<N>, out: &mut FrameBuffer) {
        if out.push(sequence, message).is_err() {
            self.link.replies_lost = self.link.replies_lost.saturating_add(1);
        }
    }

    fn sample(
        &mut self,
        sequence: u16,
        sample: SampleFrame<N>,
        desk: &mut Desk<N, P>,
        out: &mut FrameBuffer,
    ) {
        if let Some(slot) = self.temperatures_c.get_mut(usize::from(sequence) % N) {
            *slot = sample.temperature_c;
        }
        match self.configuration.pacing {
            Pacing::Link => {
                self.last_sequence = sequence;
                self.tick(Some(sample), desk, out);
            }
            Pacing::SysTick => {
                if self.newest.replace((sequence, sample)).is_some() {
                    self.link.overtaken = self.link.overtaken.saturating_add(1);
                }
            }
        }
    }

    fn tick(
        &mut self,
        sample: Option<SampleFrame<N>>,
        desk: &mut Desk<N, P>,
        out: &mut FrameBuffer,
    ) {
        self.feed_forward.adopt(&mut desk.exchange);
        let mut sample = sample.map(|sample| sample.sample(&self.gains));
        let excited = self.player.step(sample.as_ref());
        if let (Some(sample), Some(desired)) = (&mut sample, excited) {
            sample.desired = desired;
        }
        let start = self.board.clock.now();
        let torque = match &sample {
            Some(sample) => self.feed_forward.step(sample),
            None => self.feed_forward.step_stale(),
        };
        self.tick_cost
            .note(self.board.clock.now().wrapping_sub(start));
        self.ticks = self.ticks.wrapping_add(1);
        desk.post(
            self.feed_forward
                .lesson(sample.and_then(|sample| sample.measured)),
        );
        let reply = match (excited, self.configuration.reply) {
            (Some(desired), _) => {
                let stage = self.player.stage();
                BoardMessage::Excited(ExcitedFrame::new(&torque, stage, &desired))
            }
            (None, ReplyMode::Decimated) => BoardMessage::Torque(TorqueFrame::from(&torque)),
            (None, ReplyMode::Full) => BoardMessage::FullTorque(FullTorqueFrame::from(&torque)),
        };
        self.answer(self.last_sequence, &reply, out);
    }

    fn hello(&self) -> BoardHello {
        BoardHello {
            arm_hash: A::HASH,
            arm: name(A::NAME),
            joints: N as u8,
            base_columns: P as u8,
            firmware: name(self.board.firmware),
            capabilities: self.board.capabilities,
            counter: self.board.counter,
            counter_hz: self.board.counter_hz,
            configuration: self.configuration,
            reset_reason: self.board.reset_reason,
        }
    }
}

fn seconds(configuration: &Configuration) -> f32 {
    configuration.period_us as f32 * 1e-6
}

#[cfg(test)]
mod tests;
