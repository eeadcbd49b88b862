//! The command `identify` as a user sees it: parameters back from a log, one line for what is wrong with one.

mod logged;

use foretorque_workbench::robot::Robot;
use logged::{Directory, identified, identify, log, report, succeeded, text};
use std::fs;
use std::path::Path;
use std::process::Command;

#[test]
fn parameters_come_back_from_a_log_and_the_bank_loads() {
    let here = Directory::new("identify-round");
    let (train, unseen, out) = (
        here.file("train.csv.gz"),
        here.file("unseen.csv"),
        here.file("out"),
    );
    log(&train, 6000, 0.0, None, 0.3);
    log(&unseen, 2000, 1.1, None, 0.0);
    identified(&[
        "--log",
        text(&train),
        "--validate",
        text(&unseen),
        "--out",
        text(&out),
        "--truth",
        "ur5",
    ]);
    let report = report(&out);
    assert_eq!(report["rank"], 52);
    for method in [
        "ols",
        "wls",
        "irls",
        "consistent",
        "bp_physical",
        "bp_residual",
    ] {
        let record = &report["methods"][method];
        let error = record["validation"]["unseen.csv"]["joints_nrmse_moving_ratio"].as_f64();
        assert!(error.expect(method) < 0.01, "{method}: {error:?}");
        let parameters = record["parameters"].as_array().expect("a list");
        assert_eq!(parameters.len(), 52, "{method}");
        let coulomb = parameters
            .iter()
            .find(|p| p["name"] == "Fc1")
            .expect("has it");
        assert!((coulomb["value"].as_f64().expect("a number") - 7.0).abs() < 0.1);
    }
    let epochs = report["methods"]["bp_physical"]["epochs_to_1_05_wls"][0].as_u64();
    assert!(epochs.expect("reached") > 1);
    let tau = here.file("tau.csv");
    let played = Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .args([
            "torque",
            "--robot",
            "ur5",
            "--in",
            text(&unseen),
            "--out",
            text(&tau),
        ])
        .args(["--bank", text(&out.join("parameters.bank"))])
        .output()
        .expect("runs");
    succeeded(&played);
    // The board's own torque of the bank, first joint, against the log.
    let column = |path: &Path, index: usize| -> Vec<f64> {
        let text = fs::read_to_string(path).expect("reads");
        let rows = text.lines().skip(1);
        rows.map(|row| {
            row.split(',')
                .nth(index)
                .expect("has it")
                .parse()
                .expect("a number")
        })
        .collect()
    };
    let (wanted, found) = (column(&unseen, 19), column(&tau, 1));
    let error: f64 = wanted
        .iter()
        .zip(&found)
        .map(|(a, b)| (a - b).powi(2))
        .sum();
    let power: f64 = wanted.iter().map(|a| a * a).sum();
    assert!((error / power).sqrt() < 0.02);
}

#[test]
fn the_consistent_parameters_are_a_description_that_can_be_used() {
    let here = Directory::new("identify-consistent");
    let (train, out) = (here.file("train.csv"), here.file("out"));
    // Noise enough to drive least squares out of what bodies can have.
    log(&train, 2000, 0.0, None, 3.0);
    identified(&[
        "--log",
        text(&train),
        "--out",
        text(&out),
        "--methods",
        "irls,consistent",
    ]);
    let report = report(&out);
    let identified = Robot::load(text(&out.join("robot.toml"))).expect("a description");
    let parameters = report["methods"]["consistent"]["parameters"]
        .as_array()
        .expect("a list");
    // The base parameters of the description are the ones that were reported.
    for (parameter, value) in parameters.iter().zip(identified.base_parameters()) {
        let reported = parameter["value"].as_f64().expect("a number");
        assert!((reported - value).abs() < 1e-9, "{parameter}");
    }
    for joint in &identified.joints {
        assert!(joint.link.mass > 0.0 && joint.drive.rotor_inertia > 0.0);
        assert!(joint.link.second_moments().symmetric_eigenvalues().min() > 0.0);
        assert!(joint.friction.viscous > 0.0 && joint.friction.coulomb > 0.0);
    }
    let in_urdf = Robot::load(text(&out.join("robot.urdf"))).expect("a URDF");
    assert!((in_urdf.joints[1].link.mass - identified.joints[1].link.mass).abs() < 1e-12);
    let generated = Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .args(["generate", "--robot", text(&out.join("robot.toml"))])
        .args(["--out", text(&here.file("ur5.rs"))])
        .output()
        .expect("runs");
    succeeded(&generated);
}

