//! The way out of the firmware: whatever fails, the torque goes off, and the restarted board says why it restarted.
//!
//! `faults` is a firmware that carries the fault handlers of the flashable one and fails on request.

use foretorque::edge::wire::{BoardHello, BoardMessage, Decoder, ResetReason};
use host_sim::board::qemu::{Emulator, Image, QemuOptions};
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(5);
/// What goes to the set/reset register of GPIOB to switch the torque enable, PB12, on and off (RM0090 8.4.7).
const ON: &str = "write (size 4, offset 0x018, value 0x00001000)";
const OFF: &str = "write (size 4, offset 0x018, value 0x10000000)";

/// A trial: the emulator with the firmware that fails, and the trace of what it does to the pins.
struct Trial {
    emulator: Emulator,
    trace: PathBuf,
}

impl Trial {
    fn start(name: &str) -> Self {
        let trace = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.trace"));
        let mut options = QemuOptions::new(Image::Joint);
        options.elf.set_file_name("faults");
        options.trace = Some(trace.clone());
        let emulator = Emulator::start(&options).unwrap_or_else(|error| panic!("{error}"));
        Self { emulator, trace }
    }

    /// The next hello on the line.
    fn hello(&mut self) -> BoardHello {
        let mut decoder = Decoder::new();
        let mut room = [0; 1];
        loop {
            let count = self.emulator.read(&mut room, PATIENCE);
            assert_eq!(count.expect("the board lives"), 1, "the board says hello");
            let Some(frame) = decoder.push(room[0]) else {
                continue;
            };
            let frame = frame.expect("no bit is lost");
            if let Ok(BoardMessage::<6>::Hello(hello)) = frame.message() {
                return hello;
            }
        }
    }

    /// What happened to the torque enable so far: true for on.
    fn switched(&self) -> Vec<bool> {
        let trace = fs::read_to_string(&self.trace).expect("the emulator writes a trace");
        let mut switched = Vec::new();
        for line in trace.lines().filter(|line| line.contains("GPIOB")) {
            if line.contains(ON) {
                switched.push(true);
            } else if line.contains(OFF) {
                switched.push(false);
            }
        }
        switched
    }
}

/// Fails in the way of `letter`; reason and place that the restarted board gives.
fn fail(name: &str, letter: u8) -> (ResetReason, u32) {
    let mut trial = Trial::start(name);
    let first = trial.hello();
    assert_eq!(
        (first.reset_reason, first.counter_hz),
        (ResetReason::Unknown, 0),
        "nothing is kept over power-on"
    );
    assert_eq!(
        trial.switched(),
        [false, true],
        "the torque goes on after start-up"
    );
    trial.emulator.write(&[letter]).expect("the board listens");
    let second = trial.hello();
    assert_eq!(
        trial.switched(),
        [false, true, false, false, true],
        "the torque goes off before the reset"
    );
    // And what was kept is told once: a board that fails again gives the new reason.
    trial.emulator.write(b"p").expect("the board listens");
    assert_eq!(trial.hello().reset_reason, ResetReason::Panic);
    (second.reset_reason, second.counter_hz)
}

#[test]
fn a_panic_switches_the_torque_off_and_is_reported() {
    let (reason, line) = fail("panic", b'p');
    assert_eq!(reason, ResetReason::Panic);
    let source = include_str!("../../firmware/src/bin/faults/main.rs");
    let panics = source
        .lines()
        .nth(line as usize - 1)
        .expect("a line of the source");
    assert!(panics.contains("panic!()"), "line {line}: {panics}");
}

#[test]
fn an_undefined_instruction_switches_the_torque_off_and_is_reported() {
    let (reason, place) = fail("udf", b'u');
    assert_eq!(reason, ResetReason::Fault);
    assert!(
        (0x0800_0000..0x0810_0000).contains(&place),
        "{place:#x} is in the flash"
    );
}

#[test]
fn a_stack_overflow_switches_the_torque_off_and_is_reported() {
    assert_eq!(fail("stack", b's'), (ResetReason::Fault, 0));
}

#[test]
fn an_interrupt_without_a_handler_switches_the_torque_off_and_is_reported() {
    // EXTI0 is interrupt 6 (RM0090 table 62).
    assert_eq!(fail("interrupt", b'i'), (ResetReason::Fault, 6));
}
