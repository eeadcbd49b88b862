//! The program as its users call it, in a directory of its own. One test crate: the program's parts are linked once.

mod bad_input;
mod cli;
mod cli_bus;
mod clients;
mod excitation;
mod identification;
mod logs;
#[path = "../../tests/python.rs"]
mod python;
mod serial;

use foretorque_workbench::table::state_columns;
use serde_json::Value;
use serialport::{SerialPort, TTYPort};
use std::fs;
use std::ops::Deref;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The directory of one test, empty at first, in which the program runs.
struct Directory(PathBuf);

impl Deref for Directory {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Directory {
    fn new(name: &str) -> Self {
        let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-{name}"));
        let _ = fs::remove_dir_all(&directory);
        fs::create_dir_all(&directory).expect("the directory of the tests can be written");
        Self(directory)
    }

    /// The program with arguments separated by spaces.
    fn command(&self, arguments: impl AsRef<str>) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
        let arguments = arguments.as_ref().split_whitespace();
        command.current_dir(&self.0).args(arguments);
        command.stdin(Stdio::null());
        command
    }

    fn run(&self, arguments: impl AsRef<str>) -> Output {
        self.command(arguments).output().expect("it starts")
    }

    /// Standard output of a run that succeeds.
    #[track_caller]
    fn succeeds(&self, arguments: impl AsRef<str>) -> String {
        let arguments = arguments.as_ref();
        let output = self.run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "`{arguments}` wrote {stderr}");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    /// Succeeds, with `words` on standard output.
    #[track_caller]
    fn shows(&self, arguments: impl AsRef<str>, words: impl AsRef<str>) {
        assert_contains(&self.succeeds(arguments), words);
    }

    /// The one line that the program fails with.
    #[track_caller]
    fn fails(&self, arguments: impl AsRef<str>) -> String {
        failure(arguments.as_ref(), &self.run(&arguments))
    }

    /// Fails in one line that has `words` in it.
    #[track_caller]
    fn refused(&self, arguments: impl AsRef<str>, words: impl AsRef<str>) {
        assert_contains(&self.fails(arguments), words);
    }

    /// Names of the files in a directory below this one, sorted.
    fn files(&self, below: impl AsRef<Path>) -> Vec<String> {
        let entries = fs::read_dir(self.join(below)).expect("it is there");
        let names = entries.map(|entry| entry.expect("it is there").file_name());
        let mut names: Vec<_> = names.map(|name| name.to_string_lossy().into()).collect();
        names.sort();
        names
    }

    #[track_caller]
    fn text(&self, name: impl AsRef<Path>) -> String {
        let path = self.join(name);
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    #[track_caller]
    fn json(&self, name: impl AsRef<Path>) -> Value {
        serde_json::from_str(&self.text(name)).expect("it is JSON")
    }

    fn write(&self, name: impl AsRef<Path>, content: impl AsRef<[u8]>) {
        fs::write(self.join(name), content).expect("it can be written");
    }
}

/// The one line of a run that failed.
#[track_caller]
fn failure(arguments: &str, output: &Output) -> String {
    let stderr = String::from_utf8(output.stderr.clone()).expect("UTF-8");
    // 2 for a wrong command line, of which an option is named first.
    let usage = stderr.starts_with("error: --") || stderr.trim_end().ends_with("(see --help)");
    let code = Some(1 + i32::from(usage));
    let line = stderr.starts_with("error: ") && stderr.lines().count() == 1;
    let sound = output.status.code() == code && line && !stderr.contains("panicked");
    assert!(sound, "`{arguments}` wrote {stderr}");
    stderr
}

/// The finding of `look` within a minute.
fn soon<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[track_caller]
fn assert_contains(text: &str, words: impl AsRef<str>) {
    let words = words.as_ref();
    assert!(text.contains(words), "no `{words}` in: {text}");
}

/// Output of `work` with the port of a pseudo-terminal, at whose other end `play` is called again and again.
fn at_port<T>(mut play: impl FnMut(&mut TTYPort) + Send, work: impl FnOnce(&str) -> T) -> T {
    let (mut line, end) = TTYPort::pair().expect("the system has pseudo-terminals");
    let port = end.name().expect("it has a name");
    drop(end);
    let timeout = Duration::from_millis(5);
    line.set_timeout(timeout).expect("it has a timeout");
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                play(&mut line);
            }
        });
        // A test that fails must not wait for a player that never ends.
        let outcome = catch_unwind(AssertUnwindSafe(|| work(&port)));
        done.store(true, Ordering::Relaxed);
        outcome.unwrap_or_else(|panic| resume_unwind(panic))
    })
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// States of an arm of `joints` joints, all of them with one value in all columns.
fn states_of(joints: usize, values: &[f64]) -> String {
    let rows = values
        .iter()
        .map(|v| vec![v.to_string(); 3 * joints].join(","));
    let lines = std::iter::once(state_columns(joints).join(",")).chain(rows);
    lines.map(|line| line + "\n").collect()
}

fn states(joints: usize) -> String {
    states_of(joints, &[0.25, -0.5])
}

/// States of an arm of `joints` joints that stand still at zero, at these times, s.
fn still(joints: usize, times: &[&str]) -> String {
    let zeros = states_of(joints, &vec![0.0; times.len()]);
    let lines = ["t_s"].iter().chain(times).zip(zeros.lines());
    lines.map(|(t_s, row)| format!("{t_s},{row}\n")).collect()
}
