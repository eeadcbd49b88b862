//! Messages about unusable input, a terminal that hangs up, a board that dies, and a program that is ended: one line, no panic,
//! nothing half written, no emulator left behind.

use crate::{Directory, assert_contains, failure, soon, still};
use foretorque_workbench::board::qemu::Image;
use nix::sys::signal::{SigHandler, Signal, kill, signal};
use nix::unistd::Pid;
use std::fs;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

/// All files below a directory, with their content.
fn files(here: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(here).expect("it is there") {
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
    let here = Directory::new("input");
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
        ("huge.csv", table(set(2, 9, "1e30"))),
        ("fast.csv", table(set(2, 9, "-3.3"))),
        ("jump.csv", table(set(2, 1, "0.5"))),
        ("speed.csv", table(set(2, 9, "1"))),
        ("hard.csv", table(set(3, 18, "10.5"))),
        ("series.json", "{\"robot\": \"ur5\"".to_owned()),
        ("report.json", table(|rows| with_torques(rows))),
        ("log.csv", table(|_| {})),
        ("excitation.json", "{}".to_owned()),
        ("robot.toml", "from = \"ur5\"".to_owned()),
        ("over.toml", "from = \"robot.toml\"".to_owned()),
        ("file", String::new()),
        ("bank.bin", "no bank at all".to_owned()),
    ] {
        here.write(name, text);
    }
    let before = files(&here);
    let lines = include_str!("mistyped.txt").lines();
    for case in lines.filter(|line| !line.starts_with('#')) {
        let mut words = case.split(" | ");
        let arguments = words.next().expect("a command line");
        let output = here.command(arguments).output().expect("it starts");
        let stderr = line(arguments, &output);
        for word in words {
            assert_contains(&stderr, word);
        }
        let left = files(&here) != before || here.join("out").exists();
        assert!(!left, "`{arguments}` left something");
    }
}

#[test]
fn a_missing_emulator_is_told_in_one_line() {
    let here = Directory::new("emulator");
    here.write("good.csv", table(|_| {}));
    assert!(Image::Bulk.default_elf().is_file(), "the firmware is built");
    let before = files(&here);
    for arguments in [
        "torque --robot ur5 --board qemu --in good.csv --out tau.csv",
        "run --robot ur5 --board qemu-usart --trajectory validation --out out",
        "experiment demo --out out",
    ] {
        let output = here.command(arguments).env("PATH", &*here).output();
        let stderr = line(arguments, &output.expect("it starts"));
        assert_contains(&stderr, "qemu-system-arm");
        assert!(files(&here) == before, "`{arguments}` left something");
    }
}

#[test]
fn a_terminal_that_hangs_up_is_no_failure() {
    let here = Directory::new("pipe");
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
        "experiment demo --board native --learning-s 1 --out demo",
    ] {
        hung_up(here.command(arguments));
    }
    for done in ["out/report.html", "demo/report.json"] {
        assert!(here.join(done).is_file(), "{done}");
    }
}

#[test]
fn an_interrupted_run_leaves_nothing() {
    let here = Directory::new("interrupted");
    let arguments = "simulate --robot ur5 --trajectory validation --out log.csv";
    // Some of the signals come while the file is being made.
    for delay in (0..20).map(|k| Duration::from_micros(100 * (k % 4))) {
        let child = here.command(arguments).stderr(Stdio::piped()).spawn();
        let mut child = child.expect("it starts");
        while files(&here).is_empty() {
            assert!(child.try_wait().expect("it is ours").is_none(), "it ended");
        }
        std::thread::sleep(delay);
        kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGINT).expect("it is ours");
        let output = child.wait_with_output().expect("it ends");
        assert_eq!(output.status.signal(), Some(Signal::SIGINT as i32));
        assert!(files(&here).is_empty(), "{:?}", files(&here));
    }
}

