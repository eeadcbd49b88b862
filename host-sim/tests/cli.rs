//! The program as its users call it: what it makes, with every board, and the one line it gives when it cannot.

use crate::program::{
    PlayedBoard, directory, fails, files, json, refused, states, succeeds, text, write,
};
use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMotion, JointVector};
use foretorque_link::wire::{BoardMessage, Field, FrameBuffer, TelemetryFrame};
use foretorque_workbench::board::Native;
use serialport::{SerialPort, TTYPort};
use std::fs;
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

#[test]
fn torque_is_that_of_the_firmware_for_every_arm_it_knows() {
    fn check<A: Arm<N, P>, const N: usize, const P: usize>() {
        let directory = directory(&format!("torque-{}", A::NAME));
        write(directory.join("states.csv"), states(N));
        succeeds(
            &directory,
            &format!("torque --robot {} --in states.csv --out tau.csv", A::NAME),
        );
        let table = text(directory.join("tau.csv"));
        let rows: Vec<&str> = table.lines().skip(1).collect();
        assert_eq!(rows.len(), 2);
        let beta = nalgebra::SVector::from(A::NOMINAL);
        for (row, value) in rows.iter().zip([0.25, -0.5]) {
            let all = JointVector::<N>::repeat(value);
            let motion = JointMotion {
                q: all,
                qd: all,
                qdd: all,
            };
            let wanted = foretorque::dynamics::rnea::<A, N, P>(&beta, &motion);
            let torque: Vec<f32> = row
                .split(',')
                .map(|tau| tau.parse().expect("a number"))
                .collect();
            assert_eq!(torque, wanted.as_slice(), "{} at {value}", A::NAME);
        }
    }
    check::<Ur5, 6, 40>();
    check::<Panda, 7, 48>();
}

#[test]
fn an_arm_of_seven_joints_runs_in_a_closed_loop_and_learns() {
    let directory = directory("panda-run");
    succeeds(
        &directory,
        "run --robot panda --trajectory validation --duration-s 0.5 --learn --out out",
    );
    let report = json(directory.join("out/report.json"));
    assert_eq!(report["robot"], "panda");
    assert_eq!(report["ticks"], 500);
    assert_eq!(
        report["tracking_rms_joint_mrad"].as_array().map(Vec::len),
        Some(7)
    );
    let stderr = succeeds(&directory, "bank out/bank.bin");
    assert!(
        stderr.contains("usable    yes, on a board that drives panda"),
        "{stderr}"
    );
}

#[test]
fn an_arm_of_more_torque_than_a_sample_carries_sends_currents() {
    let directory = directory("heavy-run");
    let ur5 = include_str!("../robots/ur5.toml");
    let heavy = ur5.replacen("-9.81]", "-196.2]", 1);
    assert_ne!(heavy, ur5);
    write(directory.join("heavy.toml"), heavy);
    let run = "run --robot heavy.toml --torque-limits 3000 --trajectory validation --duration-s 0.5 --learn --out out";
    let stderr = fails(&directory, &format!("{run} --drive-gains 1"));
    assert!(
        stderr.contains(
            "3000 N·m at 1 N·m/A is more than the 512 A that a sample carries: give --drive-gains"
        ),
        "{stderr}"
    );
    succeeds(&directory, &format!("{run} --drive-gains 10"));
    let report = json(directory.join("out/report.json"));
    let torque = report["feed_forward_rms_nm"].as_array().expect("torques");
    assert!(torque[1].as_f64() > Some(520.0), "{torque:?}");
    assert!(
        report["flag_ticks"].get("no_measurement").is_none(),
        "{report}"
    );
}

#[test]
fn a_described_robot_has_an_arm() {
    let directory = directory("no-arm");
    let ur5 = include_str!("../robots/ur5.toml");
    let other = ur5.replacen("name = \"ur5\"", "name = \"ur99\"", 1);
    write(directory.join("other.toml"), other);
    write(directory.join("states.csv"), states(6));
    // Read at run time: the arm of another name has the torques of the built-in one.
    for (robot, out) in [("other.toml", "other.csv"), ("ur5", "ur5.csv")] {
        succeeds(
            &directory,
            &format!("torque --robot {robot} --in states.csv --out {out}"),
        );
    }
    let read = |name| text(directory.join(name));
    assert_eq!(read("other.csv"), read("ur5.csv"));
}

#[test]
fn a_path_of_the_tool_is_played_wherever_a_trajectory_is() {
    let directory = directory("tool-path");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("paths/ur5.toml");
    fs::copy(&path, directory.join("path.toml")).expect("copies");
    succeeds(
        &directory,
        "torque --robot ur5 --trajectory path.toml --out tau.csv",
    );
    let rows = text(directory.join("tau.csv"));
    assert_eq!(rows.lines().count(), 8502, "8.5 s, a row each millisecond");
    for command in ["simulate --out log.csv", "run --out out"] {
        let played = "--robot ur5 --trajectory path.toml --duration-s 0.2";
        succeeds(&directory, &format!("{command} {played}"));
    }
    let far = text(&path).replace("-0.5, -0.05, 0.3", "-1.5, -0.05, 0.3");
    write(directory.join("far.toml"), far);
    for command in ["torque --out x.csv", "simulate --out x.csv", "run --out x"] {
        let stderr = fails(
            &directory,
            &format!("{command} --robot ur5 --trajectory far.toml"),
        );
        let waypoint =
            "far.toml: move 3 (via), point 2, tool at (-1.500, -0.050, 0.300) m: out of reach";
        assert!(stderr.contains(waypoint), "{stderr}");
    }
    assert!(!files(&directory).iter().any(|name| name.starts_with('x')));
}

