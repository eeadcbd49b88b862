//! The board in line: between a host and six drives, and between moteus' own client and one moteus.

use super::{ACKNOWLEDGEMENT, Emulated, FrameBoard, Ported, Twin, connected, profile, wiring};
use foretorque::arm::ur5::JOINTS;
use foretorque::joint::JointSample;
use foretorque_link::bus::{BusJoint, Role, Wires, Wiring};
use foretorque_link::drives::text::{Direction, read_line, write_line};
use foretorque_link::drives::{
    Carry, DriveProfile, DriveState, Frame, Frames, JointCommand, JointReply, Moteus, Protocol,
    Request, Resolution,
};
use foretorque_link::safety::SafetyState;
use foretorque_workbench::board::Client;
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::{Joints, State};
use std::cell::RefCell;
use std::io::{Read, Write};
use std::process::{Command, Stdio};
use std::rc::Rc;
use std::time::Duration;

/// Frames of one period on a line: commands of a host, replies, and frames of no drive.
fn traffic(wiring: &Wiring<JOINTS>, period: u32) -> Ported {
    let mut ported = Vec::new();
    let mut frames = Frames::new();
    let q = |joint: usize| 0.1 * (0.02 * f64::from(period) + joint as f64).sin() as f32;
    for (index, joint) in wiring.joints.iter().flatten().enumerate() {
        let command = JointCommand {
            position: q(index),
            kp: joint.kp,
            kd: joint.kd,
            ..JointCommand::default()
        };
        frames.clear();
        joint
            .drive
            .command(&command, &mut Carry::default(), &mut frames);
        ported.extend(frames.iter().map(|frame| (0, *frame)));
        let foreign = [period as u8, index as u8, 0xff, 0xff];
        ported.push((0, Frame::standard(0x300 + index as u32, &foreign)));
        ported.push((1, Frame::extended(0x1234_5600 + period, &foreign)));
        frames.clear();
        let reply = JointReply {
            position: Some(q(index)),
            torque: Some(0.3 * q(index)),
            state: Some(DriveState::Enabled),
            ..JointReply::default()
        };
        joint.drive.reply(&reply, &mut frames);
        ported.extend(frames.iter().map(|frame| (1, *frame)));
    }
    ported
}

/// Frames that came in each period, and those that left for it.
type Rounds = Vec<(Ported, Ported)>;

/// The client of a board in line: each sample of the host begins with a period of traffic, after a `change` of it that says
/// whether the sample reaches the board.
fn on_line<B: FrameBoard + 'static>(
    board: B,
    wiring: &Wiring<JOINTS>,
    rounds: &Rc<RefCell<Rounds>>,
    mut change: impl FnMut(&mut B, usize, &mut Ported) -> bool + 'static,
) -> Client<JOINTS> {
    let (wiring, rounds) = (wiring.clone(), Rc::clone(rounds));
    connected(board, move |board| {
        let mut rounds = rounds.borrow_mut();
        let mut came = traffic(&wiring, rounds.len() as u32);
        let passes = change(board, rounds.len(), &mut came);
        board.deliver(&came);
        rounds.push((came, board.left()));
        passes
    })
}

fn drives(wiring: &Wiring<JOINTS>) -> Vec<DriveProfile> {
    let joints = wiring.joints.iter().flatten();
    joints.map(|joint| joint.drive).collect()
}

fn of_port(frames: &Ported, port: u8) -> Vec<Frame> {
    let of = frames.iter().filter(|(at, _)| *at == port);
    of.map(|(_, frame)| *frame).collect()
}

/// Every frame that came with the one that left for it at the other port: period, port, both frames.
fn passed(rounds: &Rounds) -> Vec<(usize, u8, Frame, Frame)> {
    let mut passed = Vec::new();
    for (period, (came, left)) in rounds.iter().enumerate() {
        for port in 0..2 {
            let (came, left) = (of_port(came, port), of_port(left, 1 - port));
            assert_eq!(came.len(), left.len(), "period {period}");
            let pairs = came.into_iter().zip(left);
            passed.extend(pairs.map(|(came, left)| (period, port, came, left)));
        }
    }
    passed
}

