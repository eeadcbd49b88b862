//! The commands `drive` and `commission`: on simulated drives, on a bus of python-can, and on buses that are not there.

use crate::{Directory, assert_contains, at_port, failure, number, still};
use foretorque_link::bank::ParameterBank;
use serialport::TTYPort;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

const PROFILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/profiles/sim-ur5.toml");

const SILENT: &str = "is silent, torque off: no drive of the profile answers";

/// The profile with `from` replaced by `to`.
fn changed(here: &Directory, from: &str, to: &str) -> PathBuf {
    let profile = here.text(PROFILE);
    assert!(profile.contains(from), "{from}");
    let file = here.join("changed.toml");
    here.write(&file, profile.replacen(from, to, 1));
    file
}

#[test]
fn simulated_drives_are_driven_and_the_summary_names_the_ratio() {
    let here = Directory::new("drive");
    let command = format!(
        "drive --profile {PROFILE} --bus sim --trajectory validation --duration-s 6 --learn --out out"
    );
    let shown = here.succeeds(&command);
    assert_contains(&shown, "PD of the drives alone: ");
    assert_contains(&shown, "replies lost");
    let written = here.files("out");
    assert_eq!(written, ["bank.bin", "drive.json", "log.csv", "log.mcap"]);
    let summary = here.json("out/drive.json");
    // It slows down to where it is cut, 0.3 s in place of 0.15 s, and ends at rest.
    assert_eq!(summary["ticks"], 6150);
    let log = here.text("out/log.csv");
    let last: Vec<f64> = (log.lines().last().expect("a row").split(','))
        .map(|field| field.parse().expect("a number"))
        .collect();
    assert!(last[7..13].iter().all(|qd| qd.abs() < 0.05), "{last:?}");
    assert!(number(&summary["tracking_ratio"]) > 1.0, "{summary}");
    assert!(here.text("out/log.csv").lines().count() > 5990);
    let again = here.succeeds(&command);
    let figures = |text: &str| text.lines().take(2).collect::<Vec<_>>().join(" ");
    assert_eq!(figures(&shown), figures(&again), "one seed, one result");
}

#[test]
fn a_bank_that_is_driven_keeps_all_that_is_not_learnt() {
    use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
    let here = Directory::new("drive-bank");
    let mut given = ParameterBank::nominal::<Ur5, JOINTS, PARAMETERS>();
    given.drive_gains_nm_a[2] = 12.5;
    given.columns[3].deviation *= 0.25;
    given.limits[1].torque_nm *= 0.5;
    let mut buffer = vec![0; ParameterBank::MAX_BYTES];
    here.write("given.bank", given.encode(&mut buffer).unwrap());
    let command = format!(
        "drive --profile {PROFILE} --bus sim --trajectory validation --duration-s 2 --bank given.bank --learn --out out"
    );
    here.succeeds(&command);
    let mut learnt = ParameterBank::decode(&fs::read(here.join("out/bank.bin")).unwrap()).unwrap();
    assert_ne!(learnt, given, "it has learnt");
    for (own, before) in learnt.columns.iter_mut().zip(&given.columns) {
        own.value = before.value;
    }
    learnt.weights.clone_from(&given.weights);
    assert_eq!(learnt, given);
    let alone = command.replace("--bank given.bank --learn", "--alone");
    here.succeeds(&alone);
    assert_eq!(here.files("out"), ["drive.json", "log.csv", "log.mcap"]);
    here.refused(format!("{alone} --bank given.bank"), "'--bank <FILE>'");
}

