//! Messages about unusable input, a terminal that hangs up, and a board that dies: one line, no panic, nothing half written.

use crate::program::{command, directory, failure, soon, still, succeeds, write};
use foretorque_workbench::board::qemu::Image;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

/// All files below a directory, with their content.
fn files(directory: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).expect("it is there") {
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

/// The one line of a program that failed without a result.
fn line(arguments: &str, output: &Output) -> String {
    assert!(output.stdout.is_empty(), "`{arguments}` wrote to stdout");
    failure(arguments, output)
}

/// A table of three still UR5 states, 1 ms apart, with one change.
fn table(change: impl Fn(&mut Vec<Vec<String>>)) -> String {
    let good = still(6, &["0", "0.001", "0.002"]);
    let lines = good.lines().map(|line| line.split(',').map(str::to_owned));
    let mut rows = lines.map(Iterator::collect).collect();
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
    let directory = directory("input");
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
        write(directory.join(name), text);
    }
    let before = files(&directory);
    let lines = include_str!("mistyped.txt").lines();
    for case in lines.filter(|line| !line.starts_with('#')) {
        let mut words = case.split(" | ");
        let arguments = words.next().expect("a command line");
        let output = command(&directory, arguments).output().expect("it starts");
        let stderr = line(arguments, &output);
        for word in words {
            assert!(stderr.contains(word), "`{arguments}` wrote {stderr}");
        }
        let left = files(&directory) != before || directory.join("out").exists();
        assert!(!left, "`{arguments}` left something");
    }
}

#[test]
fn a_missing_emulator_is_told_in_one_line() {
    let directory = directory("emulator");
    write(directory.join("good.csv"), table(|_| {}));
    assert!(Image::Bulk.default_elf().is_file(), "the firmware is built");
    let before = files(&directory);
    for arguments in [
        "torque --robot ur5 --board qemu --in good.csv --out tau.csv",
        "run --robot ur5 --board qemu-usart --trajectory validation --out out",
        "experiment demo --out out",
    ] {
        let output = command(&directory, arguments)
            .env("PATH", &directory)
            .output();
        let stderr = line(arguments, &output.expect("it starts"));
        assert!(stderr.contains("qemu-system-arm"), "{stderr}");
        assert!(files(&directory) == before, "`{arguments}` left something");
    }
}

#[test]
fn a_terminal_that_hangs_up_is_no_failure() {
    let directory = directory("pipe");
    let hung_up = |mut command: Command| {
        let (reader, writer) = std::io::pipe().expect("the system has pipes");
        drop(reader);
        let child = command.stdout(writer).stderr(Stdio::piped()).spawn();
        let output = child.expect("it starts").wait_with_output();
        let output = output.expect("it ends");
        let sound = output.status.success() && output.stderr.is_empty();
        assert!(sound, "{command:?}: {output:?}");
    };
    for arguments in [
        "run --robot ur5 --trajectory validation --duration-s 0.1 --out out",
        "--help",
        "--version",
        "experiment --list",
        "bank out/bank.bin",
        "experiment demo --board native --learning-s 1 --usart-learning-s 1 --out demo",
    ] {
        hung_up(command(&directory, arguments));
    }
    for done in ["out/report.html", "demo/report.json"] {
        assert!(directory.join(done).is_file(), "{done}");
    }
}

/// The finding of `look` within a minute, while `child` runs.
fn awaited<T>(child: &mut Child, what: &str, look: impl Fn(&Child) -> Option<T>) -> T {
    soon(what, || {
        let found = look(child);
        let ended = found.is_none() && child.try_wait().expect("it is ours").is_some();
        assert!(!ended, "it ended early");
        found
    })
}

#[test]
fn an_interrupted_run_leaves_nothing() {
    let directory = directory("interrupted");
    let arguments = "simulate --robot ur5 --trajectory validation --out log.csv";
    // Some of the signals come while the file is being made.
    for delay in (0..20).map(|k| Duration::from_micros(100 * (k % 4))) {
        let child = command(&directory, arguments)
            .stderr(Stdio::piped())
            .spawn();
        let mut child = child.expect("it starts");
        while files(&directory).is_empty() {
            assert!(child.try_wait().expect("it is ours").is_none(), "it ended");
        }
        std::thread::sleep(delay);
        let id = Pid::from_raw(child.id().cast_signed());
        kill(id, Signal::SIGINT).expect("it is ours");
        let output = child.wait_with_output().expect("it ends");
        assert_eq!(output.status.signal(), Some(Signal::SIGINT as i32));
        assert!(files(&directory).is_empty(), "{:?}", files(&directory));
    }
}

#[test]
fn results_go_through_what_is_no_file() {
    let directory = directory("through");
    let simulate = "simulate --robot ur5 --trajectory validation --duration-s 0.01 --out";
    let run = |out: &str| {
        let output = command(&directory, &format!("{simulate} {out}")).output();
        output.expect("it starts")
    };
    let output = run("-");
    let table = String::from_utf8(output.stdout).expect("it is text");
    assert!(
        output.status.success() && table.starts_with("t_s,q1_rad"),
        "{table}"
    );
    assert_eq!(table.lines().count(), 11);
    assert!(run("/dev/null").status.success());
    let full = run("/dev/full");
    let message = String::from_utf8_lossy(&full.stderr).into_owned();
    assert!(message.contains("/dev/full: No space left"), "{message}");
    assert!(files(&directory).is_empty(), "{:?}", files(&directory));
    for (device, kind) in [("/dev/null", "null"), ("/dev/full", "full")] {
        let metadata = fs::metadata(device).expect("it is there");
        assert!(!metadata.is_file(), "{kind} is a device still");
    }
}

#[test]
fn results_of_an_earlier_run_do_not_stay() {
    let directory = directory("stale");
    let simulate =
        "simulate --robot ur5 --trajectory validation --exact --duration-s 12 --out log.csv";
    let identify = |methods: &str| {
        let line = format!("identify --robot ur5 --log log.csv --methods {methods} --out out");
        succeeds(&directory, &line)
    };
    succeeds(&directory, simulate);
    identify("consistent");
    assert!(directory.join("out/robot.toml").exists());
    identify("wls");
    for stale in ["robot.toml", "robot.urdf"] {
        assert!(!directory.join("out").join(stale).exists(), "{stale}");
    }
    let compared = succeeds(&directory, "compare out out --out c.html");
    assert_eq!(compared, "no figure differs\n");
    assert!(succeeds(&directory, "completions bash").contains("complete"));
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
        let directory = directory(&format!("dying-{name}"));
        let mut command = command(&directory, arguments);
        let child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = child.expect("it starts");
        let emulator = awaited(&mut child, "no emulator is seen at work", busy_emulator);
        kill(Pid::from_raw(emulator), Signal::SIGKILL).expect("it is ours");
        let output = child.wait_with_output().expect("it ends");
        let stderr = line(arguments, &output);
        let named = stderr.contains("qemu") && stderr.contains("died");
        assert!(named, "{stderr}");
        assert!(files(&directory).is_empty(), "{:?}", files(&directory));
    }
}
