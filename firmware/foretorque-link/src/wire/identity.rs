//! Who a board is and how it runs.

use super::Name;
use crate::safety::SafetyStatus;
use serde::{Deserialize, Serialize};

/// Source of the tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Pacing {
    /// A sample runs a tick and is answered at once.
    Link,
    /// The board's timer runs the tick on the newest sample.
    SysTick,
}

/// How much of the torque is answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ReplyMode {
    /// The shares of one joint a tick: [`TorqueFrame`](super::TorqueFrame).
    Decimated,
    /// All shares: [`FullTorqueFrame`](super::FullTorqueFrame).
    Full,
}

/// How the board runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Configuration {
    /// Period of the tick, µs.
    #[serde(with = "postcard::fixint::le")]
    pub period_us: u32,
    /// Source of the tick.
    pub pacing: Pacing,
    /// How much is answered.
    pub reply: ReplyMode,
}

impl Configuration {
    /// Shortest and longest period, µs: 10 kHz to 10 Hz.
    pub const PERIODS_US: core::ops::RangeInclusive<u32> = 100..=100_000;
}

impl Default for Configuration {
    /// 1 kHz, paced by the link, decimated shares.
    fn default() -> Self {
        Self {
            period_us: 1000,
            pacing: Pacing::Link,
            reply: ReplyMode::Decimated,
        }
    }
}

/// Unit of a board's cost counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CounterKind {
    /// Nothing: costs are zero.
    None,
    /// Cycles of the core.
    Cycles,
    /// Instructions, in an emulator that counts them.
    Instructions,
}

/// Why the board started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetReason {
    /// Not known.
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
    /// The board has a timer of its own: [`Pacing::SysTick`] works.
    pub const TIMER: Self = Self(1 << 0);
    /// The board learns.
    pub const LEARNING: Self = Self(1 << 1);
    /// The board keeps parameters over power-off.
    pub const STORE: Self = Self(1 << 2);
    /// The board has a write key: an upload has to be signed.
    pub const WRITE_KEY: Self = Self(1 << 3);
    /// A watchdog restarts the board when one of its tasks hangs.
    pub const WATCHDOG: Self = Self(1 << 4);
    /// The board can start its processor anew.
    pub const REBOOT: Self = Self(1 << 5);

    /// Every capability of `other` is there.
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

/// Who a board is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoardHello {
    /// Identity of the arm the firmware was built for.
    #[serde(with = "postcard::fixint::le")]
    pub arm_hash: u32,
    /// Its name.
    pub arm: Name,
    /// Number of joints.
    pub joints: u8,
    /// Number of base parameters.
    pub base_columns: u8,
    /// Version of the firmware.
    pub firmware: Name,
    /// Capabilities of the board.
    pub capabilities: Capabilities,
    /// Unit of the cost counter.
    pub counter: CounterKind,
    /// Counts per second.
    #[serde(with = "postcard::fixint::le")]
    pub counter_hz: u32,
    /// How it runs.
    pub configuration: Configuration,
    /// Why it started.
    pub reset_reason: ResetReason,
    /// Whether torque leaves, and why not; a fault kept over the reset is here.
    pub safety: SafetyStatus,
    /// Counts of its counter from its first instructions to its first hello; 0 where there is no counter.
    #[serde(with = "postcard::fixint::le")]
    pub boot_counts: u32,
}

impl BoardHello {
    /// Time from its first instructions to its first hello, µs; `None` where its counter tells no time.
    pub fn boot_us(&self) -> Option<u32> {
        let counts = u64::from(self.boot_counts) * 1_000_000;
        let time = counts.checked_div(u64::from(self.counter_hz))?;
        u32::try_from(time).ok()
    }
}