#[test]
fn results_go_through_what_is_no_file() {
    let here = Directory::new("through");
    let simulate = "simulate --robot ur5 --trajectory validation --duration-s 0.01 --out";
    let run = |out: &str| {
        let output = here.command(format!("{simulate} {out}")).output();
        output.expect("it starts")
    };
    let output = run("-");
    let table = String::from_utf8(output.stdout).expect("it is text");
    let sound = output.status.success() && table.starts_with("t_s,q1_rad");
    assert!(sound, "{table}");
    assert_eq!(table.lines().count(), 11);
    assert!(run("/dev/null").status.success());
    let full = run("/dev/full");
    assert_contains(&failure("full", &full), "/dev/full: No space left");
    assert!(files(&here).is_empty(), "{:?}", files(&here));
    for device in ["/dev/null", "/dev/full"] {
        let metadata = fs::metadata(device).expect("it is there");
        assert!(!metadata.is_file(), "{device} is a device still");
    }
}

#[test]
fn results_of_an_earlier_run_do_not_stay() {
    let here = Directory::new("stale");
    let simulate =
        "simulate --robot ur5 --trajectory validation --exact --duration-s 12 --out log.csv";
    let identify = |methods: &str| {
        let line = format!("identify --robot ur5 --log log.csv --methods {methods} --out out");
        here.succeeds(&line)
    };
    here.succeeds(simulate);
    identify("consistent");
    assert!(here.join("out/robot.toml").exists());
    identify("wls");
    for stale in ["robot.toml", "robot.urdf"] {
        assert!(!here.join("out").join(stale).exists(), "{stale}");
    }
    let bank = || fs::read(here.join("out/parameters.bank")).ok();
    let before = bank().expect("a bank");
    let wrong = "identify --robot ur5 --log log.csv --units tau=-Nm --out out";
    here.refused(wrong, "--force");
    assert_eq!(
        bank().as_ref(),
        Some(&before),
        "a refused run removes nothing"
    );
    let other = "simulate --robot ur5 --trajectory validation --seed 2 --out other.csv";
    here.succeeds(other);
    // Worse than the description, of which the unseen log is.
    let fit = "identify --robot ur5 --log other.csv --validate log.csv --methods consistent --out";
    let output = here.run(format!("{fit} out"));
    assert_contains(&failure(fit, &output), "(no bank; --force writes one)");
    let shown = String::from_utf8_lossy(&output.stdout);
    assert_contains(&shown, "note  bank and description of an earlier run stay");
    assert_eq!(bank(), Some(before), "a refused fit leaves the bank");
    here.refused(format!("{fit} fresh"), "(no bank;");
    for out in ["out", "fresh"] {
        let directory = here.join(out);
        assert!(directory.join("report.json").exists(), "{out}");
        assert!(!directory.join("robot.toml").exists(), "{out}");
    }
    fs::create_dir(here.join("other")).expect("creates");
    here.write("other/robot.urdf", "no result");
    let line = "identify --robot ur5 --log log.csv --methods wls --out other";
    here.refused(line, "other/robot.urdf is there without the report.json");
    assert_eq!(here.text("other/robot.urdf"), "no result");
    here.write("other/log.csv", "a log of another robot");
    let run = "run --robot ur5 --trajectory validation --duration-s 0.1 --out other";
    here.refused(run, "other/log.csv is there without the report.json");
    let torque = "torque --robot ur5 --name bigger --trajectory validation --out t.csv";
    let printed = here.succeeds(format!("{torque} --bank out/parameters.bank"));
    assert_contains(&printed, "bank of arm 'ur5', the robot is 'bigger'");
    let compared = here.succeeds("compare out out --out c.html");
    assert_eq!(compared, "no figure differs\n");
    let completions = here.succeeds("completions bash");
    let states = completions.split("cmd=\"").skip(1);
    let states: Vec<&str> = states.filter_map(|rest| rest.split('"').next()).collect();
    assert!(states.len() > 20);
    for state in states.into_iter().filter(|state| !state.is_empty()) {
        assert_contains(&completions, format!("{state})"));
    }
}

/// Fields of a process behind its name, which may contain anything (proc(5)): state, parent, …; `None` without such a process.
fn stat(id: i32) -> Option<Vec<String>> {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    let fields = stat.rsplit_once(')')?.1.split_whitespace();
    Some(fields.map(str::to_owned).collect())
}