#[test]
fn an_arm_is_commissioned_and_a_mistake_is_one_line() {
    let here = Directory::new("commission");
    let command = format!(
        "commission --profile {PROFILE} --bus sim --weight-kg 2 --weight-com 0.05,0,0.05 --out out"
    );
    let text = here.succeeds(&command);
    for step in [
        "Find", "Turn", "Zero", "Torque", "Friction", "Weight", "Excite", "Drive", "Identify",
    ] {
        assert_contains(&text, format!("{step}: passed"));
    }
    let out = here.join("out");
    let written = ["commission.json", "driven", "excitation", "identified"];
    assert_eq!(here.files(&out), written);
    let (_, next) = text.split_once(" --bank ").unwrap();
    let bank = next.split_whitespace().next().unwrap();
    assert!(here.join(bank).is_file(), "{bank}");
    // A repeated step keeps the findings of the others.
    let found = here.json("out/commission.json");
    here.succeeds(format!("{command} --step turn"));
    let again = here.json("out/commission.json");
    assert_eq!(found[1]["gain"], again[1]["gain"]);
    assert!(!found[1]["gain"].is_null(), "{found}");
    let heavy = command.replace("--weight-kg 2", "--weight-kg 200");
    here.refused(format!("{heavy} --step weight"), "more than the ");
    here.write("out/commission.json", "[]");
    let turn = format!("{command} --step turn");
    here.refused(&turn, "findings of 0 joints, the arm has 6");
}

#[test]
fn the_wiring_of_a_board_is_written_from_the_profile() {
    use foretorque::arm::ur5::Ur5;
    use foretorque_link::bus::{Role, Wires, Wiring};
    let here = Directory::new("wiring");
    let profile = here.text(PROFILE);
    let with_drives = |protocol: &str| {
        let drive = |line: &str| match line.split_once("id = ") {
            Some((_, rest)) => format!("drive = {{ protocol = {{ {protocol} }}, id = {rest}"),
            None => line.to_owned(),
        };
        profile
            .lines()
            .map(|line| drive(line) + "\n")
            .collect::<String>()
    };
    let moteus = "moteus = { kp = 5e4, kd = 5e3, watchdog_s = 0.02, resolution = \"int32\" }";
    here.write("moteus.toml", with_drives(moteus));
    let cia402 = "cia402 = { mode = \"position\", counts_per_turn = 1e6, rated_torque = 40.0 }";
    let slow = with_drives(cia402).replace("rate_hz = 1000.0", "rate_hz = 500.0");
    here.write("cia402.toml", slow);
    let apart = profile.replace("rate_hz = 1000.0", "rate_hz = 500.0");
    here.write("apart.toml", apart.replace("1e6 }]", "5e5 }]"));
    let cases = [
        ("master", Role::Master, Wires::Can, ""),
        ("in-line", Role::InLine, Wires::Can, " --joint 2"),
        ("uart", Role::InLine, Wires::Uart, " --joint 2"),
    ];
    for (role, expected, wires, more) in cases {
        let profile = if wires == Wires::Uart {
            "moteus.toml"
        } else {
            PROFILE
        };
        let command = format!("wiring --profile {profile} --role {role}{more} --out board.bin");
        here.shows(&command, "0x08080000 board.bin");
        let mut bytes = fs::read(here.join("board.bin")).expect("it was written");
        bytes.resize(Wiring::<6>::BYTES, 0xff);
        let wiring = Wiring::<6>::decode::<Ur5, 40>(&bytes).expect("the board reads it");
        assert_eq!((wiring.role, wiring.wires), (expected, wires));
        let joints: Vec<bool> = wiring.joints.iter().map(Option::is_some).collect();
        let all = more.is_empty();
        assert_eq!(joints, [all, true, all, all, all, all]);
        // Three drives on each bus, commands and replies of 135 bits at most.
        assert_eq!(wiring.shortest_period_us, if all { 3 * 2 * 135 } else { 0 });
        bytes[5] ^= 1;
        assert_eq!(Wiring::<6>::decode::<Ur5, 40>(&bytes), None);
    }
    // A board in line of one drive has the bit rate of its bus.
    let one = "wiring --profile apart.toml --role in-line --joint 5 --out one.bin";
    here.succeeds(one);
    let mut bytes = fs::read(here.join("one.bin")).expect("it was written");
    bytes.resize(Wiring::<6>::BYTES, 0xff);
    let wiring = Wiring::<6>::decode::<Ur5, 40>(&bytes).expect("it is sound");
    assert_eq!(wiring.bit_s, 500_000);
    here.write("sim.toml", &profile);
    // Profile, role, and the words of the refusal.
    let cases = "\
apart.toml | master | one bit_s and data_bit_s
sim.toml | uart --joint 7 | --joint 7: the arm has joints 1 to 6
sim.toml | uart | joint 1: on serial ports the drive must be a moteus
moteus.toml | uart | choose its joint with --joint
moteus.toml | in-line | joint 1: its drive needs CAN-FD
sim.toml | in-line | choose its joint with --joint
cia402.toml | in-line --joint 3 | joint 3: in line no torque";
    for case in cases.lines() {
        let parts: Vec<&str> = case.split(" | ").collect();
        let wiring = format!("wiring --profile {} --role {} --out x", parts[0], parts[1]);
        here.refused(wiring, parts[2]);
    }
}

