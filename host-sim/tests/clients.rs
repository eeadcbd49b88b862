//! Clients in one file each, in Python and in C, on a board at a pseudo-terminal.

use crate::serial::{ur5, with_board};
use crate::{Directory, assert_contains, python};
use foretorque::arm::Arm;
use foretorque::arm::ur5::{ParameterSet, Ur5};
use foretorque::feedforward::evaluate;
use foretorque::joint::{JointMotion, JointVector};
use foretorque_link::bank::NETWORK_SEED;
use foretorque_workbench::board::{Native, Transport};
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::report::write_json;
use foretorque_workbench::robot::Robot;
use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Mutex;
use std::time::Duration;

/// Pose in which the clients begin, rad.
const START: &str = "0,-1.2,1.6,-2,-1.57,0.3";

fn client(name: &str) -> PathBuf {
    let clients = Path::new(env!("CARGO_MANIFEST_DIR")).join("clients");
    clients.join(name)
}

/// A copy of a client with changes: each text, which occurs once, and what takes its place. On a busy machine it leaves no
/// period out.
fn altered(here: &Path, name: &str, changes: &[(&str, &str)]) -> PathBuf {
    let unhurried = match name.ends_with(".c") {
        true => ("if (late_s >= period_s)", "if (0)"),
        false => ("if late_s < chosen.period_s:", "if True:"),
    };
    changed(here, name, &[changes, &[unhurried]].concat())
}

fn changed(here: &Path, name: &str, changes: &[(&str, &str)]) -> PathBuf {
    let mut text = std::fs::read_to_string(client(name)).expect("it is there");
    for (from, to) in changes {
        assert_eq!(text.matches(from).count(), 1, "{name}: {from}");
        text = text.replace(from, to);
    }
    let copy = here.join(name);
    std::fs::write(&copy, text).expect("it can be written");
    copy
}

/// Changes to a client that outlasts the pauses of a busy machine: a board that is silent for long does not end it.
const PATIENT: (&str, &str) = ("SILENCE_S = 0.05", "SILENCE_S = 5.0");
/// Likewise, for single replies.
const NONE_LOST: (&str, &str) = ("REPLY_S = 0.01", "REPLY_S = 5.0");

fn patient(here: &Path, name: &str) -> PathBuf {
    altered(here, name, &[PATIENT, NONE_LOST])
}

/// A client in Python.
fn interpreted(python: &str, client: &Path) -> Command {
    let mut command = Command::new(python);
    command.arg("-B").arg(client);
    command
}

/// A client in C.
fn compiled(here: &Path, client: &Path) -> PathBuf {
    let program = here.join("client");
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-o"]);
    compiler.arg(&program).arg(client);
    let done = compiler.arg("-lm").output().expect("cc");
    let stderr = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{stderr}");
    program
}

/// The command of a client, given port, seconds and log.
type Client = Box<dyn Fn(&str, &str, &Path) -> Command>;

/// Both clients, with changes to the one in Python and to the one in C.
fn both(here: &Path, [in_python, in_c]: [&[(&str, &str)]; 2]) -> Vec<Client> {
    let python = altered(here, "foretorque.py", in_python);
    clients(here, python, &altered(here, "foretorque.c", in_c))
}

fn clients(here: &Path, client: PathBuf, in_c: &Path) -> Vec<Client> {
    let mut clients: Vec<Client> = Vec::new();
    if let Some(python) = python::with("termios") {
        clients.push(Box::new(move |port, seconds, log| {
            let mut command = interpreted(&python, &client);
            command.args([port, "--seconds", seconds, "--start", START, "--log"]);
            command.arg(log);
            command
        }));
    }
    let program = compiled(here, in_c);
    clients.push(Box::new(move |port, seconds, log| {
        let mut command = Command::new(&program);
        command.args([port, seconds]).arg(log).arg(START);
        command
    }));
    clients
}

/// A board that keeps the bytes it received.
struct Tap<'a>(Native<Ur5, 6, 40>, &'a Mutex<Vec<u8>>);

