//! The program in a directory of its own, as its users call it, and a board of this process on a pseudo-terminal.

use foretorque_workbench::board::Transport;
use serde_json::Value;
use serialport::{SerialPort, TTYPort};
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// An empty directory for one test.
pub(crate) fn directory(name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-{name}"));
    let _ = fs::remove_dir_all(&directory);
    fs::create_dir_all(&directory).expect("the directory of the tests can be written");
    directory
}

/// The program with arguments separated by spaces.
pub(crate) fn command(directory: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    let arguments = arguments.split_whitespace();
    command.current_dir(directory).args(arguments);
    command.stdin(Stdio::null());
    command
}

pub(crate) fn host_sim(directory: &Path, arguments: &str) -> Output {
    let output = command(directory, arguments).output();
    output.expect("the program starts")
}

/// Standard output of a run that succeeds.
pub(crate) fn succeeds(directory: &Path, arguments: &str) -> String {
    let output = host_sim(directory, arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "`{arguments}` wrote {stderr}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// The one line that the program fails with.
pub(crate) fn fails(directory: &Path, arguments: &str) -> String {
    failure(arguments, &host_sim(directory, arguments))
}

/// Fails in one line that has `words` in it.
pub(crate) fn refused(directory: &Path, arguments: &str, words: impl AsRef<str>) {
    let line = fails(directory, arguments);
    assert!(line.contains(words.as_ref()), "`{arguments}` wrote {line}");
}

/// The one line of a run that failed.
pub(crate) fn failure(arguments: &str, output: &Output) -> String {
    let stderr = String::from_utf8(output.stderr.clone()).expect("UTF-8");
    // 2 for a wrong command line, of which an option is named first.
    let usage = stderr.starts_with("error: --") || stderr.trim_end().ends_with("(see --help)");
    let code = Some(1 + i32::from(usage));
    let line = stderr.starts_with("error: ") && stderr.lines().count() == 1;
    let sound = output.status.code() == code && line && !stderr.contains("panicked");
    assert!(sound, "`{arguments}` wrote {stderr}");
    stderr
}

/// Names of the files in a directory, sorted.
pub(crate) fn files(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).expect("it is there");
    let names = entries.map(|entry| entry.expect("it is there").file_name());
    let mut names: Vec<_> = names.map(|name| name.to_string_lossy().into()).collect();
    names.sort();
    names
}

/// The finding of `look` within a minute.
pub(crate) fn soon<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Content of a text file.
pub(crate) fn text(path: impl AsRef<Path>) -> String {
    let path = path.as_ref();
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Content of a JSON file.
pub(crate) fn json(path: impl AsRef<Path>) -> Value {
    serde_json::from_str(&text(path)).expect("it is JSON")
}

pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

pub(crate) fn write(path: impl AsRef<Path>, content: impl AsRef<[u8]>) {
    fs::write(path, content).expect("it can be written");
}

/// Header of a table of states of an arm of `joints` joints.
fn state_header(joints: usize) -> String {
    let columns = [("q", "rad"), ("qd", "rad_s"), ("qdd", "rad_s2")].into_iter();
    let names = columns
        .flat_map(|(name, unit)| (1..=joints).map(move |joint| format!("{name}{joint}_{unit}")));
    names.collect::<Vec<_>>().join(",")
}

/// States of an arm of `joints` joints, all of them with one value in all columns.
pub(crate) fn states_of(joints: usize, values: &[f64]) -> String {
    let rows = values
        .iter()
        .map(|v| vec![v.to_string(); 3 * joints].join(","));
    let lines = std::iter::once(state_header(joints)).chain(rows);
    lines.map(|line| line + "\n").collect()
}

/// Two states of an arm of `joints` joints.
pub(crate) fn states(joints: usize) -> String {
    states_of(joints, &[0.25, -0.5])
}

/// States of an arm of `joints` joints that stand still at zero, at these times, s.
pub(crate) fn still(joints: usize, times: &[&str]) -> String {
    let zeros = states_of(joints, &vec![0.0; times.len()]);
    let lines = ["t_s"].iter().chain(times).zip(zeros.lines());
    lines.map(|(t_s, row)| format!("{t_s},{row}\n")).collect()
}

/// A board on a pseudo-terminal, until it goes out of scope.
pub(crate) struct PlayedBoard {
    pub(crate) port: String,
    done: Arc<AtomicBool>,
    player: Option<JoinHandle<()>>,
}

impl PlayedBoard {
    /// Lets `board` answer.
    pub(crate) fn start(mut board: impl Transport + Send + 'static) -> Self {
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
                // A host that has received enough hangs up.
                let _ = line.write_all(&buffer[..count]);
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