#[test]
fn contradictions_and_missing_buses_are_one_line() {
    let here = Directory::new("bus-mistakes");
    // Line of the profile, its replacement, and the words of the refusal.
    let cases = "\
rate_hz = 1000.0 | rate_hz = 5000.0 | rate_hz 5000
rate_hz = 1000.0 | rate_hz = 2000.0 | bus 0: commands and replies take 0.81 ms, rate_hz 2000 leaves 0.50 ms
bus = 1 | bus = 2 | joint 4: bus 2 contradicts the 2 buses
gear = 6.0 | gear = 60.0 | joint 1: range of position 0.6666667 contradicts the travel
torque_limit = 28.0 | torque_limit = 29.0 | joint 4: torque_limit 29 contradicts the torque of the arm 28
id = 2 | id = 1 | joint 2: id 1 contradicts the id in the replies of joint 1
sign = 1.0 | sign = 0.5 | joint 1: size of sign 0.25
kp = 3330.0 | kq = 3330.0 | unknown field `kq`
robot = \"ur5\" | robot = \"panda\" | 6 joints contradict the 7 joints of robot 'panda'";
    for case in cases.lines() {
        let parts: Vec<&str> = case.split(" | ").collect();
        let file = changed(&here, parts[0], parts[1]);
        let drive = format!("drive --profile {} --bus sim", file.display());
        let line = here.fails(format!("{drive} --trajectory validation --out out"));
        assert_contains(&line, parts[2]);
        assert_contains(&line, "changed.toml");
    }
    for (bus, named) in [
        (
            "socketcan:nowhere7,nowhere8",
            "bus socketcan:nowhere7,nowhere8: ",
        ),
        (
            "slcan:/dev/ttyNOWHERE7,/dev/ttyNOWHERE8",
            "bus slcan:/dev/ttyNOWHERE7",
        ),
        (
            "fdcanusb:/dev/ttyNOWHERE7,/dev/ttyNOWHERE8",
            "bus fdcanusb:/dev/ttyNOWHERE7,/dev/ttyNOWHERE8: ",
        ),
        ("udp:10.0.0.1,here", "bus udp:10.0.0.1,here: "),
        ("udp:here,there", "bus udp:here,there: "),
        (
            "fdcanusb:/dev/ttyNOWHERE7",
            "1 named, the profile has 2 buses",
        ),
        ("can0", "not one of sim, socketcan:IF"),
    ] {
        for command in ["drive --trajectory validation", "commission"] {
            let arguments = format!("{command} --profile {PROFILE} --bus {bus} --out out");
            here.refused(&arguments, named);
        }
    }
    let bus = "--bus socketcan:nowhere7,nowhere8";
    let real = format!("drive --profile {PROFILE} {bus} --trajectory validation --out out");
    for option in ["--exact", "--payload 1@2..3", "--load-friction 0.1"] {
        here.refused(format!("{real} {option}"), "the arm on this bus is real");
    }
    assert!(!here.join("out").exists());
}

#[test]
fn a_bus_without_drives_is_silent_in_one_line() {
    let here = Directory::new("bus-silent");
    let command = format!(
        "drive --profile {PROFILE} --bus udp:239.74.163.61:43161,239.74.163.62:43162 --trajectory validation --out out"
    );
    let output = here.run(&command);
    let stderr = String::from_utf8_lossy(&output.stderr);
    if stderr.contains("error: bus udp:") && !stderr.contains("is silent") {
        crate::python::skipped(&format!("no multicast on this machine: {}", stderr.trim()));
        return;
    }
    assert_contains(&failure(&command, &output), SILENT);
}

