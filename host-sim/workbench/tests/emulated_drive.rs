//! The firmware that drives its own joint, in the emulator: what it does to timer and pins, against what it answers.
//!
//! The emulator has neither encoder nor pins. What it has is what a board sees whose encoder and drive are not plugged in:
//! the fault line is low, the bus reads zeros. Where a drive and an encoder are needed two functions of the firmware are
//! replaced, the one that moves a byte over the bus and the one that reads the level of the fault line; all the rest is what
//! is flashed.

use crate::trial::{Trial, connected, native, patched, scratch, still};
use foretorque::arm::ur5::JOINTS;
use foretorque::joint::{JointSample, JointVector};
use foretorque::limits::Flags;
use foretorque_link::safety::{SafetyReason, SafetyState};
use foretorque_link::wire::Field;
use foretorque_workbench::board::Client;
use foretorque_workbench::board::log::Messages;
use foretorque_workbench::board::qemu::{Image, QemuOptions};
use std::fs;
use std::path::Path;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Stage {
    enabled: bool,
    /// Gate of the timer: main output enable.
    gate: bool,
    /// Counts of the pulse width.
    width: u16,
    positive: bool,
}

impl Stage {
    /// Last state of timer and pins in a trace.
    fn of(trace: &str) -> Self {
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
fn start(name: &str, patches: &[(&str, Vec<u16>)]) -> Trial {
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
fn equipped(name: &str, angle: u16, encoder_ends: u16, drive_ends: u16) -> Trial {
    let patches = [
        ("11peripherals8exchange", encoder(angle, encoder_ends)),
        ("11peripherals8pin_high", drive(drive_ends)),
    ];
    start(name, &patches)
}

fn arm(client: &mut Client<JOINTS>) {
    for _ in 0..5 {
        client.sample(&still()).expect("a torque");
    }
    client.arm(&still()).expect("it can be armed");
    for _ in 0..30 {
        client.sample(&still()).expect("a torque");
    }
}

fn armed(name: &str, encoder_ends: u16, drive_ends: u16) -> Trial {
    let mut trial = equipped(name, 0, encoder_ends, drive_ends);
    arm(&mut trial.client);
    let stage = trial.stage();
    let driven = stage.enabled && stage.gate && stage.width > 100;
    assert!(driven, "{stage:?}");
    trial
}

impl Trial {
    fn stage(&self) -> Stage {
        Stage::of(&self.trace())
    }

    fn is_off(&self) {
        let stage = self.stage();
        let off = !stage.enabled && !stage.gate && stage.width == 0;
        assert!(off, "{stage:?}");
    }

    fn log(&self) -> String {
        let read = |path: &Path| fs::read(path).expect("readable");
        let messages = Messages::of(&read(&self.options.elf)).expect("it has messages");
        let stream = read(self.options.log.as_deref().expect("it has a log"));
        let lines = messages.lines(&stream);
        lines.expect("no frame is lost").join("\n")
    }
}

/// Device, offset and value of a write in the trace.
fn written(line: &str) -> Option<(&str, u32, u32)> {
    let (device, rest) = line.split_once(": unimplemented device write")?;
    let hex = |key: &str| {
        let (_, rest) = rest.split_once(key)?;
        let digits = rest.split([',', ')']).next()?;
        u32::from_str_radix(digits, 16).ok()
    };
    Some((device, hex("offset 0x")?, hex("value 0x")?))
}

/// Transfer number that is never reached.
const NEVER: u16 = u16::MAX;
/// Bytes that a reading of the encoder moves.
const READING: u16 = 4;

/// `movw r, value` (ARM DDI 0403, A7.7.76, encoding T3), or with `top` `movt` (A7.7.79).
fn mov16(register: u16, value: u16, top: bool) -> [u16; 2] {
    let (i, imm4) = ((value >> 11) & 1, value >> 12);
    let first = if top { 0xF2C0 } else { 0xF240 } | i << 10 | imm4;
    let second = ((value >> 8) & 7) << 12 | register << 8 | (value & 0xFF);
    [first, second]
}

/// RAM that the chip has not, and the emulator has: zero at start. The bytes are counted there.
const COUNTER: [[u16; 2]; 2] = [[0xF248, 0x0100], [0xF2C2, 0x0102]];

/// An encoder at `angle` counts in the place of the bus: of four bytes two are the angle and two the diagnostics, as they
/// are asked for in turn. After `readings` the line is low.
fn encoder(angle: u16, readings: u16) -> Vec<u16> {
    let even = |value: u16| value | ((value.count_ones() as u16 & 1) << 15);
    // In the order in which they are sent: an angle that nobody has asked for, then diagnostics (ready), angle, …
    let [angle, diagnostics] = [even(angle), even(1 << 8)].map(u16::swap_bytes);
    let mut code = COUNTER.concat();
    code.extend([
        0x680A, // ldr r2, [r1]
        0x1C53, // adds r3, r2, #1
        0x600B, // str r3, [r1]
    ]);
    code.extend(mov16(0, angle, false));
    code.extend(mov16(0, diagnostics, true));
    code.extend([
        0x00D3, // lsls r3, r2, #3
        0x41D8, // rors r0, r3
        0xB2C0, // uxtb r0, r0
    ]);
    if readings != NEVER {
        let last = u8::try_from(readings * READING).expect("compared with a byte");
        code.extend([
            0x2A00 | u16::from(last), // cmp r2, #last
            0xBF28,                   // it hs
            0x2000,                   // movhs r0, #0
        ]);
    }
    code.push(0x4770); // bx lr
    code
}

/// A fault line that is high until the encoder has been read `readings` times.
fn drive(readings: u16) -> Vec<u16> {
    if readings == NEVER {
        return vec![0x2001, 0x4770]; // movs r0, #1; bx lr
    }
    let mut code = COUNTER.concat();
    code.push(0x680A); // ldr r2, [r1]
    code.extend(mov16(3, readings * READING, false));
    code.extend([
        0x1AD0, // subs r0, r2, r3
        0x0FC0, // lsrs r0, r0, #31
        0x4770, // bx lr
    ]);
    code
}

/// Of `firmware/boards/f405/src/pyboard_drive/mod.rs`: the joint, and the torque of a full duty, N·m.
const JOINT: usize = 1;
const FULL_SCALE_NM: f32 = 12.5 * 16.0;
const TOP: f32 = 8400.0;

/// A motion of all joints near the stretched arm, in which the shoulder's torque changes its sign.
fn moving(k: u32) -> JointSample<JOINTS> {
    let t = k as f32 * 0.02;
    let mut sample = still();
    for joint in 0..JOINTS {
        let phase = t * (1.0 + 0.2 * joint as f32);
        sample.desired.q[joint] = 0.05 * phase.sin();
        sample.desired.qd[joint] = phase.cos();
        sample.desired.qdd[joint] = -30.0 * phase.sin();
    }
    sample
}

#[test]
fn a_board_with_nothing_plugged_in_refuses_to_arm_and_says_why() {
    let mut trial = start("bare", &[]);
    assert_eq!(trial.client.safety().state, SafetyState::Fault);
    assert_eq!(trial.client.safety().reason, SafetyReason::Drive);
    assert_eq!(trial.refusal(), SafetyReason::Drive);
    trial.client.clear_fault().expect("it is received");
    assert_eq!(trial.refusal(), SafetyReason::Drive, "it is still there");
    trial.is_off();
    let log = trial.log();
    for line in [
        "stage: the motor stage reports a fault",
        "encoder: encoder is not ready",
    ] {
        assert!(log.contains(line), "{log}");
    }
}

#[test]
fn a_board_without_its_encoder_refuses_to_arm_and_says_why() {
    let mut trial = start("blind", &[("11peripherals8pin_high", drive(NEVER))]);
    assert_eq!(trial.client.safety().state, SafetyState::Disarmed);
    for _ in 0..10 {
        let reply = trial.sample(&still());
        assert!(reply.flags.contains(Flags::NO_MEASUREMENT));
        assert_eq!(reply.safety.reason, SafetyReason::Encoder);
    }
    assert_eq!(trial.refusal(), SafetyReason::Encoder);
    trial.is_off();
}

#[test]
fn a_bus_that_does_not_answer_is_no_position_and_stops_nothing() {
    // `mov.w r0, #256; bx lr`: no byte came in time.
    let silent = vec![0xF44F, 0x7080, 0x4770];
    let patches = [
        ("11peripherals8exchange", silent),
        ("11peripherals8pin_high", drive(NEVER)),
    ];
    let mut trial = start("bus", &patches);
    for tick in 0..10 {
        let reply = trial.sample(&still());
        assert_eq!(reply.tick, tick);
        assert_eq!(reply.safety.reason, SafetyReason::Encoder);
    }
    assert_eq!(trial.refusal(), SafetyReason::Encoder);
    let log = trial.log();
    assert!(log.contains("encoder: encoder bus"), "{log}");
}

#[test]
fn the_pulse_width_is_the_torque_of_the_joint_that_is_answered() {
    let mut trial = armed("width", NEVER, NEVER);
    let mut native = connected(native());
    arm(&mut native);
    let (mut positive, mut negative) = (0, 0);
    for k in 0..200 {
        let reply = trial.sample(&moving(k));
        assert_eq!(reply.safety.state, SafetyState::Armed, "{k}");
        let torque = reply.total[JOINT];
        let stage = trial.stage();
        let wanted = torque.abs() / FULL_SCALE_NM * TOP;
        let near = (f32::from(stage.width) - wanted).abs() <= 1.0;
        assert!(near, "{k}: {torque} N·m, {stage:?}");
        assert!(stage.enabled && stage.gate, "{k}");
        if stage.width > 0 {
            assert_eq!(stage.positive, torque > 0.0, "{k}: {torque} N·m");
        }
        positive += u32::from(torque > 0.0);
        negative += u32::from(torque < 0.0);
        // Driving a joint changes no bit of what is computed.
        let same = native.sample(&moving(k)).expect("a torque");
        assert_eq!(reply.total, same.total, "{k}");
    }
    assert!(positive > 20 && negative > 20, "{positive} and {negative}");
    trial.client.disarm().expect("it obeys");
    trial.is_off();
}

#[test]
fn the_position_is_the_encoders() {
    let mut trial = equipped("angle", 300, NEVER, NEVER);
    let fields = Field::MeasuredPosition.bit();
    trial.client.stream(fields, 1).expect("it fits");
    for _ in 0..10 {
        let mut sample = still();
        sample.measured.as_mut().expect("it is measured").q[JOINT] = -0.7;
        trial.sample(&sample);
    }
    let frames = trial.client.take_telemetry();
    let last = frames.last().expect("telemetry");
    let seen = last.bytes[4 * JOINT..].first_chunk().copied();
    let seen = f32::from_le_bytes(seen.expect("a position of every joint"));
    assert_eq!(seen, 300.0 * (core::f32::consts::TAU / 16_384.0));
}

#[test]
fn a_stop_ends_the_pulses_at_once() {
    let mut trial = armed("stop", NEVER, NEVER);
    trial.client.stop().expect("it obeys");
    trial.is_off();
    assert_eq!(trial.refusal(), SafetyReason::Stopped);
}

#[test]
fn silence_ends_the_pulses() {
    let mut trial = equipped("silence", 0, NEVER, NEVER);
    trial.arm_paced_by_timer();
    let trace = trial.trace();
    let on = |line| matches!(written(line), Some(("GPIOB", 0x18, bits)) if bits == 1 << 8);
    assert!(trace.lines().any(on), "it was armed");
    trial.silence_until(|trace| !Stage::of(trace).enabled);
    trial.is_off();
    let after = trial.sample(&still());
    assert_eq!(after.safety.reason, SafetyReason::CommandTimeout);
}

#[test]
fn an_encoder_that_goes_silent_ends_the_torque_and_latches() {
    let mut trial = armed("unplugged", 60, NEVER);
    let mut ticks = 0;
    let mut reply = trial.sample(&still());
    while reply.safety.state != SafetyState::Fault {
        assert!(ticks < 200, "the torque ends");
        ticks += 1;
        reply = trial.sample(&still());
    }
    assert_eq!(reply.safety.reason, SafetyReason::Encoder);
    assert_eq!(reply.total, JointVector::<JOINTS>::zeros());
    trial.is_off();
    assert_eq!(trial.refusal(), SafetyReason::Encoder);
    assert!(trial.log().contains("encoder: encoder is not ready"));
}

#[test]
fn a_fault_of_the_drive_ends_the_pulses_in_the_tick_in_which_it_is_seen() {
    let mut trial = armed("fault", NEVER, 60);
    let mut reply = trial.sample(&still());
    for _ in 0..60 {
        if reply.safety.state == SafetyState::Fault {
            break;
        }
        assert!(reply.total[JOINT] != 0.0);
        reply = trial.sample(&still());
    }
    assert_eq!(reply.safety.state, SafetyState::Fault);
    assert_eq!(reply.safety.reason, SafetyReason::Drive);
    assert_eq!(reply.total, JointVector::<JOINTS>::zeros());
    trial.is_off();
    assert_eq!(trial.refusal(), SafetyReason::Drive);
}
