//! The program with boards on a serial port and in the emulator, and its messages about boards it cannot use.

use crate::program::{directory, fails, files, states, succeeds, text, write};
use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque_link::wire::PROTOCOL_VERSION;
use foretorque_workbench::board::{Native, Transport};
use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// A board on a pseudo-terminal, until it goes out of scope.
struct PlayedBoard {
    port: String,
    done: Arc<AtomicBool>,
    player: Option<JoinHandle<()>>,
}

impl PlayedBoard {
    /// Lets `board` answer, every frame changed by `change` on its way to the host.
    fn start(mut board: impl Transport + Send + 'static, change: fn(&[u8]) -> Vec<u8>) -> Self {
        let (mut line, end) = TTYPort::pair().expect("the system has pseudo-terminals");
        let port = end.name().expect("it has a name");
        line.set_timeout(Duration::from_millis(5))
            .expect("it has a timeout");
        let done = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&done);
        let player = std::thread::spawn(move || {
            let mut buffer = [0; 1024];
            while !ended.load(Ordering::Relaxed) {
                // Nothing received, or no process at the other end yet.
                let Ok(count) = line.read(&mut buffer) else {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                };
                board.send(&buffer[..count]).expect("the board lives");
                let count = board
                    .receive(&mut buffer, Duration::ZERO)
                    .expect("the board lives");
                for frame in buffer[..count].split_inclusive(|&byte| byte == 0) {
                    // A host that has received enough hangs up.
                    let _ = line.write_all(&change(frame));
                }
            }
        });
        drop(end);
        Self {
            port,
            done,
            player: Some(player),
        }
    }
}

impl Drop for PlayedBoard {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        if let Some(player) = self.player.take() {
            let _ = player.join();
        }
    }
}

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
    let stderr = fails(
        &directory,
        &format!(
            "run --robot ur5 --board serial:{} --trajectory validation --out out",
            board.port
        ),
    );
    assert!(
        stderr.contains(&format!(
            "the board speaks protocol version {}, this program version {PROTOCOL_VERSION}",
            PROTOCOL_VERSION + 1
        )),
        "{stderr}"
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
    let stderr = fails(
        &directory,
        "run --robot ur5 --trajectory validation --out out --log board.log",
    );
    assert!(stderr.contains("--log: board native has none"), "{stderr}");
}
