//! The program as its users call it: what it makes, and the one line it gives when it cannot.

use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::edge::wire::PROTOCOL_VERSION;
use foretorque::joint::{JointMotion, JointVector};
use host_sim::board::{Native, Transport};
use serialport::{SerialPort, TTYPort};
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// An empty directory for one test.
fn room(name: &str) -> PathBuf {
    let room = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-{name}"));
    let _ = fs::remove_dir_all(&room);
    fs::create_dir_all(&room).expect("the directory of the tests can be written");
    room
}

fn host_sim(room: &Path, arguments: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command.current_dir(room).args(arguments.split_whitespace());
    command.output().expect("the program starts")
}

fn succeeds(room: &Path, arguments: &str) -> String {
    let output = host_sim(room, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "`{arguments}` said {said}");
    String::from_utf8(output.stdout).expect("it speaks UTF-8")
}

/// The one line that the program fails with.
fn fails(room: &Path, arguments: &str) -> String {
    let output = host_sim(room, arguments);
    let said = String::from_utf8(output.stderr).expect("it speaks UTF-8");
    assert_eq!(output.status.code(), Some(1), "`{arguments}` said {said}");
    assert!(said.starts_with("error: "), "{said}");
    assert_eq!(said.lines().count(), 1, "one line: {said}");
    said
}

