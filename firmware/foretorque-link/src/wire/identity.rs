//! Identity and configuration of a board.

use super::Name;
use crate::safety::SafetyStatus;
use serde::{Deserialize, Serialize};

/// Trigger of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Pacing {
    /// A sample: it runs a tick, and the reply follows at once.
    Link,
    /// The board's timer, with the newest sample.
    SysTick,
}

/// Content of a torque reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ReplyMode {
    /// The shares of one joint a tick: [`TorqueFrame`](super::TorqueFrame).
    Decimated,
    /// All shares: [`FullTorqueFrame`](super::FullTorqueFrame).
    Full,
}

/// Configuration of the ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Configuration {
    /// Period of the tick, µs.
    #[serde(with = "postcard::fixint::le")]
    pub period_us: u32,
    /// Trigger of a tick.
    pub pacing: Pacing,
    /// Content of a torque reply.
    pub reply: ReplyMode,
    /// Time that the brakes of the arm take to close, ms; 0 without brakes. The torque of gravity is kept for it.
    #[serde(with = "postcard::fixint::le")]
    pub brake_close_ms: u16,
}

impl Configuration {
    /// Shortest and longest period, µs: 10 kHz to 50 Hz. The longest leaves two samples in the time-out of 50 ms, and three
    /// ticks in the 68 ms of the watchdog.
    pub const PERIODS_US: core::ops::RangeInclusive<u32> = 100..=20_000;
    /// Longest closing time of a brake, ms.
    pub const MAX_BRAKE_CLOSE_MS: u16 = 1000;
}

impl Default for Configuration {
    /// 1 kHz, paced by the link, decimated shares, no brakes.
    fn default() -> Self {
        Self {
            period_us: 1000,
            pacing: Pacing::Link,
            reply: ReplyMode::Decimated,
            brake_close_ms: 0,
        }
    }
}

/// Unit of the cost counter of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CounterKind {
    /// Nothing: costs are zero.
    #[default]
    None,
    /// Cycles of the core.
    Cycles,
    /// Instructions, in an emulator that counts them.
    Instructions,
}

/// Source of the processor clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ClockSource {
    /// No clock of its own: a process on a host, or the emulator.
    #[default]
    Virtual,
    /// Crystal and PLL.
    Crystal,
    /// Internal oscillator and PLL: the crystal did not start. Tick and baud rate are good to 1 % only.
    Internal,
    /// Internal oscillator alone, 16 MHz: the PLL did not lock.
    Bare,
}

/// Result of the check of the program in flash, at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImageStatus {
    /// No checksum in it: an ELF file straight from the linker.
    #[default]
    Unsealed,
    /// The checksum is right.
    Sound,
    /// The checksum is wrong: the board cannot be armed.
    Damaged,
}

/// Clock, option bytes and program of the chip, read at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ChipStatus {
    /// Source of the processor clock.
    pub clock: ClockSource,
    /// Shortest period that this clock sustains, µs.
    #[serde(with = "postcard::fixint::le")]
    pub shortest_period_us: u32,
    /// Brown-out reset: 0 off to 3, the highest voltage; [`UNKNOWN`](Self::UNKNOWN).
    pub brown_out: u8,
    /// Read-out protection: 0 none, 1, 2; [`UNKNOWN`](Self::UNKNOWN).
    pub read_out_protection: u8,
    /// Check of the program.
    pub image: ImageStatus,
}

impl ChipStatus {
    /// Code of an option byte that cannot be read.
    pub const UNKNOWN: u8 = u8::MAX;
    /// A process on a host, or the emulator.
    pub const VIRTUAL: Self = Self {
        clock: ClockSource::Virtual,
        shortest_period_us: *Configuration::PERIODS_US.start(),
        brown_out: Self::UNKNOWN,
        read_out_protection: Self::UNKNOWN,
        image: ImageStatus::Unsealed,
    };
}

/// Cause of a start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetReason {
    /// Unknown.
    #[default]
    Unknown,
    /// Power came on.
    PowerOn,
    /// The reset pin.
    Pin,
    /// A request in software.
    Software,
    /// The watchdog bit.
    Watchdog,
    /// A panic, kept over the reset.
    Panic,
    /// A fault of the core, kept over the reset.
    Fault,
}

/// Capabilities of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capabilities(#[serde(with = "postcard::fixint::le")] pub u16);

impl Capabilities {
    /// A timer: [`Pacing::SysTick`] works.
    pub const TIMER: Self = Self(1 << 0);
    /// Learning.
    pub const LEARNING: Self = Self(1 << 1);
    /// A store for parameters over power-off.
    pub const STORE: Self = Self(1 << 2);
    /// A write key: uploads have to be signed.
    pub const WRITE_KEY: Self = Self(1 << 3);
    /// A watchdog that restarts the board when a task hangs.
    pub const WATCHDOG: Self = Self(1 << 4);
    /// Restart of the processor by command.
    pub const REBOOT: Self = Self(1 << 5);

    /// True if it has every capability of `other`.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl core::ops::BitOr for Capabilities {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Identity and state of a board.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BoardHello {
    /// Identity of the arm the firmware was built for.
    #[serde(with = "postcard::fixint::le")]
    pub arm_hash: u32,
    /// Name of the arm.
    pub arm: Name,
    /// Number of joints.
    pub joints: u8,
    /// Number of base parameters.
    pub base_columns: u8,
    /// Version of the firmware.
    pub firmware: Name,
    /// Capabilities, the write key included.
    pub capabilities: Capabilities,
    /// Unit of the cost counter.
    pub counter: CounterKind,
    /// Counts per second.
    #[serde(with = "postcard::fixint::le")]
    pub counter_hz: u32,
    /// Configuration of the ticks.
    pub configuration: Configuration,
    /// Cause of the last start.
    pub reset_reason: ResetReason,
    /// Safety state and reason, a fault kept over the reset included.
    pub safety: SafetyStatus,
    /// Counts from the start of the counter, behind those of the clocks, to the first hello; 0 without a counter.
    #[serde(with = "postcard::fixint::le")]
    pub boot_counts: u32,
    /// Clock, option bytes and program.
    pub chip: ChipStatus,
}

impl BoardHello {
    /// Time from the start of the counter to the first hello, µs; `None` where the counter gives no time.
    pub fn boot_us(&self) -> Option<u32> {
        let counts = u64::from(self.boot_counts) * 1_000_000;
        let time = counts.checked_div(u64::from(self.counter_hz))?;
        u32::try_from(time).ok()
    }
}
