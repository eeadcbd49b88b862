//! The commands `drive` and `commission`: on simulated drives, on a bus of python-can, and on buses that are not there.

use crate::program::{
    command, directory, fails, failure, files, host_sim, json, number, refused, still, succeeds,
    text, write,
};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

fn profile() -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("profiles/sim-ur5.toml");
    file.display().to_string()
}

/// The profile with `from` replaced by `to`.
fn changed(directory: &Path, from: &str, to: &str) -> PathBuf {
    let profile = text(profile());
    assert!(profile.contains(from), "{from}");
    let file = directory.join("changed.toml");
    write(&file, profile.replacen(from, to, 1));
    file
}

#[test]
fn simulated_drives_are_driven_and_the_summary_names_the_ratio() {
    let directory = directory("drive");
    let profile = profile();
    let command = format!(
        "drive --profile {profile} --bus sim --trajectory validation --duration-s 6 --learn --out out"
    );
    let shown = succeeds(&directory, &command);
    assert!(shown.contains("PD of the drives alone: "), "{shown}");
    assert!(shown.contains("replies lost"), "{shown}");
    let written = files(&directory.join("out"));
    assert_eq!(written, ["bank.bin", "drive.json", "log.csv", "log.mcap"]);
    let summary = json(directory.join("out/drive.json"));
    assert_eq!(summary["ticks"], 6000);
    assert!(number(&summary["tracking_ratio"]) > 1.0, "{summary}");
    let rows = text(directory.join("out/log.csv"));
    assert!(rows.lines().count() > 5990);
    let again = succeeds(&directory, &command);
    let figures = |text: &str| text.lines().take(2).collect::<Vec<_>>().join(" ");
    assert_eq!(figures(&shown), figures(&again), "one seed, one result");
}

#[test]
fn an_arm_is_commissioned_and_a_mistake_is_one_line() {
    let directory = directory("commission");
    let command = format!(
        "commission --profile {} --bus sim --weight-kg 2 --weight-com 0.05,0,0.05 --out out",
        profile()
    );
    let text = succeeds(&directory, &command);
    for step in [
        "Find", "Turn", "Zero", "Torque", "Friction", "Weight", "Excite", "Drive", "Identify",
    ] {
        assert!(text.contains(&format!("{step}: passed")), "{text}");
    }
    let out = directory.join("out");
    let written = ["commission.json", "driven", "excitation", "identified"];
    assert_eq!(files(&out), written);
    let (_, next) = text.split_once("next: host-sim drive --bank ").unwrap();
    let bank = next.split_whitespace().next().unwrap();
    assert!(directory.join(bank).is_file(), "{bank}");
    // A repeated step keeps the findings of the others.
    let found = json(out.join("commission.json"));
    succeeds(&directory, &format!("{command} --step turn"));
    let again = json(out.join("commission.json"));
    assert_eq!(found[1]["gain"], again[1]["gain"]);
    assert!(!found[1]["gain"].is_null(), "{found}");
    refused(
        &directory,
        &format!("{command} --step weight").replace("--weight-kg 2", "--weight-kg 200"),
        "more than the ",
    );
    std::fs::write(out.join("commission.json"), "[]").unwrap();
    refused(
        &directory,
        &format!("{command} --step turn"),
        "findings of 0 joints, the arm has 6",
    );
}

#[test]
fn the_wiring_of_a_board_is_written_from_the_profile() {
    use foretorque_link::bus::{Role, Wires, Wiring};
    let directory = directory("wiring");
    let cases = [
        ("master", Role::Master, Wires::Can, ""),
        ("in-line", Role::InLine, Wires::Can, ""),
        ("uart", Role::InLine, Wires::Uart, " --joint 2"),
    ];
    for (role, expected, wires, more) in cases {
        let command = format!(
            "wiring --profile {} --role {role}{more} --out board.bin",
            profile()
        );
        let text = succeeds(&directory, &command);
        assert!(text.contains("0x08080000 board.bin"), "{text}");
        let mut bytes = fs::read(directory.join("board.bin")).expect("it was written");
        bytes.resize(Wiring::<6>::BYTES, 0xff);
        let wiring = Wiring::<6>::decode(&bytes).expect("the board reads it");
        assert_eq!((wiring.role, wiring.wires), (expected, wires));
        let joints: Vec<bool> = wiring.joints.iter().map(Option::is_some).collect();
        assert_eq!(
            joints,
            [
                more.is_empty(),
                true,
                more.is_empty(),
                more.is_empty(),
                more.is_empty(),
                more.is_empty()
            ]
        );
        bytes[5] ^= 1;
        assert_eq!(Wiring::<6>::decode(&bytes), None);
    }
    refused(
        &directory,
        &format!(
            "wiring --profile {} --role uart --joint 7 --out x",
            profile()
        ),
        "--joint 7: the arm has joints 1 to 6",
    );
}