/// What lies in a directory.
fn files(room: &Path) -> Vec<String> {
    let entries = fs::read_dir(room).expect("it is there");
    let name = |entry: std::io::Result<fs::DirEntry>| entry.expect("it is there").file_name();
    entries
        .map(|entry| name(entry).to_string_lossy().into_owned())
        .collect()
}

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
                // Nothing to hear, or nobody at the other end yet.
                let Ok(count) = line.read(&mut buffer) else {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                };
                board.send(&buffer[..count]).expect("the board lives");
                let count = board
                    .receive(&mut buffer, Duration::ZERO)
                    .expect("the board lives");
                for frame in buffer[..count].split_inclusive(|&byte| byte == 0) {
                    // A host that has heard enough hangs up.
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

/// Two states of an arm of `joints` joints.
fn states(joints: usize) -> String {
    let columns = |name: &str, unit: &str| -> Vec<String> {
        (1..=joints)
            .map(|joint| format!("{name}{joint}_{unit}"))
            .collect()
    };
    let header = [
        columns("q", "rad"),
        columns("qd", "rad_s"),
        columns("qdd", "rad_s2"),
    ];
    let row = |value: f64| vec![value.to_string(); 3 * joints].join(",");
    format!(
        "{}\n{}\n{}\n",
        header.concat().join(","),
        row(0.25),
        row(-0.5)
    )
}

#[test]
fn torque_is_that_of_the_firmware_for_every_arm_it_knows() {
    fn check<A: Arm<N, P>, const N: usize, const P: usize>() {
        let room = room(&format!("torque-{}", A::NAME));
        fs::write(room.join("states.csv"), states(N)).expect("it can be written");
        succeeds(
            &room,
            &format!("torque --robot {} --in states.csv --out tau.csv", A::NAME),
        );
        let table = fs::read_to_string(room.join("tau.csv")).expect("it was written");
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
    let room = room("panda-run");
    succeeds(
        &room,
        "run --robot panda --trajectory validation --duration-s 0.5 --learn --out out",
    );
    let report = fs::read_to_string(room.join("out/report.json")).expect("it was written");
    let report: serde_json::Value = serde_json::from_str(&report).expect("it is JSON");
    assert_eq!(report["robot"], "panda");
    assert_eq!(report["ticks"], 500);
    assert_eq!(
        report["tracking_rms_joint_mrad"].as_array().map(Vec::len),
        Some(7)
    );
    let said = succeeds(&room, "bank out/bank.bin");
    assert!(
        said.contains("usable    yes, on a board that drives panda"),
        "{said}"
    );
}

#[test]
fn a_robot_without_an_arm_in_the_firmware_is_refused_by_name() {
    let room = room("no-arm");
    let ur5 = include_str!("../robots/ur5.toml");
    let other = ur5.replacen("name = \"ur5\"", "name = \"ur99\"", 1);
    fs::write(room.join("other.toml"), other).expect("it can be written");
    fs::write(room.join("states.csv"), states(6)).expect("it can be written");
    let said = fails(
        &room,
        "torque --robot other.toml --in states.csv --out tau.csv",
    );
    assert!(
        said.contains("'ur99'") && said.contains("only ur5 and panda"),
        "{said}"
    );
    let said = fails(&room, "torque --robot ur7 --in states.csv --out tau.csv");
    assert!(said.contains("unknown robot 'ur7'"), "{said}");
    // Another geometry under the name of an arm.
    let panda =
        include_str!("../robots/panda.urdf").replacen("xyz=\"0 0 0.333\"", "xyz=\"0 0 0.334\"", 1);
    fs::write(room.join("panda.urdf"), panda).expect("it can be written");
    let said = fails(
        &room,
        "torque --robot panda.urdf --in states.csv --out tau.csv",
    );
    assert!(said.contains("different arms of that name"), "{said}");
    assert!(!room.join("tau.csv").exists());
}

#[test]
fn a_board_that_drives_another_robot_is_refused() {
    let room = room("other-robot");
    fs::write(room.join("states.csv"), states(6)).expect("it can be written");
    let native = Native::<Panda, 7, 48>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native, <[u8]>::to_vec);
    let said = fails(
        &room,
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
    assert!(said.contains(&wanted), "{said}");
    assert_eq!(files(&room), ["states.csv"]);
}

#[test]
fn a_board_on_a_serial_port_computes_torque() {
    let room = room("serial");
    fs::write(room.join("states.csv"), states(6)).expect("it can be written");
    let native = Native::<Ur5, 6, 40>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native, <[u8]>::to_vec);
    succeeds(
        &room,
        &format!(
            "torque --robot ur5 --board serial:{} --in states.csv --out tau.csv",
            board.port
        ),
    );
    succeeds(&room, "torque --robot ur5 --in states.csv --out native.csv");
    let [serial, native] =
        ["tau.csv", "native.csv"].map(|name| fs::read(room.join(name)).expect("it was written"));
    assert!(serial == native, "the port changes nothing");
}

#[test]
fn a_board_of_another_protocol_version_is_refused() {
    let room = room("other-version");
    let native = Native::<Ur5, 6, 40>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native, of_the_next_version);
    let said = fails(
        &room,
        &format!(
            "run --robot ur5 --board serial:{} --trajectory validation --out out",
            board.port
        ),
    );
    assert!(
        said.contains(&format!(
            "the board speaks protocol version {}, this program version {PROTOCOL_VERSION}",
            PROTOCOL_VERSION + 1
        )),
        "{said}"
    );
    assert_eq!(files(&room), Vec::<String>::new());
}

#[test]
fn the_emulated_board_says_that_it_drives_another_robot() {
    let room = room("emulated-panda");
    fs::write(room.join("states.csv"), states(7)).expect("it can be written");
    for board in ["qemu", "qemu-usart"] {
        let said = fails(
            &room,
            &format!("torque --robot panda --board {board} --in states.csv --out tau.csv"),
        );
        assert!(said.contains("the board drives ur5"), "{said}");
        assert!(said.contains("not panda"), "{said}");
    }
    assert_eq!(files(&room), ["states.csv"]);
}

