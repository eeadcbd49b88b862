//! However the program ends, no emulator outlives it, and no report is left half written.

use crate::program::{directory, soon, write};
use foretorque_workbench::excitation::{Excitation, QuickConfig};
use foretorque_workbench::robot::Robot;
use nix::sys::signal::{SigHandler, Signal, kill, signal};
use nix::unistd::Pid;
use std::fs;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

/// State and parent of a process; `None` when there is no such process.
fn status(id: i32) -> Option<(char, i32)> {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    // The name, in brackets, may contain anything.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    Some((fields.next()?.chars().next()?, fields.next()?.parse().ok()?))
}

fn runs(id: i32) -> bool {
    // A process that ended may wait to be reaped.
    status(id).is_some_and(|(state, _)| !matches!(state, 'Z' | 'X'))
}

/// A child of `parent`.
fn child_of(parent: i32) -> Option<i32> {
    let processes = fs::read_dir("/proc").expect("the system has /proc");
    let ids = processes.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    ids.into_iter()
        .find(|&id| status(id).is_some_and(|(_, of)| of == parent))
}

/// Ends the emulator of a test that failed, which nothing else would.
struct Undertaker(i32);

impl Drop for Undertaker {
    fn drop(&mut self) {
        if std::thread::panicking() && runs(self.0) {
            let _ = kill(Pid::from_raw(self.0), Signal::SIGKILL);
        }
    }
}

/// Starts a run of an hour on an emulated board.
fn start(board: &str, out: &PathBuf) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command
        .args(["run", "--robot", "ur5", "--trajectory"])
        .arg(out.with_extension("json"))
        .args(["--duration-s", "3600", "--board", board, "--out"])
        .arg(out)
        .stderr(Stdio::null())
        .stdout(Stdio::null());
    // A test that was started in the background would pass on that it ignores Ctrl-C.
    let hear = || {
        // SAFETY: the default action is no handler that could do harm.
        unsafe { signal(Signal::SIGINT, SigHandler::SigDfl) }?;
        Ok(())
    };
    // SAFETY: between fork and exec the closure makes one system call; it allocates nothing.
    unsafe { command.pre_exec(hear) };
    command.spawn().expect("the program starts")
}

#[test]
fn an_emulator_ends_with_the_program_however_that_ends() {
    let directory = directory("orphans");
    let quick = QuickConfig {
        candidates: 1,
        ..QuickConfig::default()
    };
    let robot = Robot::load("ur5").expect("it is built in");
    let excitation = Excitation::quick(&robot, 1, &quick, || ()).expect("one candidate");
    let excitation = serde_json::to_vec(&excitation).expect("plain numbers");
    for (place, (board, end)) in [
        ("qemu-usart", Signal::SIGKILL),
        ("qemu-usart", Signal::SIGINT),
        ("qemu", Signal::SIGKILL),
        ("qemu", Signal::SIGTERM),
    ]
    .into_iter()
    .enumerate()
    {
        let out = directory.join(format!("{place}"));
        write(out.with_extension("json"), &excitation);
        let mut program = start(board, &out);
        let id = program.id() as i32;
        // In the middle of the run: the log is under way.
        soon("the run begins", || {
            let mut files = fs::read_dir(&out).ok()?;
            files.next().map(drop)
        });
        let emulator = soon("the emulator runs", || child_of(id));
        let _undertaker = Undertaker(emulator);
        assert!(runs(emulator));
        kill(Pid::from_raw(id), end).expect("it is ours");
        let status = program.wait().expect("it is ours");
        assert_eq!(status.signal(), Some(end as i32));
        soon("the emulator is gone", || (!runs(emulator)).then_some(()));
        for name in ["report.json", "log.csv", "bank.bin"] {
            assert!(!out.join(name).exists(), "{name} of a run that never ended");
        }
    }
}
