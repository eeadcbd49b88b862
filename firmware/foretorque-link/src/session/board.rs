use crate::bank::name;
use crate::safety::{SafetyReason, SafetyStatus};
use crate::wire::size::LinkCapacity;
use crate::wire::{
    BoardHello, Capabilities, ChipStatus, Configuration, CounterKind, ImageStatus, MAC_BYTES,
    NackReason, ResetReason,
};
use crate::write_key::WriteKey;
use foretorque::arm::Arm;
use foretorque::joint::JointSample;

/// Least time between two saves, µs: a store lasts for more than a year of them.
pub(super) const SAVE_INTERVAL_US: u32 = 60_000_000;

/// Counter of the board in which costs are given. A type and not a function pointer, so that the linked firmware shows
/// what a tick calls.
pub trait Clock {
    /// The free-running count: all 32 bits count, and it wraps.
    fn now(&self) -> u32;
}

/// A board without a counter: every cost is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoClock;

impl Clock for NoClock {
    fn now(&self) -> u32 {
        0
    }
}

/// Sensor of the board's own joints, whose measurements replace those of the sample.
pub trait LocalSensor<const N: usize> {
    /// Writes the measurements into the sample. Called once in every tick, with the sample if one arrived. A sensor that
    /// also has the desired motion may make a sample where none arrived.
    ///
    /// * `at_rest` no torque flows
    ///
    /// Returns [`SafetyReason::None`], or why there is no position: then nothing of this sample counts as measured, and
    /// the sample is implausible for that reason.
    fn measure(&mut self, sample: &mut Option<JointSample<N>>, at_rest: bool) -> SafetyReason;

    /// Samples that may run in one period of the timer where samples pace the board: that of the period, and one that came
    /// early or late. The tick's slew limit is half of the hard one, so two sound ticks in a period are within that. With
    /// 0 every sample waits for the timer, for drives that take one command in a period.
    const SAMPLES_AT_ONCE: u8 = 2;

    /// Called once in every period without a tick, where samples pace the board and none has come.
    #[inline(always)]
    fn silence(&mut self) {}

    /// Takes periods in which neither [`measure`](Self::measure) nor [`silence`](Self::silence) was called.
    #[inline(always)]
    fn miss(&mut self, _: u32) {}

    /// True while torque has to wait for the drives, although the samples are sound.
    #[inline(always)]
    fn holds(&self) -> bool {
        false
    }

    /// False while a drive may still be on: nothing that stalls or restarts the processor may run then.
    #[inline(always)]
    fn is_off(&self) -> bool {
        true
    }
}

/// A board without a sensor: the host measures every joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoLocalSensor;

impl<const N: usize> LocalSensor<N> for NoLocalSensor {
    #[inline(always)]
    fn measure(&mut self, _: &mut Option<JointSample<N>>, _: bool) -> SafetyReason {
        SafetyReason::None
    }
}

/// Identity, capabilities and start-up facts of a board.
#[derive(Clone, Copy, Debug)]
pub struct BoardDescription<C = NoClock> {
    /// Version of the firmware.
    pub firmware: &'static str,
    /// Capabilities without the write key, which [`write_key`](Self::write_key) adds.
    pub capabilities: Capabilities,
    /// Unit of the cost counter.
    pub counter: CounterKind,
    /// Counts per second.
    pub counter_hz: u32,
    /// The cost counter.
    pub clock: C,
    /// Cause of the last start.
    pub reset_reason: ResetReason,
    /// The fault that was latched before the start, where the board keeps it.
    pub kept_fault: SafetyReason,
    /// Capacity of its link.
    pub link: LinkCapacity,
    /// The write key, if there is one.
    pub write_key: Option<WriteKey>,
    /// Seed of the challenges; differs from start to start. `None` where there was no randomness: then no challenge is given.
    pub seed: Option<[u8; MAC_BYTES]>,
    /// Clock, option bytes and program.
    pub chip: ChipStatus,
}

impl<C> BoardDescription<C> {
    /// A board that learns, without timer, counter rate, store or key; with [`NoClock`] the one in the host's process.
    pub const fn plain(clock: C) -> Self {
        Self {
            firmware: env!("CARGO_PKG_VERSION"),
            capabilities: Capabilities::LEARNING,
            counter: CounterKind::None,
            counter_hz: 0,
            clock,
            reset_reason: ResetReason::Unknown,
            kept_fault: SafetyReason::None,
            link: LinkCapacity::UNLIMITED,
            write_key: None,
            seed: Some([0; MAC_BYTES]),
            chip: ChipStatus::VIRTUAL,
        }
    }

    /// The fault at the start. A firmware that restarted itself cannot be armed before the host clears it.
    pub(super) fn first_fault(&self) -> SafetyReason {
        use ResetReason::{Fault, Panic, Watchdog};
        if self.chip.image == ImageStatus::Damaged {
            return SafetyReason::Image;
        }
        match (self.kept_fault, self.reset_reason) {
            (SafetyReason::None, Watchdog | Panic | Fault) => SafetyReason::Restarted,
            (kept, _) => kept,
        }
    }

    /// Errors: [`NackReason::Period`] where the clock of the board is too slow for this period, µs.
    pub(super) fn sustains(&self, period_us: u32) -> Result<(), NackReason> {
        let long = period_us >= self.chip.shortest_period_us;
        long.then_some(()).ok_or(NackReason::Period)
    }

    /// Errors: the program is damaged; only another one mends that.
    pub(super) fn sound(&self) -> Result<(), NackReason> {
        match self.chip.image {
            ImageStatus::Damaged => Err(NackReason::Unsafe(SafetyReason::Image)),
            ImageStatus::Unsealed | ImageStatus::Sound => Ok(()),
        }
    }

    /// Errors: [`NackReason::NotCapable`].
    pub(super) fn require(&self, capability: Capabilities) -> Result<(), NackReason> {
        let capable = self.capabilities.contains(capability);
        capable.then_some(()).ok_or(NackReason::NotCapable)
    }

    /// Time without a save that the board counts at its start: none after a restart by the firmware or by command, so that
    /// restarts do not wear the flash out.
    pub(super) fn rested_us(&self) -> u32 {
        match self.reset_reason {
            ResetReason::Unknown | ResetReason::PowerOn | ResetReason::Pin => SAVE_INTERVAL_US,
            _ => 0,
        }
    }

    pub(super) fn hello<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        configuration: Configuration,
        safety: SafetyStatus,
        boot_counts: u32,
    ) -> BoardHello {
        let key = match self.write_key {
            Some(_) => Capabilities::WRITE_KEY,
            None => Capabilities::default(),
        };
        BoardHello {
            arm_hash: A::hash(),
            arm: name(A::name()),
            joints: N as u8,
            base_columns: A::index().count as u8,
            firmware: name(self.firmware),
            capabilities: self.capabilities | key,
            counter: self.counter,
            counter_hz: self.counter_hz,
            configuration,
            reset_reason: self.reset_reason,
            safety,
            boot_counts,
            chip: self.chip,
        }
    }
}
