//! A firmware that drives its joint in the emulator, and what it does to timer and pins.

pub(crate) mod parts;

use crate::patched::patched;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque::joint::{JointMeasurement, JointMotion, JointSample, JointVector};
use foretorque_link::safety::SafetyReason;
use foretorque_link::wire::NackReason;
use foretorque_workbench::board::log::Messages;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{BoardError, Client, TickReply};
use parts::{drive, encoder};
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

pub(crate) const PATIENCE: Duration = Duration::from_secs(5);
/// State of the drive in the trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stage {
    pub(crate) enabled: bool,
    /// Gate of the timer: main output enable.
    pub(crate) gate: bool,
    /// Counts of the pulse width.
    pub(crate) width: u16,
    pub(crate) positive: bool,
}

pub(crate) struct Trial {
    pub(crate) client: Client<JOINTS>,
    elf: PathBuf,
    pub(crate) trace: PathBuf,
    log: PathBuf,
}

impl Trial {
    /// The firmware as it is flashed, or a patched copy of it.
    pub(crate) fn start(name: &str, patches: &[(&str, Vec<u16>)]) -> Self {
        let mut options = QemuOptions::new(Image::Joint);
        options.elf.set_file_name("joint-drive");
        if !patches.is_empty() {
            options.elf = patched(&options.elf, &format!("joint-drive-{name}"), patches);
        }
        let tmp = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
        let trace = tmp.join(format!("drive-{name}.trace"));
        let log = tmp.join(format!("drive-{name}.log"));
        options.trace = Some(trace.clone());
        options.log = Some(log.clone());
        let emulator = Emulator::start(&options).unwrap_or_else(|error| panic!("{error}"));
        let mut client = Client::connect::<Ur5, PARAMETERS>(Box::new(emulator), PATIENCE)
            .unwrap_or_else(|error| panic!("{error}"));
        client.set_timeout(PATIENCE);
        Self {
            client,
            elf: options.elf,
            trace,
            log,
        }
    }

    /// With drive and encoder, which stands at `angle` counts; they end after so many readings of the encoder.
    pub(crate) fn equipped(name: &str, angle: u16, encoder_ends: u16, drive_ends: u16) -> Self {
        let patches = [
            ("3spi8exchange", encoder(angle, encoder_ends)),
            ("4pins8pin_high", drive(drive_ends)),
        ];
        Self::start(name, &patches)
    }

    pub(crate) fn armed(name: &str, encoder_ends: u16, drive_ends: u16) -> Self {
        let mut trial = Self::equipped(name, 0, encoder_ends, drive_ends);
        for _ in 0..5 {
            trial.sample(&still());
        }
        trial.client.arm(&still()).expect("it can be armed");
        for _ in 0..30 {
            trial.sample(&still());
        }
        let stage = trial.stage();
        assert!(
            stage.enabled && stage.gate && stage.width > 100,
            "{stage:?}"
        );
        trial
    }

    pub(crate) fn sample(&mut self, sample: &JointSample<JOINTS>) -> TickReply<JOINTS> {
        self.client.sample(sample).expect("a torque")
    }

    pub(crate) fn refusal(&mut self) -> SafetyReason {
        match self.client.arm(&still()) {
            Err(BoardError::Refused(NackReason::Unsafe(reason))) => reason,
            other => panic!("{other:?}"),
        }
    }

    /// Everything the firmware wrote to timer and pins so far, in order: the last state of it.
    pub(crate) fn stage(&self) -> Stage {
        let trace = fs::read_to_string(&self.trace).expect("the emulator writes a trace");
        let mut stage = Stage {
            enabled: false,
            gate: false,
            width: 0,
            positive: false,
        };
        for (device, offset, value) in trace.lines().filter_map(written) {
            match (device, offset) {
                ("GPIOB", 0x18) => {
                    for (pin, state) in [(8, &mut stage.enabled), (9, &mut stage.positive)] {
                        if value & 1 << pin != 0 {
                            *state = true;
                        } else if value & 1 << (pin + 16) != 0 {
                            *state = false;
                        }
                    }
                }
                ("timer[1]", 0x34) => stage.width = value as u16,
                ("timer[1]", 0x44) => stage.gate = value & 1 << 15 != 0,
                _ => {}
            }
        }
        stage
    }

    pub(crate) fn is_off(&self) {
        let Stage {
            enabled,
            gate,
            width,
            ..
        } = self.stage();
        assert_eq!((enabled, gate, width), (false, false, 0));
    }

    pub(crate) fn log(&self) -> String {
        let elf = fs::read(&self.elf).expect("readable");
        let messages = Messages::of(&elf).expect("it has messages");
        let stream = fs::read(&self.log).expect("the emulator writes a log");
        messages
            .lines(&stream)
            .expect("no frame is lost")
            .join("\n")
    }
}

/// Device, offset and value of a write in the trace.
pub(crate) fn written(line: &str) -> Option<(&str, u32, u32)> {
    let (device, rest) = line.split_once(": unimplemented device write")?;
    let hex = |key: &str| {
        let (_, rest) = rest.split_once(key)?;
        let digits = rest.split([',', ')']).next()?;
        u32::from_str_radix(digits, 16).ok()
    };
    Some((device, hex("offset 0x")?, hex("value 0x")?))
}

/// The arm stretched out, at rest.
pub(crate) fn still() -> JointSample<JOINTS> {
    JointSample {
        desired: JointMotion::zero(),
        measured: Some(JointMeasurement {
            q: JointVector::zeros(),
            tau: JointVector::zeros(),
        }),
    }
}
