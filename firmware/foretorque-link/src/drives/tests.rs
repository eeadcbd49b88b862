//! Codecs: there and back within half a step, saturation, refusal, unbiased torque. Arbitrary frames are those of the fuzzer.

mod clients;

use super::*;
use proptest::prelude::*;

const RANGES: Ranges = Ranges {
    position: 12.5,
    velocity: 30.0,
    torque: 10.0,
    kp: 500.0,
    kd: 5.0,
};

const fn moteus(resolution: Resolution) -> Protocol {
    Protocol::Moteus(Moteus {
        kp: 4000.0,
        kd: 40.0,
        watchdog_s: 0.02,
        resolution,
    })
}

const fn odrive(mode: ControlMode) -> Protocol {
    Protocol::Odrive(Odrive {
        mode,
        velocity_scale: 1000.0,
        torque_scale: 1000.0,
        torque_scale_endpoint: 300,
        polled: true,
    })
}

const fn cia402(mode: ControlMode) -> Protocol {
    Protocol::Cia402(Cia402 {
        mode,
        counts_per_turn: 1_048_576.0,
        rated_torque: 12.0,
    })
}

/// Step of position, velocity, torque, kp and kd of each protocol; infinite where the command does not carry it.
pub(super) const PROTOCOLS: [(Protocol, [f32; 5]); 13] = {
    use {ControlMode::*, Resolution::*};
    const NO: f32 = f32::INFINITY;
    const fn steps(position: f32, others: f32) -> [f32; 5] {
        let [v, t, kp, kd] = [60.0 / others, 20.0 / others, 500.0 / others, 5.0 / others];
        [25.0 / position, v, t, kp, kd]
    }
    const MIT: [f32; 5] = steps(65535.0, 4095.0);
    const FINE: [f32; 5] = steps(65535.0, 65535.0);
    const SHORT: [f32; 5] = [1e-4 * TURN, 2.5e-4 * TURN, 0.01, 0.02, 2e-4];
    const LONG: [f32; 5] = [1e-5 * TURN, 1e-5 * TURN, 0.001, 1e-4, 1e-6];
    const COUNT: f32 = TURN / 1_048_576.0;
    [
        (Protocol::MiniCheetah(RANGES), MIT),
        (Protocol::Damiao(RANGES), MIT),
        (Protocol::CyberGear(RANGES), FINE),
        (Protocol::RobStride(RANGES), FINE),
        (moteus(Int16), SHORT),
        (moteus(Int32), LONG),
        (moteus(F32), [0.0; 5]),
        (odrive(Position), [0.0, 1e-3 * TURN, 1e-3, NO, NO]),
        (odrive(Velocity), [NO, 0.0, 0.0, NO, NO]),
        (odrive(Torque), [NO, NO, 0.0, NO, NO]),
        (cia402(Position), [COUNT, NO, 0.012, NO, NO]),
        (cia402(Velocity), [NO, COUNT, 0.012, NO, NO]),
        (cia402(Torque), [NO, NO, 0.012, NO, NO]),
    ]
};

pub(super) fn profile(protocol: Protocol) -> DriveProfile {
    DriveProfile {
        protocol,
        id: 3,
        host_id: 0x13,
        sign: -1.0,
        zero: 0.4,
        gear: 1.0,
        torque_limit: 9.0,
    }
}

fn values(command: &JointCommand) -> [f32; 5] {
    let c = command;
    [c.position, c.velocity, c.torque, c.kp, c.kd]
}

fn motion([position, velocity, torque, kp, kd]: [f32; 5]) -> JointCommand {
    JointCommand {
        position,
        velocity,
        torque,
        kp,
        kd,
    }
}

