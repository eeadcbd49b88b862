//! moteus' own client, and one moteus, with the board between them.

use super::{ACKNOWLEDGEMENT, Emulated, profile, wiring};
use foretorque_link::bus::{BusJoint, Role, Wires};
use foretorque_link::drives::text::{Direction, read_line, write_line};
use foretorque_link::drives::{
    DriveProfile, DriveState, Frames, JointReply, Moteus, Protocol, Request, Resolution,
};
use std::io::{Read, Write};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Talks to one moteus by its own client, through the board.
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
        assert!(
            std::time::Instant::now() < deadline,
            "{taken} commands came"
        );
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
    let rows: Vec<Vec<f64>> = text
        .lines()
        .map(|line| {
            line.split(' ')
                .map(|word| word.parse().expect(line))
                .collect()
        })
        .collect();
    assert_eq!((rows.len(), taken), (20, 20), "{text}");
    for row in rows {
        assert_eq!((row[0], row[1]), (10.0, 0.5));
        assert!(
            (row[2] - 0.25).abs() < 1e-6,
            "not armed: the torque of the client alone"
        );
    }
    drop(far);
}
