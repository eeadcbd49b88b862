//! The program as its users call it: what it makes, and the one line it gives when it cannot.

mod program;

use foretorque::arm::Arm;
use foretorque::arm::panda::Panda;
use foretorque::arm::ur5::Ur5;
use foretorque::joint::{JointMotion, JointVector};
use program::{directory, fails, files, host_sim, states, succeeds};
use std::fs;
use std::path::Path;

#[test]
fn torque_is_that_of_the_firmware_for_every_arm_it_knows() {
    fn check<A: Arm<N, P>, const N: usize, const P: usize>() {
        let directory = directory(&format!("torque-{}", A::NAME));
        fs::write(directory.join("states.csv"), states(N)).expect("it can be written");
        succeeds(
            &directory,
            &format!("torque --robot {} --in states.csv --out tau.csv", A::NAME),
        );
        let table = fs::read_to_string(directory.join("tau.csv")).expect("it was written");
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
    let report = fs::read_to_string(directory.join("out/report.json")).expect("it was written");
    let report: serde_json::Value = serde_json::from_str(&report).expect("it is JSON");
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
    fs::write(directory.join("other.toml"), other).expect("it can be written");
    fs::write(directory.join("states.csv"), states(6)).expect("it can be written");
    // Read at run time: the arm of another name has the torques of the built-in one.
    for (robot, out) in [("other.toml", "other.csv"), ("ur5", "ur5.csv")] {
        succeeds(
            &directory,
            &format!("torque --robot {robot} --in states.csv --out {out}"),
        );
    }
    let read = |name: &str| fs::read_to_string(directory.join(name)).expect("is text");
    assert_eq!(read("other.csv"), read("ur5.csv"));
    let stderr = fails(
        &directory,
        "torque --robot ur7 --in states.csv --out tau.csv",
    );
    assert!(stderr.contains("unknown robot 'ur7'"), "{stderr}");
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
    let written = fs::read_to_string(directory.join("panda.rs")).expect("it was written");
    assert!(
        written == include_str!("../../firmware/foretorque/src/arm/panda.rs"),
        "the committed module is another one"
    );
    succeeds(&directory, "generate --robot ur5 --out ur5.rs");
    let written = fs::read_to_string(directory.join("ur5.rs")).expect("it was written");
    assert!(written == include_str!("../../firmware/foretorque/src/arm/ur5.rs"));
}

#[test]
fn a_urdf_that_is_none_or_has_no_such_link_is_refused() {
    let directory = directory("bad-urdf");
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/panda.urdf");
    fs::write(directory.join("broken.urdf"), "<robot><link").expect("it can be written");
    for (arguments, named) in [
        ("generate --urdf missing.urdf --out arm.rs", "missing.urdf"),
        ("generate --urdf broken.urdf --out arm.rs", "broken.urdf"),
        (
            &format!("generate --urdf {urdf} --tip elbow_9 --out arm.rs"),
            "elbow_9",
        ),
        (
            &format!("generate --urdf {urdf} --base nowhere --out arm.rs"),
            "nowhere",
        ),
        (
            &format!("generate --urdf {urdf} --out Arm-1.rs"),
            "Arm-1.rs",
        ),
    ] {
        let stderr = fails(&directory, arguments);
        assert!(stderr.contains(named), "{stderr}");
    }
    assert_eq!(files(&directory), ["broken.urdf"]);
    // What belongs to a URDF is refused without one.
    let output = host_sim(&directory, "generate --robot ur5 --tip tool --out arm.rs");
    assert!(!output.status.success());
    let stderr = String::from_utf8(output.stderr).expect("it speaks UTF-8");
    assert!(stderr.contains("--tip"), "{stderr}");
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
    let rows = fs::read_to_string(directory.join("tau.csv")).expect("is text");
    assert_eq!(rows.lines().count(), 8502, "8.5 s, a row each millisecond");
    succeeds(
        &directory,
        "simulate --robot ur5 --trajectory path.toml --duration-s 0.2 --out log.csv",
    );
    succeeds(
        &directory,
        "run --robot ur5 --trajectory path.toml --duration-s 0.2 --out out",
    );
    let text = fs::read_to_string(&path).expect("is text");
    let far = text.replace("-0.5, -0.05, 0.3", "-1.5, -0.05, 0.3");
    fs::write(directory.join("far.toml"), far).expect("writes");
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
    let stderr = fails(
        &directory,
        "torque --robot ur5 --in a.csv --trajectory path.toml --out x.csv",
    );
    assert!(stderr.contains("cannot be used with"), "{stderr}");
}