/// The command to this drive in a frame.
fn command(drive: &DriveProfile, frame: &Frame) -> Option<JointCommand> {
    match drive.accept(frame) {
        Some(Request::Command(command)) => Some(command),
        _ => None,
    }
}

/// Arms a board in line and stops it again; the frames that have left. Only torques of commands differ, by the board's.
fn pass(board: impl FrameBoard + 'static, wiring: &Wiring<JOINTS>) -> Rounds {
    let rounds = Rc::new(RefCell::new(Rounds::new()));
    let mut client = on_line(board, wiring, &rounds, |_, _, _| true);
    // The motion that passes takes the place of this one.
    let idle = idle();
    let mut torques = std::collections::BTreeMap::new();
    for period in 0..60 {
        let reply = client.sample(&idle).expect("a torque");
        if reply.safety.state == SafetyState::Armed {
            torques.insert(rounds.borrow().len(), reply.total);
        }
        match period {
            20 => client.arm(&idle).expect("it can be armed"),
            45 => {
                torques.remove(&rounds.borrow().len());
                client.stop().expect("it obeys");
            }
            _ => {}
        }
    }
    assert!(torques.len() > 20 && torques.values().any(|torque| torque.amax() > 10.0));
    let drives = drives(wiring);
    let rounds = rounds.borrow().clone();
    let mut changed = 0;
    for (period, port, came, left) in passed(&rounds) {
        let joint = drives
            .iter()
            .position(|drive| port == 0 && command(drive, &came).is_some());
        let Some((joint, torque)) = joint.zip(torques.get(&period)) else {
            assert_eq!(came, left, "period {period}");
            continue;
        };
        let seen = command(&drives[joint], &left).expect("a command stays one");
        let error = (seen.torque - torque[joint]).abs();
        let near = error <= 2.0 * drives[joint].torque_resolution();
        assert!(near, "period {period}, joint {joint}: {seen:?}, {torque}");
        changed += u32::from(came != left);
    }
    assert!(changed > 60, "{changed} commands changed");
    rounds
}

fn idle() -> JointSample<JOINTS> {
    JointSample {
        desired: motion_f32(&State::rest(Joints::zeros())),
        measured: None,
    }
}

#[test]
fn a_board_in_line_adds_its_torque_to_commands_alone() {
    let mut profile = profile(500.0);
    // One bus carries all.
    profile.joint.iter_mut().for_each(|joint| joint.bus = 0);
    let wiring = wiring(&profile, Role::InLine);
    let twin = pass(Twin::new(&wiring), &wiring);
    let emulated = pass(Emulated::start("in-line", Some(&wiring)), &wiring);
    for (period, ((_, one), (_, other))) in twin.iter().zip(&emulated).enumerate() {
        for port in 0..2 {
            let same = of_port(one, port) == of_port(other, port);
            assert!(same, "period {period}");
        }
    }
}

#[test]
fn a_board_without_a_wiring_passes_every_frame_and_refuses_to_arm() {
    let wiring = wiring(&profile(500.0), Role::InLine);
    let mut board = Emulated::start("no-wiring", None);
    for period in 0..5 {
        let sent = traffic(&wiring, period);
        board.deliver(&sent);
        let pairs = passed(&vec![(sent, board.left())]);
        assert!(pairs.iter().all(|(_, _, sent, left)| sent == left));
    }
    let mut client = connected(board, |_| true);
    let refused = client.arm(&idle()).expect_err("there are no drives");
    assert!(refused.to_string().contains("drive fault"), "{refused}");
}

/// Faults of a board in line and of what is around it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    NotArmed,
    Stopped,
    Disarmed,
    /// Ticks end; frames and time go on.
    Hung,
    /// The host sends no command for 110 ms.
    HostSilent,
    /// One drive does not reply any more.
    DriveSilent,
    /// No frame comes from the drives: their bus is off.
    DrivesOff,
    /// The commanded position of a joint jumps by 1 rad.
    Jump,
    Reports(DriveState),
    StuckReply,
    WrongIdentifier,
    /// The frames of a foreign node fill the drives' side.
    Babble,
}

