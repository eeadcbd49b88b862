//! Faults of the processor: the firmware that fails on request, in the emulator.

use super::Campaign;
use foretorque::arm::ur5::JOINTS;
use foretorque_link::wire::{BoardHello, BoardMessage, Decoder, ResetReason};
use foretorque_workbench::board::qemu::{Emulator, EmulatorError, Image, QemuOptions};
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(10);
/// Trace of a write to the set/reset register of GPIOB that switches the torque enable, PB12, on or off (RM0090 8.4.7).
const ON: &str = "write (size 4, offset 0x018, value 0x00001000)";
const OFF: &str = "write (size 4, offset 0x018, value 0x10000000)";

/// A way of failing, and the letter that asks for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crash {
    /// A panic.
    Panic,
    /// An undefined instruction, which is a hard fault.
    UndefinedInstruction,
    /// A stack that grows beyond its region.
    StackOverflow,
    /// An interrupt that nobody handles.
    StrayInterrupt,
}

impl Crash {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::Panic,
        Self::UndefinedInstruction,
        Self::StackOverflow,
        Self::StrayInterrupt,
    ];

    /// Name in a report.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Panic => "panic",
            Self::UndefinedInstruction => "hard fault",
            Self::StackOverflow => "stack overflow",
            Self::StrayInterrupt => "stray interrupt",
        }
    }

    /// Byte that makes the firmware fail in this way.
    pub const fn letter(self) -> u8 {
        match self {
            Self::Panic => b'p',
            Self::UndefinedInstruction => b'u',
            Self::StackOverflow => b's',
            Self::StrayInterrupt => b'i',
        }
    }

    /// Reset reason that the restarted board reports.
    pub const fn reason(self) -> ResetReason {
        match self {
            Self::Panic => ResetReason::Panic,
            _ => ResetReason::Fault,
        }
    }
}

/// The firmware that fails, and the trace of what it does to its pins.
pub struct Trial {
    emulator: Emulator,
    trace: PathBuf,
}

impl Trial {
    /// Starts it; `trace` is written.
    pub fn start(trace: PathBuf) -> Result<Self, EmulatorError> {
        let mut options = QemuOptions::new(Image::Joint);
        options.elf.set_file_name("faults");
        options.trace = Some(trace.clone());
        let emulator = Emulator::start(&options)?;
        Ok(Self { emulator, trace })
    }

    /// The next hello on the line; `None` when none comes in time.
    pub fn hello(&mut self) -> Result<Option<BoardHello>, EmulatorError> {
        let mut decoder = Decoder::new();
        let mut buffer = [0; 1];
        while self.emulator.read(&mut buffer, PATIENCE)? == 1 {
            if let Some(Ok(frame)) = decoder.push(buffer[0])
                && let Ok(BoardMessage::<JOINTS>::Hello(hello)) = frame.message()
            {
                return Ok(Some(hello));
            }
        }
        Ok(None)
    }

    /// Asks the firmware to fail.
    pub fn fail(&mut self, crash: Crash) -> Result<(), EmulatorError> {
        self.emulator.write(&[crash.letter()])
    }

    /// States of the torque enable so far: true for on.
    pub fn switched(&self) -> Vec<bool> {
        // A trace that is not there yet has no changes.
        let trace = fs::read_to_string(&self.trace).unwrap_or_default();
        let pins = trace.lines().filter(|line| line.contains("GPIOB"));
        pins.filter_map(|line| match () {
            () if line.contains(ON) => Some(true),
            () if line.contains(OFF) => Some(false),
            () => None,
        })
        .collect()
    }
}

/// `times` failures in a row of one firmware. A torque is wrong when the enable pin is not off before the restart.
pub fn crashes(crash: Crash, times: u32, trace: PathBuf) -> Result<Campaign, EmulatorError> {
    let mut campaign = Campaign::new(crash.name(), "qemu (faults)");
    let mut trial = Trial::start(trace)?;
    trial.hello()?;
    for _ in 0..times {
        let before = trial.switched().len();
        trial.fail(crash)?;
        let reported = trial.hello()?.map(|hello| hello.reset_reason);
        campaign.injected += 1;
        campaign.recovered += u64::from(reported == Some(crash.reason()));
        // Off on the way out; off by the constructor after the restart.
        let switched = trial.switched();
        let off = switched.get(before..before + 2) == Some(&[false, false]);
        campaign.wrong_torques += u64::from(!off);
    }
    Ok(campaign)
}