#[test]
fn contradictions_and_missing_buses_are_one_line() {
    let directory = directory("bus-mistakes");
    // Line of the profile, its replacement, and the words of the refusal.
    let cases = "\
rate_hz = 1000.0 | rate_hz = 5000.0 | rate_hz 5000
rate_hz = 1000.0 | rate_hz = 2000.0 | bus 0: commands and replies take 0.81 ms, rate_hz 2000 leaves 0.50 ms
bus = 1 | bus = 2 | joint 4: bus 2 contradicts the 2 buses
gear = 6.0 | gear = 60.0 | joint 1: range of position 0.6666667 contradicts the travel
torque_limit = 28.0 | torque_limit = 29.0 | joint 4: torque_limit 29 contradicts the torque of the arm 28
id = 2 | id = 1 | joint 2: id 1 contradicts the same id of joint 1
sign = 1.0 | sign = 0.5 | joint 1: size of sign 0.25
kp = 3330.0 | kq = 3330.0 | unknown field `kq`
robot = \"ur5\" | robot = \"panda\" | 6 joints contradict the 7 joints of robot 'panda'";
    for case in cases.lines() {
        let parts: Vec<&str> = case.split(" | ").collect();
        let file = changed(&directory, parts[0], parts[1]);
        let file = file.display();
        let line = fails(
            &directory,
            &format!("drive --profile {file} --bus sim --trajectory validation --out out"),
        );
        let named = line.contains(parts[2]) && line.contains("changed.toml");
        assert!(named, "{line}");
    }
    let profile = profile();
    let serial = "/dev/ttyNOWHERE7";
    for (bus, named) in [
        (
            "socketcan:nowhere7,nowhere8",
            "bus socketcan:nowhere7,nowhere8: ",
        ),
        (
            &format!("slcan:{serial},/dev/ttyNOWHERE8"),
            &format!("bus slcan:{serial}"),
        ),
        (
            &format!("fdcanusb:{serial}"),
            "1 named, the profile has 2 buses",
        ),
        ("can0", "not one of sim, socketcan:IF"),
    ] {
        for command in ["drive --trajectory validation", "commission"] {
            let arguments = format!("{command} --profile {profile} --bus {bus} --out out");
            refused(&directory, &arguments, named);
        }
    }
    assert!(!directory.join("out").exists());
}

#[test]
fn a_bus_without_drives_is_silent_in_one_line() {
    let directory = directory("bus-silent");
    let command = format!(
        "drive --profile {} --bus udp:239.74.163.61:43161,239.74.163.62:43162 --trajectory validation --out out",
        profile()
    );
    let output = host_sim(&directory, &command);
    let stderr = String::from_utf8_lossy(&output.stderr);
    if stderr.contains("error: bus udp:") && !stderr.contains("is silent") {
        println!("skipped: no multicast on this machine: {stderr}");
        return;
    }
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr.contains("is silent, torque off: no drive of the profile answers"),
        "{stderr}"
    );
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
}

