//! The firmware that drives its own joint, in the emulator: what it does to timer and pins, against what it answers.
//!
//! The emulator has neither encoder nor pins. What it has is what a board sees whose encoder and drive are not plugged in:
//! the fault line is low, the bus reads zeros. Where a drive and an encoder are needed two functions of the firmware are
//! replaced, the one that moves a byte over the bus and the one that reads the level of the fault line; all the rest is what
//! is flashed.

use crate::driven::parts::{NEVER, drive};
use crate::driven::{Stage, armed, equipped, start, written};
use crate::trial::{connected, native, still};
use foretorque::arm::ur5::JOINTS;
use foretorque::joint::{JointSample, JointVector};
use foretorque::limits::Flags;
use foretorque_link::safety::{SafetyReason, SafetyState};
use foretorque_link::wire::Field;

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
    let mut trial = start("blind", &[("4pins8pin_high", drive(NEVER))]);
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
    let patches = [("3spi8exchange", silent), ("4pins8pin_high", drive(NEVER))];
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
    for _ in 0..5 {
        native.sample(&still()).expect("a torque");
    }
    native.arm(&still()).expect("it can be armed");
    for _ in 0..30 {
        native.sample(&still()).expect("a torque");
    }
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