#[test]
fn a_board_that_drives_another_robot_is_refused() {
    let directory = directory("other-robot");
    write(directory.join("states.csv"), states(6));
    let native = Native::<Panda, 7, 48>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native);
    let stderr = fails(
        &directory,
        &format!(
            "torque --robot ur5 --board serial:{} --in states.csv --out tau.csv",
            board.port
        ),
    );
    let wanted = format!(
        "the board drives panda ({:08x}, 7 joints), not ur5 ({:08x})",
        Panda::HASH,
        Ur5::HASH
    );
    assert!(stderr.contains(&wanted), "{stderr}");
    assert_eq!(files(&directory), ["states.csv"]);
}

#[test]
fn a_board_on_a_serial_port_computes_torque() {
    let directory = directory("serial");
    write(directory.join("states.csv"), states(6));
    let native = Native::<Ur5, 6, 40>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native);
    succeeds(
        &directory,
        &format!(
            "torque --robot ur5 --board serial:{} --in states.csv --out tau.csv",
            board.port
        ),
    );
    succeeds(
        &directory,
        "torque --robot ur5 --in states.csv --out native.csv",
    );
    let [serial, native] = ["tau.csv", "native.csv"].map(|name| text(directory.join(name)));
    assert!(serial == native, "the port changes nothing");
}

#[test]
fn the_log_of_the_flashable_firmware_is_text() {
    let directory = directory("log");
    succeeds(
        &directory,
        "run --robot ur5 --board qemu-usart --trajectory validation --duration-s 1.2 --out out --log logs/board.log",
    );
    let log = text(directory.join("logs/board.log"));
    let hello = format!(
        "info: hello: arm ur5 {:#x}, Instructions counter, Configuration {{ period_us: 1000, pacing: Link, reply: Decimated, brake_close_ms: 0 }}",
        Ur5::HASH
    );
    let lines: Vec<&str> = log.lines().collect();
    assert_eq!(
        lines[0],
        "info: boot: odrive-v3, clock Virtual at 168000000 Hz, started by Unknown, left before by None at 0x0"
    );
    assert!(lines[1].starts_with("info: store: "), "{log}");
    assert!(lines[2].starts_with(&hello), "{log}");
    assert!(
        lines[2].ends_with(" counts (0 us) from clock to hello"),
        "{log}"
    );
    assert!(lines[3].starts_with("info: tick 1"), "{log}");
    assert!(
        lines[3].ends_with(" 0 lost, 0 overruns, 0 ticks missed"),
        "{log}"
    );
    assert_eq!(lines.len(), 4);
    assert_eq!(files(&directory), ["logs", "out"]);
    assert_eq!(files(&directory.join("logs")), ["board.log"]);
}

#[test]
fn a_line_is_read_along_without_a_byte_sent() {
    let directory = directory("record");
    let (mut board, end) = TTYPort::pair().expect("the system has pseudo-terminals");
    let port = end.name().expect("it has a name");
    drop(end);
    let done = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&done);
    let speaker = std::thread::spawn(move || {
        let mut tick = 0_u32;
        let mut received = 0;
        board
            .set_timeout(Duration::from_millis(1))
            .expect("it has a timeout");
        while !ended.load(Ordering::Relaxed) {
            tick += 10;
            let mut record = TelemetryFrame {
                tick,
                fields: Field::Total.bit(),
                bytes: Default::default(),
            };
            for value in [1.5_f32, 2.0, 2.5, 3.0, 3.5, 4.0] {
                let bytes = value.to_le_bytes();
                record.bytes.extend_from_slice(&bytes).expect("short");
            }
            let mut frame = FrameBuffer::new();
            frame
                .push(0, &BoardMessage::<6>::Telemetry(record))
                .expect("it fits");
            let _ = board.write_all(frame.as_bytes());
            received += board.read(&mut [0; 64]).unwrap_or(0);
            std::thread::sleep(Duration::from_millis(10));
        }
        received
    });
    let stdout = succeeds(
        &directory,
        &format!("record --board serial:{port} --duration-s 2 --out telemetry.csv"),
    );
    done.store(true, Ordering::Relaxed);
    assert_eq!(speaker.join().expect("it ends"), 0, "bytes were sent");
    assert!(stdout.contains(" records, 0 left out"), "{stdout}");
    assert_eq!(files(&directory), ["telemetry.csv", "telemetry.mcap"]);
    let table = text(directory.join("telemetry.csv"));
    let mut lines = table.lines();
    assert_eq!(
        lines.next(),
        Some("t_s,total1_nm,total2_nm,total3_nm,total4_nm,total5_nm,total6_nm")
    );
    let row = lines.next().expect("a record");
    assert!(row.ends_with(",1.5,2,2.5,3,3.5,4"), "{row}");
    refused(
        &directory,
        &format!("record --board serial:{port} --duration-s 0.2 --out silent.csv"),
        &port,
    );
    assert_eq!(files(&directory), ["telemetry.csv", "telemetry.mcap"]);
}