#[test]
fn an_adapter_without_drives_ends_in_one_line() {
    use serialport::{SerialPort, TTYPort};
    use std::sync::atomic::{AtomicBool, Ordering};
    let directory = directory("adapter-silent");
    let [drive, commission] = ["drive --trajectory validation", "commission"];
    let silent = "is silent, torque off: no drive of the profile answers";
    let none = "joint 1: no drive answers at id 1 on bus 0; ids that answer: none";
    let stuck = "has gone, torque off: Operation timed out";
    // One that takes every frame, and one that takes none once its buffer is full.
    for (command, kind, takes, expected) in [
        (drive, "slcan", true, silent),
        (drive, "slcan", false, stuck),
        (drive, "fdcanusb", true, silent),
        (drive, "fdcanusb", false, stuck),
        (commission, "slcan", true, none),
        (commission, "fdcanusb", true, none),
    ] {
        let pairs = [(); 2].map(|()| TTYPort::pair().expect("the system has pseudo-terminals"));
        let mut near = Vec::new();
        let ports = pairs.map(|(mut adapter, far)| {
            let patience = std::time::Duration::from_millis(1);
            adapter.set_timeout(patience).expect("it has a timeout");
            near.push(adapter);
            far.name().expect("it has a name")
        });
        let done = AtomicBool::new(!takes);
        let line = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    for adapter in &mut near {
                        // Nothing there, or nobody at the other end.
                        let _ = std::io::Read::read(adapter, &mut [0; 4096]);
                    }
                }
            });
            let (profile, bus) = (profile(), format!("{kind}:{}", ports.join(",")));
            let arguments = format!("{command} --profile {profile} --bus {bus} --out out");
            let output = host_sim(&directory, &arguments);
            done.store(true, Ordering::Relaxed);
            failure(&arguments, &output)
        });
        assert!(line.contains(expected), "{line}");
    }
    assert_eq!(files(&directory.join("out")), ["commission.json"]);
}

/// A Damiao drive in Python: takes commands, stands where it is told, and prints the torques that it was sent.
const PYTHON_DRIVES: &str = include_str!("python_drives.py");

#[test]
fn drives_in_python_can_are_armed_and_follow() {
    let Some(python) = crate::python::with("can, msgpack") else {
        return;
    };
    let directory = directory("bus-python");
    let slow = changed(&directory, "rate_hz = 1000.0", "rate_hz = 100.0");
    write(directory.join("still.csv"), still(6, &["0", "6"]));
    let mut drives = Command::new(&python)
        .args(["-c", PYTHON_DRIVES])
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut output = std::io::BufReader::new(drives.stdout.take().expect("it is piped"));
    let mut line = String::new();
    std::io::BufRead::read_line(&mut output, &mut line).expect("it writes");
    if line.trim() != "ready" {
        let _ = drives.wait();
        println!("skipped: no multicast on this machine");
        return;
    }
    let command = format!(
        "drive --profile {} --bus udp:239.74.163.71:43161,239.74.163.72:43162 --trajectory still.csv --out out",
        slow.display()
    );
    let text = succeeds(&directory, &command);
    assert!(text.contains("600 ticks at 100 Hz"), "{text}");
    let _ = drives.wait();
    line.clear();
    std::io::BufRead::read_line(&mut output, &mut line).expect("it writes");
    let count: u32 = line
        .trim()
        .trim_start_matches("commands ")
        .parse()
        .expect("a number");
    assert!(count > 3000, "{count} commands with stiffness");
}

#[test]
fn an_interrupt_switches_the_torque_off_and_is_a_failure() {
    let directory = directory("drive-interrupted");
    let arguments = format!(
        "drive --profile {} --bus sim --trajectory validation --alone --duration-s 600 --out out",
        profile()
    );
    let child = command(&directory, &arguments)
        .stderr(Stdio::piped())
        .spawn();
    let child = child.expect("it starts");
    let rows = || -> u64 {
        let entries = fs::read_dir(directory.join("out")).into_iter().flatten();
        let size = |entry: std::io::Result<fs::DirEntry>| entry.ok()?.metadata().ok();
        entries.filter_map(size).map(|file| file.len()).sum()
    };
    while rows() < 10_000 {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let id = nix::unistd::Pid::from_raw(child.id().cast_signed());
    nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGTERM).expect("it is ours");
    let output = child.wait_with_output().expect("it ends");
    let line = failure(&arguments, &output);
    assert!(
        line.contains("interrupted after ") && line.contains(", torque off"),
        "{line}"
    );
}
