//! Logs of a known arm, and the command `identify` on them.

use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::{TableWriter, joint_columns, state_columns};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const N: usize = 6;
const PERIOD_S: f64 = 0.005;

/// A directory that is removed at the end of its test.
pub(crate) struct Directory(PathBuf);

impl Directory {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("foretorque-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("creates");
        Self(path)
    }

    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A motion of all joints but `still`, with three tones each.
fn motion(t_s: f64, phase: f64, still: Option<usize>) -> State<N> {
    let zero = Joints::zeros();
    let mut state = State {
        q: zero,
        qd: zero,
        qdd: zero,
    };
    for joint in (0..N).filter(|joint| Some(*joint) != still) {
        for tone in 1..=3 {
            let w = 0.9 * f64::from(tone) + 0.13 * joint as f64;
            let a = w * t_s + phase + joint as f64 * f64::from(tone);
            state.q[joint] += 0.5 / f64::from(tone) * a.sin();
            state.qd[joint] += 0.5 / f64::from(tone) * w * a.cos();
            state.qdd[joint] -= 0.5 / f64::from(tone) * w * w * a.sin();
        }
    }
    state
}

/// A log of `rows` rows of the robot of the description with viscous and Coulomb friction.
pub(crate) fn log(path: &Path, rows: usize, phase: f64, still: Option<usize>, noise: f64) {
    let robot = Robot::load("ur5").expect("built in");
    log_of(&robot, path, rows, phase, still, noise);
}

/// A log of another robot.
pub(crate) fn log_of(
    robot: &Robot,
    path: &Path,
    rows: usize,
    phase: f64,
    still: Option<usize>,
    noise: f64,
) {
    let model = ReferenceModel::<N>::new(robot).expect("six joints");
    let mut header = vec!["t_s".to_owned()];
    header.extend(state_columns(N));
    header.extend(joint_columns("tau", "nm", N));
    let mut table = TableWriter::create(path, &header).expect("creates");
    for row in 0..rows {
        let t_s = row as f64 * PERIOD_S;
        let state = motion(t_s, phase, still);
        let mut tau = model.inverse_dynamics(&state);
        for (joint, tau) in tau.iter_mut().enumerate() {
            let friction = &robot.joints[joint].friction;
            let qd = state.qd[joint];
            *tau += friction.viscous * qd
                + friction.coulomb * (qd / f64::from(foretorque::dynamics::SIGN_WIDTH)).tanh();
            // Deterministic, far above the bandwidth of the motion.
            *tau += noise * ((row * (7 + joint)) as f64 * 1.7).sin();
        }
        let parts = [&state.q, &state.qd, &state.qdd, &tau];
        let values = parts.iter().flat_map(|part| part.iter().copied());
        table
            .row(std::iter::once(t_s).chain(values))
            .expect("writes");
    }
    table.finish().expect("finishes");
}

impl Directory {
    /// Output of a command of the program, run in this directory.
    pub(crate) fn run(&self, arguments: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_host-sim"))
            .args(arguments.split_whitespace())
            .current_dir(&self.0)
            .output()
            .expect("runs")
    }

    /// Output of `identify` on logs of this directory.
    pub(crate) fn identify(&self, arguments: &str) -> Output {
        self.run(&format!("identify --robot ur5 {arguments}"))
    }

    /// Standard output of a command that succeeds.
    pub(crate) fn succeeds(&self, arguments: &str) -> String {
        let output = self.run(arguments);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    /// Standard output and report of a successful `identify` into `out`.
    pub(crate) fn identified(&self, arguments: &str) -> (String, serde_json::Value) {
        let stdout = self.succeeds(&format!("identify --robot ur5 --out out {arguments}"));
        let text = fs::read_to_string(self.file("out/report.json")).expect("written");
        (stdout, serde_json::from_str(&text).expect("JSON"))
    }
}
