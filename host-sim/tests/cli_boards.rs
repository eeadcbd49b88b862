//! The program with boards on a serial port and in the emulator, and its messages about boards it cannot use.

use crate::program::PlayedBoard;
use crate::program::{directory, fails, files, refused, states, succeeds, text, write};
use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque_link::wire::{BoardMessage, Field, FrameBuffer, PROTOCOL_VERSION, TelemetryFrame};
use foretorque_workbench::board::Native;
use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The frame as a board of the next protocol version would send it.
fn of_the_next_version(frame: &[u8]) -> Vec<u8> {
    let mut payload = [0; 300];
    let Some(length) = cobs::decode(frame, &mut payload)
        .ok()
        .filter(|&length| length > 4)
    else {
        return frame.to_vec();
    };
    payload[0] += 1;
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&payload[..length - 4]);
    payload[length - 4..length].copy_from_slice(&crc.to_le_bytes());
    let mut changed = vec![0; 300];
    let length = cobs::encode(&payload[..length], &mut changed);
    changed.truncate(length);
    changed.push(0);
    changed
}

#[test]
fn a_board_that_drives_another_robot_is_refused() {
    let directory = directory("other-robot");
    write(directory.join("states.csv"), states(6));
    let native = Native::<Panda, 7, 48>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native, <[u8]>::to_vec);
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
    let board = PlayedBoard::start(native, <[u8]>::to_vec);
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
fn a_board_of_another_protocol_version_is_refused() {
    let directory = directory("other-version");
    let native = Native::<Ur5, 6, 40>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native, of_the_next_version);
    refused(
        &directory,
        &format!(
            "run --robot ur5 --board serial:{} --trajectory validation --out out",
            board.port
        ),
        format!(
            "the board speaks protocol version {}, this program version {PROTOCOL_VERSION}",
            PROTOCOL_VERSION + 1
        ),
    );
    assert_eq!(files(&directory), Vec::<String>::new());
}

#[test]
fn the_emulated_board_says_that_it_drives_another_robot() {
    let directory = directory("emulated-panda");
    write(directory.join("states.csv"), states(7));
    for board in ["qemu", "qemu-usart"] {
        let stderr = fails(
            &directory,
            &format!("torque --robot panda --board {board} --in states.csv --out tau.csv"),
        );
        assert!(stderr.contains("the board drives ur5"), "{stderr}");
        assert!(stderr.contains("not panda"), "{stderr}");
    }
    assert_eq!(files(&directory), ["states.csv"]);
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
    refused(
        &directory,
        "run --robot ur5 --trajectory validation --out out --log board.log",
        "--log: board native has none",
    );
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
