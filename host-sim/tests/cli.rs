//! The program as its users call it: what it makes, and the one line it gives when it cannot.

use crate::program::{directory, fails, files, json, refused, states, succeeds, text, write};
use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMotion, JointVector};
use std::fs;
use std::path::Path;

#[test]
fn torque_is_that_of_the_firmware_for_every_arm_it_knows() {
    fn check<A: Arm<N, P>, const N: usize, const P: usize>() {
        let directory = directory(&format!("torque-{}", A::NAME));
        write(directory.join("states.csv"), states(N));
        succeeds(
            &directory,
            &format!("torque --robot {} --in states.csv --out tau.csv", A::NAME),
        );
        let table = text(directory.join("tau.csv"));
        let rows: Vec<&str> = table.lines().skip(1).collect();
        assert_eq!(rows.len(), 2);
        let beta = nalgebra::SVector::from(A::NOMINAL);
        for (row, value) in rows.iter().zip([0.25, -0.5]) {
            let all = JointVector::<N>::repeat(value);
            let motion = JointMotion {
                q: all,
                qd: all,
                qdd: all,
            };
            let wanted = foretorque::dynamics::rnea::<A, N, P>(&beta, &motion);
            let torque: Vec<f32> = row
                .split(',')
                .map(|tau| tau.parse().expect("a number"))
                .collect();
            assert_eq!(torque, wanted.as_slice(), "{} at {value}", A::NAME);
        }
    }
    check::<Ur5, 6, 40>();
    check::<Panda, 7, 48>();
}

#[test]
fn an_arm_of_seven_joints_runs_in_a_closed_loop_and_learns() {
    let directory = directory("panda-run");
    succeeds(
        &directory,
        "run --robot panda --trajectory validation --duration-s 0.5 --learn --out out",
    );
    let report = json(directory.join("out/report.json"));
    assert_eq!(report["robot"], "panda");
    assert_eq!(report["ticks"], 500);
    assert_eq!(
        report["tracking_rms_joint_mrad"].as_array().map(Vec::len),
        Some(7)
    );
    let stderr = succeeds(&directory, "bank out/bank.bin");
    assert!(
        stderr.contains("usable    yes, on a board that drives panda"),
        "{stderr}"
    );
}

#[test]
fn a_described_robot_has_an_arm_and_an_unknown_one_is_refused() {
    let directory = directory("no-arm");
    let ur5 = include_str!("../robots/ur5.toml");
    let other = ur5.replacen("name = \"ur5\"", "name = \"ur99\"", 1);
    write(directory.join("other.toml"), other);
    write(directory.join("states.csv"), states(6));
    // Read at run time: the arm of another name has the torques of the built-in one.
    for (robot, out) in [("other.toml", "other.csv"), ("ur5", "ur5.csv")] {
        succeeds(
            &directory,
            &format!("torque --robot {robot} --in states.csv --out {out}"),
        );
    }
    let read = |name| text(directory.join(name));
    assert_eq!(read("other.csv"), read("ur5.csv"));
    refused(
        &directory,
        "torque --robot ur7 --in states.csv --out tau.csv",
        "unknown robot 'ur7'",
    );
    assert!(!directory.join("tau.csv").exists());
}

#[test]
fn an_arm_module_is_generated_from_a_urdf() {
    let directory = directory("generate");
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/panda.urdf");
    succeeds(
        &directory,
        &format!("generate --urdf {urdf} --out panda.rs"),
    );
    succeeds(&directory, "generate --robot ur5 --out ur5.rs");
    let arms = Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/foretorque/src/arm");
    for name in ["panda.rs", "ur5.rs"] {
        let same = text(directory.join(name)) == text(arms.join(name));
        assert!(same, "the committed {name} is another one");
    }
}

#[test]
fn a_urdf_that_is_none_or_has_no_such_link_is_refused() {
    let directory = directory("bad-urdf");
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/panda.urdf");
    write(directory.join("broken.urdf"), "<robot><link");
    for (arguments, named) in [
        ("--urdf missing.urdf --out arm.rs", "missing.urdf"),
        ("--urdf broken.urdf --out arm.rs", "broken.urdf"),
        ("--urdf URDF --tip elbow_9 --out arm.rs", "elbow_9"),
        ("--urdf URDF --base nowhere --out arm.rs", "nowhere"),
        ("--urdf URDF --out Arm-1.rs", "Arm-1.rs"),
        // What belongs to a URDF is refused without one.
        ("--robot ur5 --tip tool --out arm.rs", "--tip"),
    ] {
        let arguments = format!("generate {}", arguments.replace("URDF", urdf));
        refused(&directory, &arguments, named);
    }
    assert_eq!(files(&directory), ["broken.urdf"]);
}

#[test]
fn a_path_of_the_tool_is_played_wherever_a_trajectory_is() {
    let directory = directory("tool-path");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("paths/ur5.toml");
    fs::copy(&path, directory.join("path.toml")).expect("copies");
    succeeds(
        &directory,
        "torque --robot ur5 --trajectory path.toml --out tau.csv",
    );
    let rows = text(directory.join("tau.csv"));
    assert_eq!(rows.lines().count(), 8502, "8.5 s, a row each millisecond");
    for command in ["simulate --out log.csv", "run --out out"] {
        let played = "--robot ur5 --trajectory path.toml --duration-s 0.2";
        succeeds(&directory, &format!("{command} {played}"));
    }
    let far = text(&path).replace("-0.5, -0.05, 0.3", "-1.5, -0.05, 0.3");
    write(directory.join("far.toml"), far);
    for command in ["torque --out x.csv", "simulate --out x.csv", "run --out x"] {
        let stderr = fails(
            &directory,
            &format!("{command} --robot ur5 --trajectory far.toml"),
        );
        let waypoint =
            "far.toml: move 3 (via), point 2, tool at (-1.500, -0.050, 0.300) m: out of reach";
        assert!(stderr.contains(waypoint), "{stderr}");
    }
    assert!(!files(&directory).iter().any(|name| name.starts_with('x')));
    refused(
        &directory,
        "torque --robot ur5 --in a.csv --trajectory path.toml --out x.csv",
        "cannot be used with",
    );
}
