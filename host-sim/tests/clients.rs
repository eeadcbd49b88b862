//! The clients in one file each, with a board on a pseudo-terminal.

use crate::program::PlayedBoard;
use crate::program::{directory, text};
use crate::python;
use foretorque::arm::ur5::{ParameterSet, Ur5};
use foretorque::feedforward::evaluate;
use foretorque::joint::{JointMotion, JointVector};
use foretorque_link::bank::NETWORK_SEED;
use foretorque_workbench::board::Native;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Pose in which the clients begin, rad.
const START: &str = "0,-1.2,1.6,-2,-1.57,0.3";

fn client(name: &str) -> PathBuf {
    let clients = Path::new(env!("CARGO_MANIFEST_DIR")).join("clients");
    clients.join(name)
}

/// Rows of the log that a client writes while it drives a board of the UR5 for a second.
///
/// * `command` the client, given the port of the board
fn driven(log: &Path, command: impl FnOnce(&str) -> Command) -> Vec<Vec<f64>> {
    let native = Native::<Ur5, 6, 40>::new().expect("the arm's limits are usable");
    let board = PlayedBoard::start(native);
    let mut command = command(&board.port);
    let output = command.output().expect("the client starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let stdout = String::from_utf8_lossy(&output.stdout);
    assert!(stdout.starts_with("ur5, 6 joints\n"), "{stdout}");
    let text = text(log);
    let rows = text.lines().skip(1);
    let number = |field: &str| field.parse().expect("a number");
    rows.map(|row| row.split(',').map(number).collect())
        .collect()
}

/// Both ends of a row: the torque is that of the description for the motion asked for.
fn torques_are_those_of_the_description(rows: &[Vec<f64>]) {
    assert_eq!(rows.len(), 1000);
    let set = ParameterSet::nominal::<Ur5>(NETWORK_SEED);
    let vector =
        |row: &[f64], first: usize| JointVector::<6>::from_fn(|j, _| row[1 + 6 * first + j] as f32);
    // The torque has risen by the slew limit; the position asked for is measured in the row after.
    for pair in rows[800..].windows(2) {
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
    let here = directory("clients");
    let mut logs = Vec::new();
    if let Some(python) = python::with("termios") {
        let log = here.join("python.csv");
        logs.push(driven(&log, |port| {
            let mut command = Command::new(python);
            command.arg("-B").arg(client("foretorque.py")).arg(port);
            command.args(["--seconds", "1", "--start", START, "--log"]);
            command.arg(&log);
            command
        }));
    }
    let program = here.join("client");
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-o"]);
    compiler
        .arg(&program)
        .arg(client("foretorque.c"))
        .arg("-lm");
    match compiler.output() {
        Err(error) => println!("skipped: cc: {error}"),
        Ok(done) => {
            let stderr = String::from_utf8_lossy(&done.stderr);
            assert!(done.status.success(), "{stderr}");
            let log = here.join("c.csv");
            logs.push(driven(&log, |port| {
                let mut command = Command::new(&program);
                command.args([port, "1"]).arg(&log).arg(START);
                command
            }));
        }
    }
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