fn runs(id: i32) -> bool {
    // A process that ended may wait to be reaped.
    stat(id).is_some_and(|fields| !["Z", "X"].contains(&fields[0].as_str()))
}

/// A child of `parent` that has taken so much time of the processor, clock ticks.
fn child_of(parent: u32, ticks: u32) -> Option<i32> {
    let processes = fs::read_dir("/proc").expect("the system has /proc");
    let mut ids = processes.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    ids.find(|&id| {
        stat(id).is_some_and(|fields| {
            let time = fields[11].parse::<u32>();
            fields[1] == parent.to_string() && time.is_ok_and(|time| time >= ticks)
        })
    })
}

#[test]
fn a_board_that_dies_in_the_middle_is_told_in_one_line_and_leaves_no_report() {
    for arguments in [
        "run --robot ur5 --board qemu --learn --trajectory validation --out out",
        "run --robot ur5 --board qemu-usart --trajectory validation --out out",
        "experiment demo --out out",
    ] {
        let here = Directory::new("dying");
        let mut command = here.command(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("it starts");
        let emulator = soon("no emulator is seen at work", || {
            let busy = child_of(child.id(), 21);
            let runs = busy.is_some() || child.try_wait().expect("it is ours").is_none();
            assert!(runs, "it ended early");
            busy
        });
        kill(Pid::from_raw(emulator), Signal::SIGKILL).expect("it is ours");
        let stderr = line(arguments, &child.wait_with_output().expect("it ends"));
        assert_contains(&stderr, "qemu");
        assert_contains(&stderr, "died");
        assert!(files(&here).is_empty(), "{:?}", files(&here));
    }
}

/// Ends the emulator of a test that failed, which nothing else would.
struct KillOnDrop(i32);

impl Drop for KillOnDrop {
    fn drop(&mut self) {
        if std::thread::panicking() && runs(self.0) {
            let _ = kill(Pid::from_raw(self.0), Signal::SIGKILL);
        }
    }
}

/// Starts a run of an hour on an emulated board.
fn start(here: &Directory, board: &str, out: &str) -> Child {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/paths/ur5-excitation.json");
    let run = format!("run --robot ur5 --trajectory {path} --duration-s 3600");
    let mut command = here.command(format!("{run} --board {board} --out {out}"));
    command.stderr(Stdio::null()).stdout(Stdio::null());
    // A test that was started in the background would pass on that it ignores Ctrl-C.
    let set_death_signal = || {
        // SAFETY: the default action is no handler that could do harm.
        unsafe { signal(Signal::SIGINT, SigHandler::SigDfl) }?;
        Ok(())
    };
    // SAFETY: between fork and exec the closure makes one system call; it allocates nothing.
    unsafe { command.pre_exec(set_death_signal) };
    command.spawn().expect("the program starts")
}

#[test]
fn an_emulator_ends_with_the_program_however_that_ends() {
    let here = Directory::new("orphans");
    for (board, end) in [
        ("qemu-usart", Signal::SIGKILL),
        ("qemu-usart", Signal::SIGINT),
        ("qemu", Signal::SIGKILL),
        ("qemu", Signal::SIGTERM),
    ] {
        let name = format!("{board}-{end}");
        let (out, mut program) = (here.join(&name), start(&here, board, &name));
        // In the middle of the run: the log is under way.
        soon("the run begins", || {
            let mut files = fs::read_dir(&out).ok()?;
            files.next().map(drop)
        });
        let emulator = soon("the emulator runs", || child_of(program.id(), 0));
        let _guard = KillOnDrop(emulator);
        assert!(runs(emulator));
        kill(Pid::from_raw(program.id().cast_signed()), end).expect("it is ours");
        let status = program.wait().expect("it is ours");
        assert_eq!(status.signal(), Some(end as i32));
        soon("the emulator is gone", || (!runs(emulator)).then_some(()));
        for name in ["report.json", "log.csv", "bank.bin"] {
            assert!(!out.join(name).exists(), "{name} of a run that never ended");
        }
    }
}
