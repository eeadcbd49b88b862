//! Logs of a known arm, and the command `identify` on them.

use crate::program::{host_sim, json, succeeds};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::write_motion;
use serde_json::Value;
use std::path::Path;
use std::process::Output;

const N: usize = 6;
const PERIOD_S: f64 = 0.005;

/// A motion of all joints but `still`, with three tones each.
fn motion(t_s: f64, phase: f64, still: Option<usize>) -> State<N> {
    let mut state = State::rest(Joints::zeros());
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
    let rows = (0..rows).map(|row| {
        let t_s = row as f64 * PERIOD_S;
        let state = motion(t_s, phase, still);
        let mut tau = model.inverse_dynamics(&state);
        for (joint, tau) in tau.iter_mut().enumerate() {
            *tau += robot.joints[joint].friction.sliding(state.qd[joint]);
            // Deterministic, far above the bandwidth of the motion.
            *tau += noise * ((row * (7 + joint)) as f64 * 1.7).sin();
        }
        (t_s, state, [tau])
    });
    write_motion(path, ["tau"], rows).expect("writes");
}

/// Output of `identify` in a directory.
pub(crate) fn identify(directory: &Path, arguments: &str) -> Output {
    host_sim(directory, &format!("identify --robot ur5 {arguments}"))
}

/// Standard output and report of a successful `identify` into `out`.
pub(crate) fn identified(directory: &Path, arguments: &str) -> (String, Value) {
    let arguments = format!("identify --robot ur5 --out out {arguments}");
    let stdout = succeeds(directory, &arguments);
    (stdout, json(directory.join("out/report.json")))
}