/// Period of 1 ms in which the fault begins, that from which on every frame passes unchanged, and the last one.
const FAULT: [usize; 3] = [60, 170, 260];

impl Fault {
    /// Changes the traffic of a period after the begin of the fault.
    fn disturb(self, drives: &[DriveProfile], period: usize, came: &mut Ported) {
        let is_command = |frame: &Frame| drives.iter().any(|drive| command(drive, frame).is_some());
        match self {
            Self::HostSilent if period < FAULT[0] + 110 => {
                came.retain(|(port, frame)| *port == 1 || !is_command(frame));
            }
            Self::DriveSilent => {
                came.retain(|(port, frame)| *port == 0 || drives[2].decode(frame).is_none());
            }
            Self::DrivesOff => came.retain(|(port, _)| *port == 0),
            Self::Reports(_) | Self::StuckReply | Self::WrongIdentifier => {
                let (state, by) = match self {
                    Self::Reports(state) => (state, 2),
                    Self::WrongIdentifier => (DriveState::Enabled, 3),
                    _ => (DriveState::Enabled, 2),
                };
                let reply = JointReply {
                    position: Some(0.0),
                    torque: Some(0.0),
                    state: Some(state),
                    ..JointReply::default()
                };
                let mut frames = Frames::new();
                drives[by].reply(&reply, &mut frames);
                for (port, frame) in came {
                    if *port == 1 && drives[2].decode(frame).is_some() {
                        *frame = frames[0];
                    }
                }
            }
            Self::Babble => {
                came.retain(|(port, _)| *port == 0);
                came.extend([(1, Frame::standard(0, &[0; 8])); 12]);
            }
            Self::Jump => {
                let jump = JointCommand {
                    position: 1.0,
                    ..JointCommand::default()
                };
                let mut frames = Frames::new();
                drives[1].command(&jump, &mut Carry::default(), &mut frames);
                for (port, frame) in came {
                    if *port == 0 && command(&drives[1], frame).is_some() {
                        *frame = frames[0];
                    }
                }
            }
            _ => {}
        }
    }
}

#[test]
fn every_fault_in_line_leaves_a_board_that_passes_frames() {
    let mut profile = profile(500.0);
    profile.joint.iter_mut().for_each(|joint| joint.bus = 0);
    let wiring = wiring(&profile, Role::InLine);
    for fault in [
        Fault::NotArmed,
        Fault::Stopped,
        Fault::Disarmed,
        Fault::Hung,
        Fault::HostSilent,
        Fault::DriveSilent,
        Fault::DrivesOff,
        Fault::Jump,
        Fault::Reports(DriveState::Fault(9)),
        Fault::Reports(DriveState::Disabled),
        Fault::StuckReply,
        Fault::WrongIdentifier,
        Fault::Babble,
    ] {
        let rounds = Rc::new(RefCell::new(Rounds::new()));
        let of_wiring = drives(&wiring);
        let mut client = on_line(
            Twin::new(&wiring),
            &wiring,
            &rounds,
            move |board, period, came| {
                board.now += 1;
                let begun = period >= FAULT[0];
                if begun {
                    fault.disturb(&of_wiring, period, came);
                }
                !begun || fault != Fault::Hung
            },
        );
        client.timeout = Duration::from_millis(1);
        let idle = idle();
        while rounds.borrow().len() < FAULT[2] {
            // A board that hangs does not answer.
            let _ = client.sample(&idle);
            let period = rounds.borrow().len();
            match (period, fault) {
                (20, Fault::NotArmed) => {}
                (20, _) => client.arm(&idle).expect("it can be armed"),
                (60, Fault::Stopped) => client.stop().expect("it obeys"),
                (60, Fault::Disarmed) => client.disarm().expect("it obeys"),
                _ => {}
            }
        }
        let (mut changed, mut last) = (0, 0);
        for (period, port, came, left) in passed(&rounds.borrow()) {
            if came == left {
                continue;
            }
            let of_drive = drives(&wiring)
                .iter()
                .any(|drive| command(drive, &came).is_some() && command(drive, &left).is_some());
            let sound = port == 0 && of_drive;
            assert!(sound, "{fault:?}, period {period}: {came:?} {left:?}");
            (changed, last) = (changed + 1, period);
        }
        println!("{fault:?}: {changed} commands with torque, the last in period {last}");
        let armed = fault != Fault::NotArmed;
        assert_eq!(changed > 100, armed, "{fault:?}: {changed}");
        assert!(last < FAULT[1], "{fault:?}: torque in period {last}");
    }
}

