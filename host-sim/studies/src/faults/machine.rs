//! Faults of the processor: the firmware that fails on request, in the emulator; and a board that its watchdog has restarted.

use super::Campaign;
use crate::StudyError;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::safety::{SafetyReason, SafetyState};
use foretorque_link::session::{BoardDescription, NoClock, NoLocalSensor};
use foretorque_link::wire::{BoardHello, BoardMessage, Decoder, ResetReason};
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{Client, Native, Transport as _};
use std::fs;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

const TIMEOUT: Duration = Duration::from_secs(10);
/// Trace of a write to the set/reset register of GPIOB that switches the torque enable, PB12, on or off (RM0090 8.4.7).
const ON: &str = "write (size 4, offset 0x018, value 0x00001000)";
const OFF: &str = "write (size 4, offset 0x018, value 0x10000000)";

/// A way of failing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crash {
    /// Name in a report.
    pub name: &'static str,
    /// Byte that makes the firmware fail in this way.
    letter: u8,
    /// Reset reason that the restarted board reports.
    pub reason: ResetReason,
}

impl Crash {
    /// All of them. An undefined instruction is a hard fault.
    pub const ALL: [Self; 4] = [
        Self::new("panic", b'p', ResetReason::Panic),
        Self::new("hard fault", b'u', ResetReason::Fault),
        Self::new("stack overflow", b's', ResetReason::Fault),
        Self::new("stray interrupt", b'i', ResetReason::Fault),
    ];

    const fn new(name: &'static str, letter: u8, reason: ResetReason) -> Self {
        Self {
            name,
            letter,
            reason,
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
    pub fn start(trace: PathBuf) -> io::Result<Self> {
        let mut options = QemuOptions::new(Image::Joint);
        options.elf.set_file_name("faults");
        options.trace = Some(trace.clone());
        let emulator = Emulator::start(&options)?;
        Ok(Self { emulator, trace })
    }

    /// The next hello on the line; `None` when none comes in time.
    pub fn hello(&mut self) -> io::Result<Option<BoardHello>> {
        let mut decoder = Decoder::new();
        let mut buffer = [0; 1];
        while self.emulator.receive(&mut buffer, TIMEOUT)? == 1 {
            if let Some(Ok(frame)) = decoder.push(buffer[0])
                && let Ok(BoardMessage::<JOINTS>::Hello(hello)) = frame.message()
            {
                return Ok(Some(hello));
            }
        }
        Ok(None)
    }

    /// Asks the firmware to fail.
    pub fn fail(&mut self, crash: Crash) -> io::Result<()> {
        self.emulator.send(&[crash.letter])
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
pub(super) fn crashes(crash: Crash, times: u32, trace: PathBuf) -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new(crash.name, "qemu (faults)");
    let mut trial = Trial::start(trace)?;
    trial.hello()?;
    for _ in 0..times {
        let before = trial.switched().len();
        trial.fail(crash)?;
        let reported = trial.hello()?.map(|hello| hello.reset_reason);
        campaign.injected += 1;
        campaign.recovered += u64::from(reported == Some(crash.reason));
        // Off on the way out; off by the constructor after the restart.
        let off = trial.switched().get(before..before + 2) == Some(&[false, false]);
        campaign.wrong_torques += u64::from(!off);
    }
    Ok(campaign)
}

/// A board that its watchdog has restarted: no torque before it is armed anew; it reports the restart, refuses to be armed until
/// that is cleared, and then works.
pub(super) fn restart_by_watchdog() -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new("restart by the watchdog", "native");
    let description = BoardDescription {
        reset_reason: ResetReason::Watchdog,
        ..BoardDescription::plain(NoClock)
    };
    let native = Native::<Ur5, JOINTS, PARAMETERS>::described(description, NoLocalSensor)?;
    let mut board = Client::connect::<Ur5, PARAMETERS>(Box::new(native), TIMEOUT)?;
    let zero = JointVector::zeros();
    let still = JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement { q: zero, tau: zero }),
    };
    let mut quiet = true;
    for _ in 0..4 {
        quiet &= board.sample(&still)?.total == zero;
    }
    let refused = board.arm(&still).is_err();
    quiet &= board.sample(&still)?.total == zero;
    let safety = board.safety();
    let reported = safety.state == SafetyState::Fault && safety.reason == SafetyReason::Restarted;
    let armed = board.clear_fault().is_ok() && board.arm(&still).is_ok();
    let enabled = board.sample(&still)?.safety.state == SafetyState::Armed;
    campaign.injected = 1;
    campaign.wrong_torques = u64::from(!quiet);
    campaign.recovered = u64::from(refused && reported && armed && enabled);
    Ok(campaign)
}