impl Transport for Tap<'_> {
    fn name(&self) -> String {
        self.0.name()
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.1.lock().expect("no panic").extend(bytes);
        self.0.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> std::io::Result<usize> {
        self.0.receive(buffer, timeout)
    }
}

/// Output of a client of a board, and the frames that the board received.
fn tapped(command: impl FnOnce(&str) -> Command) -> (Output, Vec<Vec<u8>>) {
    let received = Mutex::default();
    let output = with_board(Tap(ur5(), &received), |port| command(port).output());
    let received = received.into_inner().expect("no panic");
    let frames = received.split(|byte| *byte == 0).map(<[u8]>::to_vec);
    (output.expect("the client starts"), frames.collect())
}

/// Exit code and errors of a client of a board, and the tags of its messages.
fn ended(command: impl FnOnce(&str) -> Command) -> (Option<i32>, String, Vec<u8>) {
    let (output, frames) = tapped(command);
    let tags = frames.iter().filter_map(|frame| frame.get(TAG).copied());
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), stderr, tags.collect())
}

/// Place of the tag in a frame: behind the length of the first block, version and number.
const TAG: usize = 4;
/// Tags of messages to a board.
const SAMPLE: u8 = 1;
const CONFIGURE: u8 = 3;
const ARM: u8 = 10;
const DISARM: u8 = 11;
/// Tag of the reply to a sample.
const TORQUE: u8 = 1;

#[test]
fn clients_refuse_mistakes_before_they_arm() {
    let here = Directory::new("client-mistakes");
    let refuses = |client: &dyn Fn() -> Command, cases: &str| {
        for case in cases.split(" | ") {
            let (code, stderr, tags) = ended(|port| {
                let mut command = client();
                command.current_dir(&*here).arg(port).args(case.split(' '));
                command
            });
            assert_eq!(code, Some(2), "{case}: {stderr}");
            assert_contains(stderr.lines().last().expect("a line"), "error: ");
            assert!(!stderr.contains("Traceback"), "{stderr}");
            assert!(!tags.contains(&ARM), "{case}");
        }
    };
    if let Some(python) = python::with("termios") {
        let cases = "--seconds 0 | --seconds -1 | --seconds nan | --period-s 0 | --start 0,0,0 | --start 0,0,0,0,0,0,0 | --start a,b";
        let client = client("foretorque.py");
        refuses(&|| interpreted(&python, &client), cases);
    }
    let program = compiled(&here, &client("foretorque.c"));
    let cases = "0 | -1 | nan | 1 log.csv 0,0,0,0,0,0,0,0,0 | 1 log.csv 0,0,0 | 1 log.csv 0,0,0,0,0,0,0 | 1 log.csv a,b";
    refuses(&|| Command::new(&program), cases);
    assert!(here.files(".").iter().all(|name| name == "client"));
}

#[test]
fn a_client_sets_its_period_and_disarms_after_a_failure() {
    let Some(python) = python::with("termios") else {
        return;
    };
    let here = Directory::new("client-period");
    let client = patient(&here, "foretorque.py");
    let run = |options: &[&str]| {
        ended(|port| {
            let mut command = interpreted(&python, &client);
            command.current_dir(&*here).arg(port).args(options);
            command
        })
    };
    let (code, stderr, tags) = run(&["--seconds", "0.2", "--period-s", "0.002"]);
    assert_eq!(code, Some(0), "{stderr}");
    let place = |tag| tags.iter().position(|sent| *sent == tag);
    assert!(place(CONFIGURE).expect("it configures") < place(ARM).expect("it arms"));
    let table = here.text("log.csv");
    assert_eq!(table.lines().count(), 101);
    // From zero to the torque limit in 20 ms.
    let row = table.lines().nth(1).expect("a row");
    let shoulder = row.split(',').nth(26).expect("a torque");
    let shoulder = shoulder.parse::<f32>().expect("a number").abs();
    let expected = 0.1 * Ur5::LIMITS[1].torque;
    assert!((shoulder - expected).abs() < 1e-3, "{shoulder}");

    // Where the board refuses to arm, the log from before stays.
    let (code, stderr, _) = run(&["--start", "0,0,9,0,0,0"]);
    assert_eq!(code, Some(1), "{stderr}");
    assert_eq!(here.text("log.csv"), table);

    let (code, stderr, tags) = run(&["--log", "/dev/full"]);
    assert_eq!(code, Some(1));
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(tags.contains(&ARM) && tags.contains(&DISARM));
}

