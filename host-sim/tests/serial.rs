//! Boards on a pseudo-terminal: driven by the program, and read along.

use crate::{Directory, assert_contains, at_port, states};
use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque_link::wire::{BoardMessage, Field, FrameBuffer, TelemetryFrame};
use foretorque_workbench::board::{Native, Transport};
use serialport::TTYPort;
use std::io::{Read, Write};
use std::time::Duration;

/// Output of `work` with the port of a pseudo-terminal at which `board` answers.
pub(crate) fn with_board<T>(mut board: impl Transport + Send, work: impl FnOnce(&str) -> T) -> T {
    let mut buffer = [0; 1024];
    let answer = |line: &mut TTYPort| {
        // Nothing received, or no process at the other end yet.
        let Ok(count) = line.read(&mut buffer) else {
            std::thread::sleep(Duration::from_millis(1));
            return;
        };
        board.send(&buffer[..count]).expect("the board lives");
        let count = board.receive(&mut buffer, Duration::ZERO);
        let count = count.expect("the board lives");
        // A host that has received enough hangs up.
        let _ = line.write_all(&buffer[..count]);
    };
    at_port(answer, work)
}

pub(crate) fn ur5() -> Native<Ur5, 6, 40> {
    Native::new().expect("the arm's limits are usable")
}

#[test]
fn a_board_that_drives_another_robot_is_refused() {
    let here = Directory::new("other-robot");
    here.write("states.csv", states(6));
    let panda = Native::<Panda, 7, 48>::new().expect("the arm's limits are usable");
    with_board(panda, |port| {
        let board = format!("--board serial:{port} --in states.csv --out tau.csv");
        let (panda, ur5) = (Panda::HASH, Ur5::HASH);
        let reason = format!("the board drives panda ({panda:08x}, 7 joints), not ur5 ({ur5:08x})");
        here.refused(format!("torque --robot ur5 {board}"), reason);
    });
    assert_eq!(here.files("."), ["states.csv"]);
}

#[test]
fn a_board_on_a_serial_port_computes_torque() {
    let here = Directory::new("serial");
    here.write("states.csv", states(6));
    let torque = "torque --robot ur5 --in states.csv --out";
    with_board(ur5(), |port| {
        here.succeeds(format!("{torque} tau.csv --board serial:{port}"))
    });
    here.succeeds(format!("{torque} native.csv"));
    let [serial, native] = ["tau.csv", "native.csv"].map(|name| here.text(name));
    assert!(serial == native, "the port changes nothing");
}

#[test]
fn a_line_is_read_along_without_a_byte_sent() {
    let here = Directory::new("record");
    let (mut tick, mut received) = (0, 0);
    let answer = |line: &mut TTYPort| {
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
        let record = BoardMessage::<6>::Telemetry(record);
        frame.push(0, &record).expect("it fits");
        let _ = line.write_all(frame.as_bytes());
        received += line.read(&mut [0; 64]).unwrap_or(0);
        std::thread::sleep(Duration::from_millis(10));
    };
    let record = |port: &str| format!("record --board serial:{port} --duration-s 2 --out");
    let (port, shown) = at_port(answer, |port| {
        let shown = here.succeeds(format!("{} telemetry.csv", record(port)));
        (port.to_owned(), shown)
    });
    assert_eq!(received, 0, "bytes were sent");
    assert_contains(&shown, " records, 0 left out");
    let table = here.text("telemetry.csv");
    let mut lines = table.lines();
    let header = "t_s,total1_nm,total2_nm,total3_nm,total4_nm,total5_nm,total6_nm";
    assert_eq!(lines.next(), Some(header));
    let row = lines.next().expect("a record");
    assert!(row.ends_with(",1.5,2,2.5,3,3.5,4"), "{row}");
    here.refused(format!("{} silent.csv", record(&port)), &port);
    assert_eq!(here.files("."), ["telemetry.csv", "telemetry.mcap"]);
}
