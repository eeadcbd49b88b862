//! A firmware that drives its joint in the emulator, and what it does to timer and pins.

pub(crate) mod parts;

use crate::trial::{Trial, patched, scratch, still};
use foretorque_workbench::board::log::Messages;
use foretorque_workbench::board::qemu::{Image, QemuOptions};
use parts::{drive, encoder};
use std::fs;
use std::path::Path;

/// State of the drive in the trace.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Stage {
    pub(crate) enabled: bool,
    /// Gate of the timer: main output enable.
    pub(crate) gate: bool,
    /// Counts of the pulse width.
    pub(crate) width: u16,
    pub(crate) positive: bool,
}

impl Stage {
    /// Last state of timer and pins in a trace.
    pub(crate) fn of(trace: &str) -> Self {
        let mut stage = Self::default();
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
}

/// The firmware that drives its joint as it is flashed, or a patched copy of it.
pub(crate) fn start(name: &str, patches: &[(&str, Vec<u16>)]) -> Trial {
    let name = format!("drive-{name}");
    let mut options = QemuOptions::new(Image::Joint);
    options.elf.set_file_name("joint-drive");
    if !patches.is_empty() {
        options.elf = patched(&options.elf, &format!("joint-{name}"), patches);
    }
    options.log = Some(scratch(&format!("{name}.log")));
    Trial::start(&name, options)
}

/// With drive and encoder, which stands at `angle` counts; they end after so many readings of the encoder.
pub(crate) fn equipped(name: &str, angle: u16, encoder_ends: u16, drive_ends: u16) -> Trial {
    let patches = [
        ("3spi8exchange", encoder(angle, encoder_ends)),
        ("4pins8pin_high", drive(drive_ends)),
    ];
    start(name, &patches)
}

pub(crate) fn armed(name: &str, encoder_ends: u16, drive_ends: u16) -> Trial {
    let mut trial = equipped(name, 0, encoder_ends, drive_ends);
    for _ in 0..5 {
        trial.sample(&still());
    }
    trial.client.arm(&still()).expect("it can be armed");
    for _ in 0..30 {
        trial.sample(&still());
    }
    let stage = trial.stage();
    let driven = stage.enabled && stage.gate && stage.width > 100;
    assert!(driven, "{stage:?}");
    trial
}

impl Trial {
    pub(crate) fn stage(&self) -> Stage {
        Stage::of(&self.trace())
    }

    pub(crate) fn is_off(&self) {
        let stage = self.stage();
        let off = !stage.enabled && !stage.gate && stage.width == 0;
        assert!(off, "{stage:?}");
    }

    pub(crate) fn log(&self) -> String {
        let read = |path: &Path| fs::read(path).expect("readable");
        let messages = Messages::of(&read(&self.options.elf)).expect("it has messages");
        let stream = read(self.options.log.as_deref().expect("it has a log"));
        let lines = messages.lines(&stream);
        lines.expect("no frame is lost").join("\n")
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