/// Real drives keep the last command: it must have no torque and no velocity, whatever has ended the loop.
const RECORDED: &str = "
import sys
sys.path.insert(0, sys.argv.pop(1))
import foretorque
sent = []
class Drives(foretorque.SimulatedDrives):
    def command(self, q, qd, torque):
        sent.append((qd, torque))
        super().command(q, qd, torque)
foretorque.SimulatedDrives = Drives
try:
    foretorque.main()
except OSError:
    pass
ramp = [max(map(abs, torque)) for _, torque in sent]
assert max(ramp) > 10, ramp
assert all(later >= 0 and later <= before for before, later in zip(ramp[-4:], ramp[-3:])), ramp[-4:]
assert not any(sent[-1][0]) and not any(sent[-1][1]), sent[-1]
";

#[test]
fn the_last_command_of_a_client_has_no_torque() {
    let Some(python) = python::with("termios") else {
        return;
    };
    let here = Directory::new("client-end");
    patient(&here, "foretorque.py");
    for log in ["log.csv", "/dev/full"] {
        let (code, stderr, _) = ended(|port| {
            let mut command = Command::new(&python);
            command.args(["-B", "-c", RECORDED]).arg(&*here);
            command.args([port, "--seconds", "0.3", "--log", log]);
            command.current_dir(&*here);
            command
        });
        assert_eq!(code, Some(0), "{log}: {stderr}");
    }
}

/// Rows of the log that a client writes while it drives a board of the UR5 for a second.
///
/// * `command` the client, given the port of the board
fn driven(log: &Path, command: impl FnOnce(&str) -> Command) -> Vec<Vec<f64>> {
    let (output, frames) = tapped(command);
    let samples = frames
        .iter()
        .filter(|frame| frame.get(TAG) == Some(&SAMPLE));
    // Behind the flags the temperature of a motor, °C.
    assert!(samples.map(|frame| frame[6]).all(|celsius| celsius == 25));
    let (rows, lost) = logged(log, &output);
    assert_eq!((rows.len(), lost), (1000, 0));
    rows
}

/// Rows of the log of a client that succeeded, and the replies that it missed.
fn logged(log: &Path, output: &Output) -> (Vec<Vec<f64>>, usize) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let stdout = String::from_utf8_lossy(&output.stdout);
    let shown = stdout.strip_prefix("ur5, 6 joints\n1000 ticks, ");
    let lost = shown.and_then(|shown| shown.split_once(" without a reply"));
    let lost = lost.and_then(|(lost, _)| lost.parse().ok());
    let text = std::fs::read_to_string(log).expect("it was written");
    let rows = text.lines().skip(1);
    let number = |field: &str| field.parse().expect("a number");
    let rows = rows.map(|row| row.split(',').map(number).collect());
    (rows.collect(), lost.unwrap_or_else(|| panic!("{stdout}")))
}

/// Both ends of a row: the torque is that of the description for the motion asked for.
fn torques_are_those_of_the_description(rows: &[Vec<f64>]) {
    let set = ParameterSet::nominal::<Ur5>(NETWORK_SEED);
    let vector =
        |row: &[f64], first: usize| JointVector::<6>::from_fn(|j, _| row[1 + 6 * first + j] as f32);
    // The torque has risen by the slew limit; the position asked for is measured in the next tick, whose reply may be lost.
    for pair in rows[rows.len() - 200..].windows(2) {
        if pair[1][0] - pair[0][0] > 1.5e-3 {
            continue;
        }
        let motion = JointMotion {
            q: vector(&pair[1], 0),
            qd: vector(&pair[0], 1),
            qdd: vector(&pair[0], 2),
        };
        let expected = evaluate::<Ur5, 6, 40>(&set, &motion).total;
        let sent = vector(&pair[0], 4);
        assert!((expected - sent).amax() < 0.02, "{expected} {sent}");
    }
}