/// The command that the drive reads.
fn sent(profile: &DriveProfile, command: &JointCommand, carry: &mut Carry) -> Option<Request> {
    let mut frames = Frames::new();
    profile.command(command, carry, &mut frames);
    frames.first().and_then(|frame| profile.accept(frame))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn commands_come_back_within_half_a_step(
        position in -11.0_f32..11.0, velocity in -29.0_f32..29.0, torque in -8.9_f32..8.9,
        kp in 0.0_f32..500.0, kd in 0.0_f32..5.0,
    ) {
        let command = motion([position, velocity, torque, kp, kd]);
        for (protocol, steps) in PROTOCOLS {
            let request = sent(&profile(protocol), &command, &mut Carry::default());
            let Some(Request::Command(read)) = request else { panic!("{protocol:?} {request:?}") };
            for ((want, got), step) in values(&command).into_iter().zip(values(&read)).zip(steps) {
                let most = 0.5 * step + 4e-6 * want.abs() + 3e-6;
                prop_assert!(step.is_infinite() || (want - got).abs() <= most, "{protocol:?} {want} {got}");
            }
        }
    }

    #[test]
    fn nothing_wraps(fields in proptest::array::uniform5(proptest::num::f32::ANY)) {
        let command = motion(fields);
        for (protocol, steps) in PROTOCOLS {
            let profile = profile(protocol);
            let request = sent(&profile, &command, &mut Carry::default());
            let Some(Request::Command(read)) = request else {
                prop_assert_eq!(request, Some(Request::Order(Order::Disable)));
                let in_drive = profile.in_drive(&command);
                prop_assert!(!command.is_finite() || !in_drive.is_finite());
                continue;
            };
            prop_assert!(read.is_finite() && read.torque.abs() <= 9.0 + 0.5 * steps[2], "{:?} {:?}", protocol, read);
            if profile.carries_gains() {
                prop_assert!(read.kp >= 0.0 && read.kd >= 0.0);
            }
            for (want, got) in values(&command).into_iter().zip(values(&read)) {
                // A value that saturates keeps its side.
                prop_assert!(want.abs() < 1.0 || got == 0.0 || want * got > 0.0 || want < 0.0 && got.abs() < 1.0);
            }
        }
    }

    #[test]
    fn replies_come_back(
        position in -11.0_f32..11.0, velocity in -29.0_f32..29.0, torque in -9.0_f32..9.0,
        state in prop_oneof![Just(DriveState::Disabled), Just(DriveState::Enabled), Just(DriveState::Fault(8))],
    ) {
        for (protocol, steps) in PROTOCOLS {
            let (profile, mut frames, mut read) = (profile(protocol), Frames::new(), JointReply::default());
            let reply = JointReply {
                position: Some(position),
                velocity: Some(velocity),
                torque: Some(torque),
                temperature: Some(40.0),
                state: Some(state),
            };
            profile.reply(&reply, &mut frames);
            for frame in &frames {
                let Some(Event::Reply(part)) = profile.decode(frame) else { panic!("{protocol:?} {frame:?}") };
                read.update(&part);
            }
            let step = |place: usize| if steps[place].is_finite() { steps[place] } else { 1e-5 };
            prop_assert!((read.position.unwrap() - position).abs() <= 0.5 * step(0) + 2e-5);
            prop_assert!((read.velocity.unwrap() - velocity).abs() <= 0.5 * step(1) + 2e-5, "{:?}", protocol);
            prop_assert!((read.torque.unwrap() - torque).abs() <= 0.5 * profile.torque_resolution() + 1e-5);
            prop_assert!(matches!(protocol, Protocol::MiniCheetah(_)) || read.state == Some(state), "{:?}", protocol);
        }
    }
}

#[test]
fn torque_has_no_bias() {
    for (protocol, _) in PROTOCOLS {
        for torque in [0.0, 0.0013, -1.23456] {
            let (profile, mut carry, count) = (profile(protocol), Carry::default(), 4096);
            let command = motion([0.0, 0.0, torque, 0.0, 0.0]);
            let mut sum = 0.0;
            for _ in 0..count {
                match sent(&profile, &command, &mut carry) {
                    Some(Request::Command(read)) => sum += f64::from(read.torque),
                    other => panic!("{other:?}"),
                }
            }
            let mean = sum / f64::from(count);
            let bias = mean - f64::from(torque);
            assert!(bias.abs() < 1e-5, "{protocol:?}: {mean} of {torque}");
        }
    }
}

#[test]
fn full_scale_is_no_order() {
    let profile = DriveProfile {
        torque_limit: 10.0,
        sign: 1.0,
        zero: 0.0,
        ..profile(Protocol::Damiao(RANGES))
    };
    // The torques whose codes end in FC, FD and FE.
    for torque in [9.985_f32, 9.99, 9.995, 10.0] {
        let command = motion([99.0, 99.0, torque, 999.0, 99.0]);
        let request = sent(&profile, &command, &mut Carry::default());
        assert!(matches!(request, Some(Request::Command(_))), "{request:?}");
    }
}

#[test]
fn orders_and_scales_come_back() {
    use {Order::*, Scale::*};
    let orders = [Enable, Disable, ClearFault, SetZero, Report];
    let scales = [Position, Velocity, Torque].map(ReadScale);
    for (protocol, _) in PROTOCOLS {
        for order in orders.into_iter().chain(scales) {
            let (profile, mut frames) = (profile(protocol), Frames::new());
            if !profile.order(order, &mut frames) {
                assert!(![Enable, Disable].contains(&order), "{protocol:?}");
                continue;
            }
            // Polls of an ODrive that is switched on are another order.
            let own = frames
                .iter()
                .filter(|frame| !frame.remote || order == Report);
            let read = own.rev().find_map(|frame| profile.accept(frame));
            // moteus: mode 0 for both.
            let alike = matches!((protocol, order), (Protocol::Moteus(_), ClearFault));
            let wanted = Request::Order(if alike { Disable } else { order });
            assert_eq!(read, Some(wanted), "{protocol:?}");
            if let ReadScale(scale) = order {
                let mut frames = Frames::new();
                profile.reply_scale(scale, 12.0, &mut frames);
                let read = profile.decode(&frames[0]);
                assert_eq!(read, Some(Event::Scale(scale, 12.0)), "{protocol:?}");
            }
        }
    }
}