#[test]
fn what_is_wrong_with_a_log_is_said_in_one_line() {
    let here = Directory::new("identify-wrong");
    let (good, bad, out) = (
        here.file("good.csv"),
        here.file("bad.csv"),
        here.file("out"),
    );
    log(&good, 2000, 0.0, None, 0.1);
    let text_of_good = fs::read_to_string(&good).expect("reads");
    let lines: Vec<&str> = text_of_good.lines().collect();
    let with_line = |number: usize, replacement: String| {
        let mut lines: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
        lines[number - 1] = replacement;
        lines.join("\n")
    };
    let fields: Vec<&str> = lines[9].split(',').collect();
    let cases = [
        (
            with_line(1, lines[0].replace("tau3_nm", "x")),
            "bad.csv:1: column tau3_nm is missing",
        ),
        (
            with_line(1, lines[0].replace("tau6_nm", "q7_rad")),
            "bad.csv:1: column q7_rad is one too many",
        ),
        (
            with_line(10, fields[1..].join(",")),
            "bad.csv:10: 24 fields where the header has 25",
        ),
        (
            with_line(10, lines[9].replace(fields[4], "NaN")),
            "bad.csv:10: column q4_rad: \"NaN\" is not a finite number",
        ),
        (
            with_line(1, lines[0].replace("tau3_nm", "tau2_nm")),
            "bad.csv:1: column tau2_nm appears twice",
        ),
        (
            with_line(10, format!("{},0", lines[9])),
            "bad.csv:10: 26 fields where the header has 25",
        ),
        (
            with_line(10, lines[9].replace(fields[0], "0.001")),
            "bad.csv:10: column t_s: 0.001 does not come after 0.035",
        ),
        (
            with_line(10, lines[8].to_owned()),
            "bad.csv:10: column t_s: 0.035 does not come after 0.035",
        ),
    ];
    for (content, expected) in cases {
        fs::write(&bad, content).expect("writes");
        let done = identify(&["--log", text(&bad), "--out", text(&out)]);
        let message = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(!done.status.success(), "{expected}");
        assert!(message.contains(expected), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
    for (wrong, expected) in [
        (["--methods", "olz"], "unknown method 'olz'"),
        (["--columns", "friction"], "unknown column set 'friction'"),
        (["--filter", "fourier"], "needs --period-s or --excitation"),
        (["--gains", "standstill"], "no motor currents"),
        (["--still-rad-s", "50"], "no joint moves"),
    ] {
        let done = identify(&[
            "--log",
            text(&good),
            "--out",
            text(&out),
            wrong[0],
            wrong[1],
        ]);
        assert!(!done.status.success());
        assert!(String::from_utf8_lossy(&done.stderr).contains(expected));
    }
}

#[test]
fn a_joint_that_stands_still_is_named_by_its_unseen_parameters() {
    let here = Directory::new("identify-still");
    let (path, out) = (here.file("still.csv"), here.file("out"));
    log(&path, 2000, 0.0, Some(5), 0.1);
    let done = identify(&["--log", text(&path), "--out", text(&out)]);
    let message = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(!done.status.success());
    for name in ["rank deficient", "Ia6", "Fv6", "Fc6"] {
        assert!(message.contains(name), "{message}");
    }
    assert!(!message.contains("Fv1"), "{message}");
}

#[test]
fn columns_without_a_place_on_the_board_are_named_and_the_others_reach_the_bank() {
    let here = Directory::new("identify-columns");
    let (path, out) = (here.file("log.csv"), here.file("out"));
    log(&path, 4000, 0.0, None, 0.1);
    let columns = "coulomb-viscous+offset+stribeck+load+cogging+cubic";
    let methods = "wls,irls";
    let done = identify(&[
        "--log",
        text(&path),
        "--out",
        text(&out),
        "--columns",
        columns,
        "--methods",
        methods,
    ]);
    let message = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(
        message.contains("the board has no column cubic"),
        "{message}"
    );
    let bank = Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .args(["bank", text(&out.join("parameters.bank"))])
        .output()
        .expect("runs");
    let bank = String::from_utf8_lossy(&bank.stdout).into_owned();
    // An identified column has a value of its own and a deviation smaller than that of a bank nobody identified.
    for name in ["Fv1", "Fc1", "Fs1", "Fb1", "Fl2", "Fo1", "Gs1", "Gc1"] {
        let line = bank
            .lines()
            .find(|line| line.starts_with(&format!("{name} ")));
        let fields: Vec<&str> = line.expect(name).split_whitespace().collect();
        assert!(
            fields[1].parse::<f64>().expect("a number") != 0.0,
            "{line:?}"
        );
    }
    let report = report(&out);
    let interval = &report["methods"]["wls"]["parameters"][0]["ci95"];
    assert!(interval[0].as_f64() < interval[1].as_f64(), "{interval}");
}

#[test]
fn a_gap_splits_the_log_and_the_reader_is_told() {
    let here = Directory::new("identify-gap");
    let (whole, cut, out) = (
        here.file("whole.csv"),
        here.file("cut.csv"),
        here.file("out"),
    );
    log(&whole, 4000, 0.0, None, 0.1);
    let content = fs::read_to_string(&whole).expect("reads");
    let kept = content
        .lines()
        .enumerate()
        .filter(|(row, _)| !(1500..1600).contains(row));
    let kept: Vec<&str> = kept.map(|(_, line)| line).collect();
    fs::write(&cut, kept.join("\n")).expect("writes");
    let message = identified(&[
        "--log",
        text(&cut),
        "--validate",
        text(&whole),
        "--out",
        text(&out),
        "--methods",
        "wls",
    ]);
    assert!(
        message.contains("cut.csv:1501: column t_s: gap of 0.5"),
        "{message}"
    );
    let report = report(&out);
    let error = &report["methods"]["wls"]["validation"]["whole.csv"]["joints_nrmse_moving_ratio"];
    // The noise of the whole log itself is 1 % of the wrists' torque; a derivative across the gap would be far worse.
    assert!(error.as_f64().expect("a number") < 0.02, "{error}");
}