#[test]
fn python_and_c_drive_a_board_and_get_the_same_torques() {
    let here = Directory::new("clients");
    let log = here.join("log.csv");
    let clients = both(&here, [&[PATIENT, NONE_LOST]; 2]);
    let logs = clients
        .iter()
        .map(|client| driven(&log, |port| client(port, "1", &log)));
    let logs: Vec<_> = logs.collect();
    for rows in &logs {
        torques_are_those_of_the_description(rows);
    }
    if let [python, c] = &logs[..] {
        let torques = |rows: &[Vec<f64>]| -> Vec<f32> {
            let torques = rows.iter().flat_map(|row| &row[25..31]);
            torques.map(|tau| *tau as f32).collect()
        };
        assert!(torques(python) == torques(c), "the torques differ");
    }
}

/// A board whose replies pass through `carry`, which returns the bytes that arrive in the place of a frame.
struct Flawed<F>(Native<Ur5, 6, 40>, F, VecDeque<u8>);

impl<F: FnMut(Vec<u8>) -> Vec<u8>> Transport for Flawed<F> {
    fn name(&self) -> String {
        self.0.name()
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.0.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> std::io::Result<usize> {
        let count = self.0.receive(buffer, timeout)?;
        for frame in buffer[..count].split_inclusive(|byte| *byte == 0) {
            self.2.extend((self.1)(frame.to_vec()));
        }
        self.2.read(buffer)
    }
}

/// Output of a client of a board whose replies pass through `carry`.
fn flawed(
    carry: impl FnMut(Vec<u8>) -> Vec<u8> + Send,
    command: impl FnOnce(&str) -> Command,
) -> Output {
    let board = Flawed(ur5(), carry, VecDeque::new());
    with_board(board, |port| command(port).output()).expect("the client starts")
}

/// Drives that show torque and velocity of each command, N·m and rad/s, and a client that shows what it sends.
const SHOWN: [&[(&str, &str)]; 2] = [
    &[
        (
            "def command(self, q, qd, torque):",
            "def command(self, q, qd, torque):
        for joint in zip(torque, qd): print('drive', *joint)",
        ),
        (
            "self.sequence = self.sequence %",
            "print('sent', message[0]); self.sequence = self.sequence %",
        ),
    ],
    &[
        (
            "static void drives_command(const struct sample *desired, const float *torque, int joints) {",
            "static void drives_command(const struct sample *desired, const float *torque, int joints) {
    for (int j = 0; j < joints; j++) printf(\"drive %g %g\\n\", torque[j], desired->qd[j]);",
        ),
        (
            "board->sequence = (uint16_t)",
            "printf(\"sent %d\\n\", message[0]); board->sequence = (uint16_t)",
        ),
    ],
];

/// Torque and velocity of every joint in every command to the drives.
fn commands(shown: &str) -> Vec<[f32; 2]> {
    let joints = shown.lines().filter_map(|line| line.strip_prefix("drive "));
    let pairs = joints.map(|joint| joint.split_once(' ').expect("two numbers"));
    let number = |text: &str| text.parse().expect("a number");
    pairs
        .map(|(torque, speed)| [torque, speed].map(number))
        .collect()
}

#[test]
fn a_client_ends_the_torque_when_the_board_falls_silent() {
    let here = Directory::new("client-silence");
    let log = here.join("log.csv");
    for client in both(&here, SHOWN) {
        // After 20 samples to arm on and 300 ticks: in the run, at the disarming, in the ramp.
        for answered in [170, 320, 321] {
            let mut torques = 0;
            let carry = |frame: Vec<u8>| {
                if torques == answered {
                    return Vec::new();
                }
                torques += u32::from(frame.get(TAG) == Some(&TORQUE));
                frame
            };
            let output = flawed(carry, |port| client(port, "0.3", &log));
            assert_eq!(output.status.code(), Some(1), "{answered}");
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!(stderr, "error: the board has been silent for 50 ms\n");

            let shown = String::from_utf8_lossy(&output.stdout);
            // Each wait is 10 ms at least, and all of them 50 ms.
            let sent = shown.lines().filter(|line| *line == "sent 1").count();
            assert!(sent <= answered as usize + 6, "{answered}: {sent} samples");
            let rest = [[0.0; 2]; 6];
            let all = commands(&shown);
            assert!(all.iter().any(|[torque, _]| torque.abs() > 10.0));
            assert!(all.ends_with(&rest), "{answered}");
            if answered < 320 {
                let (before, _) = shown.split_once("sent 11\n").expect("it disarms");
                assert!(commands(before).ends_with(&rest), "first the drives");
            }
        }
    }
}

#[test]
fn a_slow_link_and_a_hang_up_end_the_torque_of_a_client() {
    let here = Directory::new("client-slow");
    let (log, process) = (here.join("log.csv"), here.join("process"));
    let [python, c] = SHOWN;
    let python = changed(&here, "foretorque.py", python);
    for client in clients(&here, python, &changed(&here, "foretorque.c", c)) {
        for (pause_ms, hangs_up, message) in [
            (5, false, "error: link or program are too slow: "),
            (0, true, "error: "),
        ] {
            let mut torques = 0;
            let carry = |frame: Vec<u8>| {
                torques += u32::from(frame.get(TAG) == Some(&TORQUE));
                std::thread::sleep(Duration::from_millis(pause_ms));
                if hangs_up && torques == 60 {
                    let process = std::fs::read_to_string(&process).expect("it runs");
                    let mut kill = Command::new("sh");
                    kill.args(["-c", &format!("kill -HUP {process}")]);
                    assert!(kill.status().expect("a shell").success());
                }
                frame
            };
            let output = flawed(carry, |port| {
                let client = client(port, "3", &log);
                let mut shell = Command::new("sh");
                shell.args(["-c", r#"printf $$ > "$0"; exec "$@""#]);
                shell.arg(&process).arg(client.get_program());
                shell.args(client.get_args());
                shell
            });
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{stderr}");
            assert!(stderr.starts_with(message), "{stderr}");
            let all = commands(&String::from_utf8_lossy(&output.stdout));
            assert!(all.iter().any(|[torque, _]| torque.abs() > 1.0));
            assert!(all.ends_with(&[[0.0; 2]; 6]), "{stderr}");
        }
    }
}

#[test]
fn a_lost_reply_does_not_end_the_run_of_a_client() {
    let here = Directory::new("client-lost");
    let log = here.join("log.csv");
    for client in both(&here, [&[PATIENT]; 2]) {
        let (mut torques, mut held) = (0, Vec::new());
        let carry = |mut frame: Vec<u8>| {
            if frame.get(TAG) != Some(&TORQUE) {
                return frame;
            }
            torques += 1;
            match torques % 150 {
                0 => return Vec::new(),
                // Damaged: another byte, which is no end of a frame.
                50 => frame[9] = frame[9] % 255 + 1,
                // Late: it arrives before the reply to another sample.
                100 => held = std::mem::take(&mut frame),
                125 => return [std::mem::take(&mut held), frame].concat(),
                _ => {}
            }
            frame
        };
        let output = flawed(carry, |port| client(port, "1", &log));
        let (rows, lost) = logged(&log, &output);
        assert!((20..200).contains(&lost), "{lost}");
        assert_eq!(rows.len() + lost, 1000);
        torques_are_those_of_the_description(&rows);
    }
}

#[test]
fn a_client_drives_a_board_that_a_run_has_left_after_its_excitation() {
    let here = Directory::new("client-after");
    let robot = Robot::load("ur5").expect("built in");
    let excitation = Excitation::quick(&robot, 1, 2.0, 200, || ()).expect("the UR5 can move");
    write_json(&here.join("e.json"), &excitation).expect("it can be written");
    let log = here.join("log.csv");
    let [.., client] = &both(&here, [&[PATIENT, NONE_LOST]; 2])[..] else {
        panic!("no client");
    };
    let output = with_board(ur5(), |port| {
        let run = "run --robot ur5 --trajectory e.json --excite-on-board --keep-going --out run";
        here.succeeds(format!("{run} --board serial:{port}"));
        client(port, "0.1", &log).output()
    });
    let output = output.expect("the client starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
}