#[test]
fn the_log_of_the_flashable_firmware_is_text() {
    let room = room("log");
    succeeds(
        &room,
        "run --robot ur5 --board qemu-usart --trajectory validation --duration-s 1.2 --out out --log board.log",
    );
    let log = fs::read_to_string(room.join("board.log")).expect("it was written");
    let hello = format!(
        "info: hello: arm ur5 {:#x}, Instructions counter, Configuration {{ period_us: 1000, pacing: Link, reply: Decimated }}",
        Ur5::HASH
    );
    let lines: Vec<&str> = log.lines().collect();
    assert_eq!(
        lines[0],
        "info: boot: odrive-v3, clock Emulated at 168000000 Hz, started by Unknown, left before by None at 0x0"
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
    let mut made = files(&room);
    made.sort();
    assert_eq!(made, ["board.log", "out"]);
    let said = fails(
        &room,
        "run --robot ur5 --trajectory validation --out out --log board.log",
    );
    assert!(said.contains("--log: board native has none"), "{said}");
}

#[test]
fn an_arm_module_is_generated_from_a_urdf() {
    let room = room("generate");
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/panda.urdf");
    succeeds(&room, &format!("generate --urdf {urdf} --out panda.rs"));
    let written = fs::read_to_string(room.join("panda.rs")).expect("it was written");
    assert!(
        written == include_str!("../../firmware/src/arm/panda.rs"),
        "the committed module is another one"
    );
    succeeds(&room, "generate --robot ur5 --out ur5.rs");
    let written = fs::read_to_string(room.join("ur5.rs")).expect("it was written");
    assert!(written == include_str!("../../firmware/src/arm/ur5.rs"));
}

#[test]
fn a_urdf_that_is_none_or_has_no_such_link_is_refused() {
    let room = room("bad-urdf");
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/panda.urdf");
    fs::write(room.join("broken.urdf"), "<robot><link").expect("it can be written");
    for (arguments, named) in [
        ("generate --urdf missing.urdf --out arm.rs", "missing.urdf"),
        ("generate --urdf broken.urdf --out arm.rs", "broken.urdf"),
        (
            &format!("generate --urdf {urdf} --tip elbow_9 --out arm.rs"),
            "elbow_9",
        ),
        (
            &format!("generate --urdf {urdf} --base nowhere --out arm.rs"),
            "nowhere",
        ),
        (
            &format!("generate --urdf {urdf} --out Arm-1.rs"),
            "Arm-1.rs",
        ),
    ] {
        let said = fails(&room, arguments);
        assert!(said.contains(named), "{said}");
    }
    assert_eq!(files(&room), ["broken.urdf"]);
    // What belongs to a URDF is refused without one.
    let output = host_sim(&room, "generate --robot ur5 --tip tool --out arm.rs");
    assert!(!output.status.success());
    let said = String::from_utf8(output.stderr).expect("it speaks UTF-8");
    assert!(said.contains("--tip"), "{said}");
}

#[test]
fn a_path_of_the_tool_is_played_wherever_a_trajectory_is() {
    let room = room("tool-path");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("paths/ur5.toml");
    fs::copy(&path, room.join("path.toml")).expect("copies");
    succeeds(
        &room,
        "torque --robot ur5 --trajectory path.toml --out tau.csv",
    );
    let rows = fs::read_to_string(room.join("tau.csv")).expect("is text");
    assert_eq!(rows.lines().count(), 8502, "8.5 s, a row each millisecond");
    succeeds(
        &room,
        "simulate --robot ur5 --trajectory path.toml --duration-s 0.2 --out log.csv",
    );
    succeeds(
        &room,
        "run --robot ur5 --trajectory path.toml --duration-s 0.2 --out out",
    );
    let text = fs::read_to_string(&path).expect("is text");
    let far = text.replace("-0.5, -0.05, 0.3", "-1.5, -0.05, 0.3");
    fs::write(room.join("far.toml"), far).expect("writes");
    for command in ["torque --out x.csv", "simulate --out x.csv", "run --out x"] {
        let said = fails(
            &room,
            &format!("{command} --robot ur5 --trajectory far.toml"),
        );
        let waypoint =
            "far.toml: move 3 (via), point 2, tool at (-1.500, -0.050, 0.300) m: out of reach";
        assert!(said.contains(waypoint), "{said}");
    }
    assert!(!files(&room).iter().any(|name| name.starts_with('x')));
    let said = fails(
        &room,
        "torque --robot ur5 --in a.csv --trajectory path.toml --out x.csv",
    );
    assert!(said.contains("cannot be used with"), "{said}");
}