#[test]
fn an_adapter_without_drives_ends_in_one_line() {
    let here = Directory::new("adapter-silent");
    let [drive, commission] = ["drive --trajectory validation", "commission"];
    let none = "joint 1: no drive answers at id 1 on bus 0; ids that answer: none";
    let stuck = "has failed, torque off: Operation timed out";
    // One that takes every frame, and one that takes none once its buffer is full.
    for (command, kind, takes, expected) in [
        (drive, "slcan", true, SILENT),
        (drive, "slcan", false, stuck),
        (drive, "fdcanusb", true, SILENT),
        (drive, "fdcanusb", false, stuck),
        (commission, "slcan", true, none),
        (commission, "fdcanusb", true, none),
    ] {
        let adapter = |line: &mut TTYPort| match takes {
            // Nothing there, or nobody at the other end.
            true => drop(line.read(&mut [0; 4096])),
            false => std::thread::sleep(Duration::from_millis(1)),
        };
        at_port(adapter, |one| {
            at_port(adapter, |other| {
                let bus = format!("--profile {PROFILE} --bus {kind}:{one},{other}");
                here.refused(format!("{command} {bus} --out out"), expected);
            });
        });
    }
    assert_eq!(here.files("out"), ["commission.json"]);
}

/// A Damiao drive in Python: takes commands, stands where it is set, and prints the torques that it was sent.
const PYTHON_DRIVES: &str = include_str!("python_drives.py");

#[test]
fn drives_in_python_can_are_armed_and_follow() {
    let Some(python) = crate::python::with("can, msgpack") else {
        return;
    };
    let here = Directory::new("bus-python");
    let slow = changed(&here, "rate_hz = 1000.0", "rate_hz = 100.0");
    here.write("still.csv", still(6, &["0", "6"]));
    let mut drives = Command::new(&python)
        .args(["-c", PYTHON_DRIVES])
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut output = BufReader::new(drives.stdout.take().expect("it is piped"));
    let mut line = String::new();
    output.read_line(&mut line).expect("it writes");
    if line.starts_with("no multicast") {
        let _ = drives.wait();
        return crate::python::skipped(line.trim());
    }
    assert_eq!(line.trim(), "ready");
    let command = format!(
        "drive --profile {} --bus udp:239.74.163.71:43161,239.74.163.72:43162 --trajectory still.csv --out out",
        slow.display()
    );
    assert_contains(&here.succeeds(&command), "600 ticks at 100 Hz");
    let _ = drives.wait();
    line.clear();
    output.read_line(&mut line).expect("it writes");
    let count = line.trim().trim_start_matches("commands ");
    let count: u32 = count.parse().expect("a number");
    assert!(count > 3000, "{count} commands with stiffness");
}

#[test]
fn an_interrupt_switches_the_torque_off_and_is_a_failure() {
    let here = Directory::new("drive-interrupted");
    let arguments = format!(
        "drive --profile {PROFILE} --bus sim --trajectory validation --alone --duration-s 600 --out out"
    );
    let child = here.command(&arguments).stderr(Stdio::piped()).spawn();
    let child = child.expect("it starts");
    crate::soon("the log has rows", || {
        let entries = fs::read_dir(here.join("out")).into_iter().flatten();
        let size = |entry: std::io::Result<fs::DirEntry>| entry.ok()?.metadata().ok();
        let written: u64 = entries.filter_map(size).map(|file| file.len()).sum();
        (written >= 10_000).then_some(())
    });
    let id = nix::unistd::Pid::from_raw(child.id().cast_signed());
    nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGTERM).expect("it is ours");
    let line = failure(&arguments, &child.wait_with_output().expect("it ends"));
    assert_contains(&line, "interrupted after ");
    assert_contains(&line, ", torque off");
}
