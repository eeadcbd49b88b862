//! Messages about unusable input, a terminal that hangs up, and a board that dies: one line, no panic, nothing half written.

mod mistyped;

use foretorque_workbench::board::qemu::Image;
use mistyped::mistyped;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

const COLUMNS: [(&str, &str); 3] = [("q", "rad"), ("qd", "rad_s"), ("qdd", "rad_s2")];

fn command(room: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command
        .current_dir(room)
        .args(arguments.split_whitespace())
        .stdin(Stdio::null());
    command
}

/// An empty directory for one test.
fn room(name: &str) -> PathBuf {
    let room = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("bad-{name}"));
    let _ = fs::remove_dir_all(&room);
    fs::create_dir_all(&room).expect("the directory of the tests can be written");
    room
}

/// All files below a directory, with what they hold.
fn files(room: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(room).expect("it is there") {
        let path = entry.expect("it is there").path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            let bytes = fs::read(&path).expect("it can be read");
            found.push((path, bytes));
        }
    }
    found.sort();
    found
}

/// The one line of a program that failed.
fn line(arguments: &str, output: &Output) -> String {
    let said = String::from_utf8(output.stderr.clone()).expect("it speaks UTF-8");
    assert!(!output.status.success(), "`{arguments}` went well");
    assert!(output.status.code().is_some(), "`{arguments}` was killed");
    assert_eq!(said.lines().count(), 1, "`{arguments}` said {said}");
    assert!(said.starts_with("error: "), "`{arguments}` said {said}");
    assert!(!said.contains("panicked"), "`{arguments}` said {said}");
    assert!(output.stdout.is_empty(), "`{arguments}` wrote to stdout");
    said
}

/// A table of two still UR5 states, 1 ms apart, with one change.
fn table(change: impl Fn(&mut Vec<Vec<String>>)) -> String {
    let names = COLUMNS
        .iter()
        .flat_map(|(name, unit)| (1..=6).map(move |joint| format!("{name}{joint}_{unit}")));
    let mut rows = vec![std::iter::once("t_s".to_owned()).chain(names).collect()];
    for t_s in ["0", "0.001", "0.002"] {
        let mut row = vec!["0".to_owned(); 19];
        row[0] = t_s.to_owned();
        rows.push(row);
    }
    change(&mut rows);
    rows.iter().map(|row| row.join(",") + "\n").collect()
}

/// Gives the rows of a table a torque for each joint.
fn with_torques(rows: &mut [Vec<String>]) {
    for (place, row) in rows.iter_mut().enumerate() {
        row.extend((1..=6).map(|joint| match place {
            0 => format!("tau{joint}_nm"),
            _ => "0".to_owned(),
        }));
    }
}

#[test]
fn bad_input_is_told_in_one_line_and_leaves_nothing() {
    let room = room("input");
    let set = |row: usize, column: usize, text: &'static str| {
        move |rows: &mut Vec<Vec<String>>| rows[row][column] = text.to_owned()
    };
    for (name, text) in [
        ("good.csv", table(|_| {})),
        ("torques.csv", table(|rows| with_torques(rows))),
        ("columns.csv", table(set(0, 3, "q_three"))),
        ("twice.csv", table(set(0, 3, "q2_rad"))),
        ("ragged.csv", table(|rows| drop(rows[2].pop()))),
        ("nan.csv", table(set(2, 8, "NaN"))),
        ("word.csv", table(set(3, 19 - 1, "fast"))),
        ("time.csv", table(set(3, 0, "0.001"))),
        ("empty.csv", table(|rows| rows.truncate(1))),
        ("seven.csv", table(|rows| rows[0].push("q7_rad".to_owned()))),
        ("far.csv", table(set(2, 2, "-6.4"))),
        ("fast.csv", table(set(2, 9, "3.3"))),
        ("hard.csv", table(set(3, 18, "10.5"))),
        ("series.json", "{\"robot\": \"ur5\"".to_owned()),
        ("file", String::new()),
        ("bank.bin", "no bank at all".to_owned()),
    ] {
        fs::write(room.join(name), text).expect("it can be written");
    }
    let before = files(&room);
    for (arguments, words) in mistyped() {
        let output = command(&room, &arguments).output().expect("it starts");
        let said = line(&arguments, &output);
        for word in words {
            assert!(said.contains(word), "`{arguments}` said {said}");
        }
        assert!(files(&room) == before, "`{arguments}` left something");
        assert!(!room.join("out").exists(), "`{arguments}` left a directory");
    }
}

