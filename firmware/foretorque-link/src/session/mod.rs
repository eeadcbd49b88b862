//! The board's side of the link, without the link: bytes in, ticks run, bytes out.

mod clock;
mod commands;
mod counters;
mod link;
mod local_sensor;
mod mailbox;
mod receive;
mod sample_gaps;
mod stored;
mod stream;
mod tick;
mod transfer;

pub use clock::{Clock, NoClock};
pub use local_sensor::{LocalSensor, NoLocalSensor};
pub use mailbox::LearnerMailbox;

use crate::bank::{NETWORK_SEED, ParameterBank, name};
use crate::excitation::Player;
use crate::safety::{Safety, SafetyLimits, SafetyReason, SafetyStatus};
use crate::store::StoreHealth;
use crate::telemetry::{Cost, CostMeter};
use crate::wire::{
    BoardHello, BoardMessage, Capabilities, Configuration, CounterKind, Decoder, FrameBuffer,
    MAC_BYTES, ResetReason, SampleFrame,
};
use crate::write_key::WriteKey;
use core::mem::MaybeUninit;
use foretorque::arm::Arm;
use foretorque::feedforward::{FeedForward, FeedForwardConfig};
use foretorque::joint::JointVector;
use foretorque::learning::{ConfigError, ParameterSet};
use link::LinkState;
use sample_gaps::SampleGaps;
use stream::Stream;
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
    /// The fault that was latched before it started, where the board keeps that.
    pub kept_fault: SafetyReason,
    /// Capacity of one direction of its link, bytes a second; 0 where there is no limit.
    pub link_bytes_s: u32,
    /// The write key, where it has one.
    pub write_key: Option<WriteKey>,
    /// Differs from start to start, for the challenges that a board with a write key gives.
    pub seed: [u8; MAC_BYTES],
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
            kept_fault: SafetyReason::None,
            link_bytes_s: 0,
            write_key: None,
            seed: [0; MAC_BYTES],
        }
    }

    /// The fault with which the board starts. A firmware that had to restart itself is not armed again before somebody has
    /// taken note.
    fn first_fault(&self) -> SafetyReason {
        match (self.kept_fault, self.reset_reason) {
            (
                SafetyReason::None,
                ResetReason::Watchdog | ResetReason::Panic | ResetReason::Fault,
            ) => SafetyReason::Restarted,
            (kept, _) => kept,
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
/// use foretorque_link::session::{BoardDescription, LearnerMailbox, NoClock, Session};
/// use foretorque_link::wire::{FrameBuffer, HostMessage};
/// let mut session = Session::<Ur5, _, _>::new(BoardDescription::plain(NoClock))?;
/// let (mut mailbox, mut request, mut reply) = (LearnerMailbox::new(), FrameBuffer::new(), FrameBuffer::new());
/// request.push(1, &HostMessage::<6>::Hello)?;
/// session.receive(request.as_bytes(), &mut mailbox, &mut reply);
/// assert_eq!(reply.as_bytes().last(), Some(&0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Session<A: Arm<N, P>, const N: usize, const P: usize, C: Clock = NoClock> {
    board: BoardDescription<C>,
    configuration: Configuration,
    decoder: Decoder,
    link: LinkState,
    feed_forward: FeedForward<A, N, P>,
    safety: Safety<N>,
    gains: [f32; N],
    player: Player<N>,
    bank: ParameterBank,
    /// Room for a bank on its way in, which is not believed before all of it is.
    incoming: ParameterBank,
    transfer: Transfer,
    /// The newest sample that no timer tick has used yet, with its sequence number.
    newest: Option<(u16, SampleFrame<N>)>,
    periods: SampleGaps,
    last_sequence: u16,
    temperatures_c: [i8; N],
    ticks: u32,
    tick_cost: CostMeter,
    receive_cost: Cost,
    reply_latency: Cost,
    watchdog_feeds: u32,
    store: StoreHealth,
    boot_counts: u32,
    stream: Stream,
    /// The challenge that the next signature has to be over.
    challenge: Option<[u8; MAC_BYTES]>,
    challenges: u32,
    /// What the store is to bring is only to be read.
    fetched_to_be_read: bool,
    reboot: bool,
}

impl<A: Arm<N, P>, const N: usize, const P: usize, C: Clock> Session<A, N, P, C> {
    /// A session at tick 0 with the bank of the firmware, learning off, 1 kHz, paced by the link.
    ///
    /// Errors: the first limit of the arm that cannot work.
    pub fn new(board: BoardDescription<C>) -> Result<Self, ConfigError> {
        Ok(Self::around(board, Self::first_tick()?))
    }

    /// The same in `room`, for a board: it would not fit the stack beside its copies.
    ///
    /// Errors: the first limit of the arm that cannot work.
    #[inline(never)]
    pub fn init_in_place(
        room: &mut MaybeUninit<Self>,
        board: BoardDescription<C>,
    ) -> Result<&mut Self, ConfigError> {
        let feed_forward = Self::first_tick()?;
        Ok(room.write(Self::around(board, feed_forward)))
    }

    fn first_tick() -> Result<FeedForward<A, N, P>, ConfigError> {
        let config = FeedForwardConfig::for_arm::<A, P>(seconds(&Configuration::default()));
        FeedForward::new(config, ParameterSet::nominal::<A>(NETWORK_SEED))
    }

    #[inline(never)]
    fn around(board: BoardDescription<C>, feed_forward: FeedForward<A, N, P>) -> Self {
        let configuration = Configuration::default();
        let limits = SafetyLimits::for_arm::<A, P>(seconds(&configuration));
        Self {
            safety: Safety::new(limits, board.first_fault()),
            board,
            configuration,
            decoder: Decoder::new(),
            link: LinkState::default(),
            feed_forward,
            gains: [0.0; N],
            player: Player::new::<A, P>(configuration.period_us),
            bank: ParameterBank::nominal::<A, N, P>(),
            incoming: ParameterBank::empty(),
            transfer: Transfer::new(),
            newest: None,
            periods: SampleGaps::new(),
            last_sequence: 0,
            temperatures_c: [SampleFrame::<N>::NO_TEMPERATURE; N],
            ticks: 0,
            tick_cost: CostMeter::new(),
            receive_cost: Cost::default(),
            reply_latency: Cost::default(),
            watchdog_feeds: 0,
            store: StoreHealth::Unused,
            boot_counts: 0,
            stream: Stream::new(),
            challenge: None,
            challenges: 0,
            fetched_to_be_read: false,
            reboot: false,
        }
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

    /// Whether torque leaves the board, and why not.
    pub fn safety(&self) -> SafetyStatus {
        self.safety.status()
    }

    /// The enable pin of the motor stage may be on.
    pub fn torque_enabled(&self) -> bool {
        self.safety.enabled()
    }

    /// The torque of the last tick, as it left, N × N·m: what a board with a motor stage of its own sends there.
    pub fn torque_output(&self) -> &JointVector<N> {
        self.safety.output()
    }

    /// The fault to keep over a reset; [`SafetyReason::None`] when there is none.
    pub fn latched_fault(&self) -> SafetyReason {
        self.safety.latched()
    }

    /// Latches a fault that the owner of the hardware has seen, and because of which no torque is put out any more: it is
    /// zero from now on.
    pub fn torque_off(&mut self, fault: SafetyReason) {
        self.safety.torque_off(fault);
        self.feed_forward.applied(self.safety.output());
    }

    /// Samples come, or none have to because no torque flows: what the link answers in the roll of a watchdog.
    pub fn link_alive(&self) -> bool {
        self.safety.input_in_time()
    }

    /// The host asked for the processor to start anew.
    pub fn reboot_wanted(&self) -> bool {
        self.reboot
    }

    /// Says hello unasked, as a board does after boot.
    pub fn send_hello(&mut self, out: &mut FrameBuffer) {
        self.answer(0, &BoardMessage::Hello(self.hello()), out);
    }

    fn hello(&self) -> BoardHello {
        BoardHello {
            arm_hash: A::HASH,
            arm: name(A::NAME),
            joints: N as u8,
            base_columns: P as u8,
            firmware: name(self.board.firmware),
            capabilities: match self.board.write_key {
                Some(_) => self.board.capabilities | Capabilities::WRITE_KEY,
                None => self.board.capabilities,
            },
            counter: self.board.counter,
            counter_hz: self.board.counter_hz,
            configuration: self.configuration,
            reset_reason: self.board.reset_reason,
            safety: self.safety.status(),
            boot_counts: self.boot_counts,
        }
    }
}

fn seconds(configuration: &Configuration) -> f32 {
    configuration.period_us as f32 * 1e-6
}

#[cfg(test)]
mod tests;
