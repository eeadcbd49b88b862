//! Messages about unusable input, a terminal that hangs up, and a board that dies: one line, no panic, nothing half written.

mod mistyped;

use foretorque_workbench::board::qemu::Image;
use mistyped::mistyped;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

const COLUMNS: [(&str, &str); 3] = [("q", "rad"), ("qd", "rad_s"), ("qdd", "rad_s2")];

fn command(directory: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command
        .current_dir(directory)
        .args(arguments.split_whitespace())
        .stdin(Stdio::null());
    command
}

/// An empty directory for one test.
fn directory(name: &str) -> PathBuf {
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("bad-{name}"));
    let _ = fs::remove_dir_all(&directory);
    fs::create_dir_all(&directory).expect("the directory of the tests can be written");
    directory
}

/// All files below a directory, with what they hold.
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

/// The one line of a program that failed.
fn line(arguments: &str, output: &Output) -> String {
    let stderr = String::from_utf8(output.stderr.clone()).expect("it speaks UTF-8");
    assert!(!output.status.success(), "`{arguments}` went well");
    let usage = stderr.starts_with("error: --") || stderr.trim_end().ends_with("(see --help)");
    let code = Some(1 + i32::from(usage));
    assert_eq!(output.status.code(), code, "`{arguments}` wrote {stderr}");
    assert_eq!(stderr.lines().count(), 1, "`{arguments}` wrote {stderr}");
    assert!(
        stderr.starts_with("error: "),
        "`{arguments}` wrote {stderr}"
    );
    assert!(!stderr.contains("panicked"), "`{arguments}` wrote {stderr}");
    assert!(output.stdout.is_empty(), "`{arguments}` wrote to stdout");
    stderr
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
        fs::write(directory.join(name), text).expect("it can be written");
    }
    let before = files(&directory);
    for (arguments, words) in mistyped() {
        let output = command(&directory, &arguments).output().expect("it starts");
        let stderr = line(&arguments, &output);
        for word in words {
            assert!(stderr.contains(word), "`{arguments}` wrote {stderr}");
        }
        assert!(files(&directory) == before, "`{arguments}` left something");
        assert!(
            !directory.join("out").exists(),
            "`{arguments}` left a directory"
        );
    }
}

#[test]
fn a_missing_emulator_is_told_in_one_line() {
    let directory = directory("emulator");
    fs::write(directory.join("good.csv"), table(|_| {})).expect("it can be written");
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
    let made = command(
        &directory,
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
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.success() && stderr.is_empty(),
            "{command:?}: {stderr}"
        );
    };
    hung_up(made);
    assert!(
        directory.join("out/report.html").is_file(),
        "the work is done"
    );
    for arguments in [
        "--help",
        "--version",
        "experiment --list",
        "bank out/bank.bin",
        "experiment demo --board native --learning-s 1 --usart-learning-s 1 --out demo",
    ] {
        hung_up(command(&directory, arguments));
    }
    assert!(
        directory.join("demo/report.json").is_file(),
        "the work is done"
    );
}

#[test]
fn an_interrupted_run_leaves_nothing() {
    let directory = directory("interrupted");
    let arguments = "simulate --robot ur5 --trajectory validation --out log.csv";
    let mut child = command(&directory, arguments)
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let deadline = Instant::now() + Duration::from_secs(60);
    while files(&directory).is_empty() {
        assert!(Instant::now() < deadline, "no unfinished file is seen");
        assert!(
            child.try_wait().expect("it is ours").is_none(),
            "it ended early"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
    let child_id = nix::unistd::Pid::from_raw(child.id().cast_signed());
    nix::sys::signal::kill(child_id, nix::sys::signal::Signal::SIGINT).expect("it is ours");
    let output = child.wait_with_output().expect("it ends");
    let ended_by = std::os::unix::process::ExitStatusExt::signal(&output.status);
    assert_eq!(ended_by, Some(nix::sys::signal::Signal::SIGINT as i32));
    assert!(files(&directory).is_empty(), "{:?}", files(&directory));
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
    for arguments in [
        simulate,
        "identify --robot ur5 --log log.csv --methods consistent --out out",
    ] {
        let output = command(&directory, arguments).output().expect("it starts");
        assert!(output.status.success(), "{output:?}");
    }
    assert!(directory.join("out/robot.toml").exists());
    let arguments = "identify --robot ur5 --log log.csv --methods wls --out out";
    let output = command(&directory, arguments).output().expect("it starts");
    assert!(output.status.success(), "{output:?}");
    for stale in ["robot.toml", "robot.urdf"] {
        assert!(!directory.join("out").join(stale).exists(), "{stale}");
    }
    let compared = command(&directory, "compare out out --out c.html").output();
    let compared = compared.expect("it starts");
    assert_eq!(
        String::from_utf8_lossy(&compared.stdout),
        "no figure differs\n"
    );
    let shell = command(&directory, "completions bash")
        .output()
        .expect("it starts");
    assert!(String::from_utf8_lossy(&shell.stdout).contains("complete"));
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
        let mut child = command(&directory, arguments)
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
        let stderr = line(arguments, &output);
        assert!(
            stderr.contains("qemu") && stderr.contains("died"),
            "{stderr}"
        );
        assert!(files(&directory).is_empty(), "{:?}", files(&directory));
    }
}