#[test]
fn a_missing_emulator_is_told_in_one_line() {
    let room = room("emulator");
    fs::write(room.join("good.csv"), table(|_| {})).expect("it can be written");
    assert!(Image::Bulk.default_elf().is_file(), "the firmware is built");
    let before = files(&room);
    for arguments in [
        "torque --robot ur5 --board qemu --in good.csv --out tau.csv",
        "run --robot ur5 --board qemu-usart --trajectory validation --out out",
        "experiment demo --out out",
    ] {
        let output = command(&room, arguments).env("PATH", &room).output();
        let said = line(arguments, &output.expect("it starts"));
        assert!(said.contains("qemu-system-arm"), "{said}");
        assert!(files(&room) == before, "`{arguments}` left something");
    }
}

#[test]
fn a_terminal_that_hangs_up_is_no_failure() {
    let room = room("pipe");
    let made = command(
        &room,
        "run --robot ur5 --trajectory validation --duration-s 0.1 --out out",
    );
    let hung_up = |mut command: Command| {
        let (reader, writer) = std::io::pipe().expect("the system has pipes");
        drop(reader);
        let output = command
            .stdout(writer)
            .stderr(Stdio::piped())
            .spawn()
            .expect("it starts")
            .wait_with_output()
            .expect("it ends");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.success() && said.is_empty(),
            "{command:?}: {said}"
        );
    };
    hung_up(made);
    assert!(room.join("out/report.html").is_file(), "the work is done");
    for arguments in [
        "--help",
        "--version",
        "experiment --list",
        "bank out/bank.bin",
        "experiment demo --board native --learning-s 1 --usart-learning-s 1 --out demo",
    ] {
        hung_up(command(&room, arguments));
    }
    assert!(room.join("demo/report.json").is_file(), "the work is done");
}

/// Process id of an emulator that `child` started and that has run for a while (clock ticks of processor time).
fn busy_emulator(child: &Child) -> Option<i32> {
    let parent = child.id().to_string();
    fs::read_dir("/proc").ok()?.flatten().find_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        let stat = fs::read_to_string(entry.path().join("stat")).ok()?;
        // proc(5): after the name in brackets come state, parent, …; user time is the twelfth of these.
        let (program, rest) = stat.rsplit_once(')')?;
        let fields: Vec<&str> = rest.split_whitespace().collect();
        let of_ours = program.contains("qemu-system-arm") && *fields.get(1)? == parent;
        (of_ours && fields.get(11)?.parse::<u32>().ok()? > 20)
            .then(|| name.parse().ok())
            .flatten()
    })
}

#[test]
fn a_board_that_dies_in_the_middle_is_told_in_one_line_and_leaves_no_report() {
    for (name, arguments) in [
        (
            "run",
            "run --robot ur5 --board qemu --learn --trajectory validation --out out",
        ),
        ("experiment", "experiment demo --out out"),
    ] {
        let room = room(&format!("dying-{name}"));
        let mut child = command(&room, arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it starts");
        let deadline = Instant::now() + Duration::from_secs(60);
        let emulator = loop {
            if let Some(emulator) = busy_emulator(&child) {
                break emulator;
            }
            assert!(Instant::now() < deadline, "no emulator is seen at work");
            assert!(
                child.try_wait().expect("it is ours").is_none(),
                "it ended early"
            );
            std::thread::sleep(Duration::from_millis(5));
        };
        let emulator = nix::unistd::Pid::from_raw(emulator);
        nix::sys::signal::kill(emulator, nix::sys::signal::Signal::SIGKILL).expect("it is ours");
        let output = child.wait_with_output().expect("it ends");
        let said = line(arguments, &output);
        assert!(said.contains("qemu") && said.contains("died"), "{said}");
        assert!(files(&room).is_empty(), "{:?}", files(&room));
    }
}