/// Drives one moteus by its own client, through the board.
const MOTEUS_CLIENT: &str = include_str!("moteus_client.py");

#[test]
fn the_client_of_moteus_drives_its_motor_through_the_board() {
    let Some(python) = crate::python::with("moteus") else {
        return;
    };
    let drive = DriveProfile {
        protocol: Protocol::Moteus(Moteus {
            kp: 4.0,
            kd: 0.05,
            watchdog_s: 0.1,
            resolution: Resolution::F32,
        }),
        id: 1,
        host_id: 0,
        sign: 1.0,
        zero: 0.0,
        gear: 1.0,
        torque_limit: 5.0,
    };
    let mut wiring = wiring(&profile(500.0), Role::InLine);
    wiring.wires = Wires::Uart;
    for (joint, slot) in wiring.joints.iter_mut().enumerate() {
        let only = slot.map(|slot| BusJoint {
            drive,
            bus: 0,
            ..slot
        });
        *slot = only.filter(|_| joint == 0);
    }
    let mut board = Emulated::start("moteus", Some(&wiring));
    let [host, motor] = &mut board.ports;
    let (mut near, far) = serialport::TTYPort::pair().expect("the system has pseudo-terminals");
    let path = serialport::SerialPort::name(&far).expect("it has a name");
    serialport::SerialPort::set_timeout(&mut near, Duration::from_millis(1)).expect("it can");
    let mut client = Command::new(&python)
        .args(["-c", MOTEUS_CLIENT, &path])
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let deadline = std::time::Instant::now() + Duration::from_secs(60);
    let (mut taken, mut buffer) = (0, [0; 512]);
    host.stream.set_nonblocking(true).expect("it can");
    while client.try_wait().expect("it is ours").is_none() {
        let in_time = std::time::Instant::now() < deadline;
        assert!(in_time, "{taken} commands came");
        if let Ok(count) = near.read(&mut buffer) {
            host.stream.set_nonblocking(false).expect("it can");
            host.stream.write_all(&buffer[..count]).expect("it listens");
            host.stream.set_nonblocking(true).expect("it can");
        }
        for line in motor.lines(false) {
            let Some(frame) = read_line(&line) else {
                // Both ports acknowledge in the emulator.
                assert_eq!(line, ACKNOWLEDGEMENT);
                continue;
            };
            let Some(request) = drive.accept(&frame) else {
                panic!("{frame:?}");
            };
            let mut replies = Frames::new();
            let mut reply = JointReply {
                state: Some(DriveState::Enabled),
                ..JointReply::default()
            };
            if let Request::Command(command) = request {
                taken += 1;
                reply.position = Some(command.position);
                reply.torque = Some(command.torque);
            }
            drive.reply(&reply, &mut replies);
            for reply in &replies {
                let line = write_line(reply, Direction::Receive);
                motor.stream.write_all(&line).expect("it listens");
            }
        }
        if let Ok(count) = host.stream.read(&mut buffer) {
            near.write_all(&buffer[..count]).expect("it listens");
        }
    }
    let mut text = String::new();
    let mut output = client.stdout.take().expect("it is piped");
    output.read_to_string(&mut text).expect("it is text");
    assert_eq!((text.lines().count(), taken), (20, 20), "{text}");
    for line in text.lines() {
        let words = line.split(' ').map(|word| word.parse::<f64>());
        let row: Vec<f64> = words.collect::<Result<_, _>>().expect(line);
        assert_eq!((row[0], row[1]), (10.0, 0.5));
        // Not armed: the torque of the client alone.
        assert!((row[2] - 0.25).abs() < 1e-6, "{line}");
    }
    drop(far);
}