#[test]
fn states_of_a_cia402_drive_are_those_of_its_status_word() {
    use DriveState::{Disabled, Enabled, Fault, NotReady, SwitchedOn};
    let profile = profile(cia402(ControlMode::Position));
    let state = |frame: &Frame| match profile.decode(frame) {
        Some(Event::Reply(reply)) => reply.state,
        other => panic!("{other:?}"),
    };
    for (status, wanted) in [
        (0x0000_u16, NotReady),
        (0x1250, NotReady),
        (0x1231, Disabled),
        (0x1233, SwitchedOn),
        (0x1237, Enabled),
        (0x1217, NotReady),
        (0x1218, Fault(0x1218)),
    ] {
        let [low, high] = status.to_le_bytes();
        let frame = Frame::standard(0x183, &[low, high, 0, 0, 0, 0, 0, 0]);
        assert_eq!(state(&frame), Some(wanted), "{status:#x}");
    }
    for wanted in [NotReady, Disabled, SwitchedOn, Enabled, Fault(8)] {
        let (mut frames, state_given) = (Frames::new(), Some(wanted));
        let reply = JointReply {
            state: state_given,
            ..JointReply::default()
        };
        profile.reply(&reply, &mut frames);
        assert_eq!(state(&frames[0]), state_given);
    }
}

#[test]
fn a_finite_number_of_turns_is_no_infinite_angle() {
    // Found by the fuzzer: position or velocity near the largest f32.
    let huge = 3.0e38_f32;
    let estimates = [huge.to_le_bytes(), (-huge).to_le_bytes()].concat();
    let profile = profile(odrive(ControlMode::Velocity));
    let read = profile.decode(&Frame::standard(3 << 5 | 0x09, &estimates));
    assert_eq!(read, Some(Event::Reply(JointReply::default())));
    let command = Frame::standard(3 << 5 | 0x0d, &estimates);
    assert_eq!(profile.accept(&command), None);
}

#[test]
fn a_motor_without_a_sensor_hides_no_heat_of_its_drive() {
    let profile = profile(odrive(ControlMode::Velocity));
    for pair in [[105.0_f32, f32::NAN], [f32::NAN, 105.0], [105.0, 40.0]] {
        let data = pair.map(f32::to_le_bytes).concat();
        let read = profile.decode(&Frame::standard(3 << 5 | 0x15, &data));
        let reply = JointReply {
            temperature: Some(105.0),
            ..JointReply::default()
        };
        assert_eq!(read, Some(Event::Reply(reply)), "{pair:?}");
    }
}

#[test]
fn lines_of_text_come_back() {
    let bytes = [1, 0, 10, 7, 32, 0x88, 0x13, 0xa0, 0x0f, 0x7d, 0, 0x17, 1];
    let command = Frame::extended(0x8001, &bytes);
    let line = text::write_line(&command.into_fd(0x50), text::Direction::Send);
    // The line of the Python client moteus 1.1.1.
    let known = b"can send 8001 01000A07208813A00F7D001701505050 BF *18\n";
    assert_eq!(line, known);
    for frame in [
        command.into_fd(0x50),
        Frame::standard(0x100, &[1, 2]),
        Frame::extended(0x1fff_ffff, &[]),
        Frame::extended(0x7ff, &[3]),
        Frame::standard(0, &[7; 64]).into_fd(0),
    ] {
        for direction in [text::Direction::Send, text::Direction::Receive] {
            let line = text::write_line(&frame, direction);
            assert_eq!(text::read_line(&line), Some(frame));
            for place in 0..line.len() - 1 {
                let mut damaged = line.clone();
                damaged[place] ^= 1;
                let read = text::read_line(&damaged);
                // Without its `*` a line has no sum, but its frame is whole.
                assert!(read.is_none() || read == Some(frame), "{place}");
            }
        }
    }
    for bad in [
        "",
        "can",
        "can send",
        "can send g 00",
        "rcv 1 0",
        "rcv 1 000",
        "rcv 1 00 *00",
        "rcv 123456789 00",
        "OK",
    ] {
        assert_eq!(text::read_line(bad.as_bytes()), None, "{bad}");
    }
}

#[test]
fn profiles_that_contradict_themselves_are_refused() {
    let good = profile(Protocol::Damiao(RANGES));
    assert_eq!(good.check(), Ok(()));
    type Change = fn(&mut DriveProfile);
    let changes: [(Change, &str); 9] = [
        (|p| p.sign = 0.5, "size of sign"),
        (|p| p.sign = f32::NAN, "sign"),
        (|p| p.gear = 0.0, "gear"),
        (|p| p.torque_limit = 10.1, "torque_limit"),
        (|p| p.torque_limit = f32::NAN, "torque_limit"),
        (|p| p.id = 0, "id"),
        (
            |p| (p.protocol, p.id) = (Protocol::MiniCheetah(RANGES), 300),
            "id",
        ),
        (
            |p| (p.protocol, p.id) = (odrive(ControlMode::Position), 63),
            "id",
        ),
        (
            |p| p.protocol = Protocol::Damiao(Ranges { kd: 0.0, ..RANGES }),
            "kd",
        ),
    ];
    for (change, field) in changes {
        let mut profile = good;
        change(&mut profile);
        assert_eq!(profile.check().map_err(|error| error.field), Err(field));
    }
}
