//! The command `identify` as a user runs it: parameters of a known arm, one line for each defect of a log.

use crate::logged::{identified, identify, log};
use crate::program::{directory, failure, host_sim, json, number, succeeds, text, write};
use foretorque_workbench::robot::Robot;
use std::path::Path;

/// One column of a table, header left out.
fn column(path: &Path, index: usize) -> Vec<f64> {
    let text = text(path);
    let fields = text.lines().skip(1).map(|row| row.split(',').nth(index));
    fields
        .map(|field| field.expect("has it").parse().expect("a number"))
        .collect()
}

/// RMS difference of two columns over the RMS of the first; each is a table and a place in it.
fn difference(here: &Path, wanted: (&str, usize), found: (&str, usize)) -> f64 {
    let [wanted, found] = [wanted, found].map(|(table, index)| column(&here.join(table), index));
    let pairs = wanted.iter().zip(&found);
    let error: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
    let power: f64 = wanted.iter().map(|a| a * a).sum();
    (error / power).sqrt()
}

#[test]
fn parameters_come_back_from_a_log_and_the_bank_loads() {
    let here = directory("identify-round");
    log(&here.join("train.csv.gz"), 6000, 0.0, None, 0.3);
    log(&here.join("unseen.csv"), 2000, 1.1, None, 0.0);
    let (_, report) = identified(
        &here,
        "--log train.csv.gz --validate unseen.csv --truth ur5 --columns coulomb-viscous",
    );
    assert_eq!(report["rank"], 52);
    for method in "ols wls irls consistent bp_physical bp_residual".split(' ') {
        let record = &report["methods"][method];
        let error = number(&record["validation"]["unseen.csv"]["joints_nrmse_moving_ratio"]);
        assert!(error < 0.01, "{method}: {error:?}");
        let parameters = record["parameters"].as_array().expect("a list");
        assert_eq!(parameters.len(), 52, "{method}");
        let coulomb = parameters.iter().find(|p| p["name"] == "Fc1");
        assert!((number(&coulomb.expect("has it")["value"]) - 7.0).abs() < 0.1);
    }
    let epochs = report["methods"]["bp_physical"]["epochs_to_1_05_wls"][0].as_u64();
    assert!(epochs.expect("reached") > 1);
    succeeds(
        &here,
        "torque --robot ur5 --in unseen.csv --out tau.csv --bank out/parameters.bank",
    );
    // The board's own torque of the bank, first joint, against the log.
    assert!(difference(&here, ("unseen.csv", 19), ("tau.csv", 1)) < 0.02);
}

#[test]
fn the_consistent_parameters_are_a_description_that_can_be_used() {
    let here = directory("identify-consistent");
    // Noise enough to drive least squares out of the physical parameters.
    log(&here.join("train.csv"), 2000, 0.0, None, 3.0);
    let (_, report) = identified(&here, "--log train.csv --methods irls,consistent");
    let load = |name: &str| Robot::load(&here.join(name).to_string_lossy()).expect(name);
    let identified = load("out/robot.toml");
    let parameters = &report["methods"]["consistent"]["parameters"];
    // The base parameters of the description are the ones that were reported.
    let reported = parameters.as_array().expect("a list").iter();
    for (parameter, value) in reported.zip(identified.base_parameters()) {
        assert!(
            (number(&parameter["value"]) - value).abs() < 1e-9,
            "{parameter}"
        );
    }
    for joint in &identified.joints {
        assert!(joint.link.mass > 0.0 && joint.drive.rotor_inertia > 0.0);
        assert!(joint.link.second_moments().symmetric_eigenvalues().min() > 0.0);
        assert!(joint.friction.viscous > 0.0 && joint.friction.coulomb > 0.0);
    }
    let in_urdf = load("out/robot.urdf");
    assert!((in_urdf.joints[1].link.mass - identified.joints[1].link.mass).abs() < 1e-12);
    succeeds(&here, "generate --robot out/robot.toml --out ur5.rs");
}

#[test]
fn a_log_that_does_not_show_what_is_asked_is_refused_in_one_line() {
    let here = directory("identify-wrong");
    log(&here.join("good.csv"), 2000, 0.0, None, 0.1);
    for (wrong, expected) in [
        ("--gains standstill", "no motor currents"),
        ("--still-rad-s 50", "no joint moves"),
    ] {
        let done = identify(&here, &format!("--log good.csv --out out {wrong}"));
        let message = failure(wrong, &done);
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn a_joint_that_stands_still_is_named_by_its_unseen_parameters_and_the_others_are_learnt() {
    let here = directory("identify-still");
    log(&here.join("still.csv"), 2000, 0.0, Some(5), 0.1);
    let message = failure("still", &identify(&here, "--log still.csv --out out"));
    for name in ["rank deficient", "Ia6", "Fv6", "Fc6"] {
        assert!(message.contains(name), "{message}");
    }
    assert!(!message.contains("Fv1"), "{message}");
    // The board learns the others: the reference is the description.
    let stdout = succeeds(&here, "replay --robot ur5 --log still.csv --out replayed");
    assert!(
        stdout.contains("1.000 × the description without friction"),
        "{stdout}"
    );
    let report = json(here.join("replayed/report.json"));
    assert!(number(&report["newest_vs_rich_wls_ratio"]) < 0.5);
    assert!(report["plain_wls_vs_rich_wls_ratio"].is_null());
    let notes = report["notes"].to_string();
    assert!(
        notes.contains("do not show all columns of coulomb-viscous\""),
        "{notes}"
    );
}

#[test]
fn columns_absent_on_the_board_are_named_the_others_reach_it() {
    let here = directory("identify-columns");
    log(&here.join("log.csv"), 4000, 0.0, None, 0.1);
    let columns = "coulomb-viscous+offset+stribeck+load+cogging+cubic";
    let (stdout, report) = identified(
        &here,
        &format!("--log log.csv --columns {columns} --methods wls,irls"),
    );
    assert!(stdout.contains("the board has no column cubic"), "{stdout}");
    let bank = succeeds(&here, "bank out/parameters.bank");
    // An identified column has a value other than zero.
    for name in ["Fv1", "Fc1", "Fs1", "Fb1", "Fl2", "Fo1", "Gs1", "Gc1"] {
        let line = bank
            .lines()
            .find(|line| line.starts_with(&format!("{name} ")));
        let value = line
            .expect(name)
            .split_whitespace()
            .nth(1)
            .expect("a value");
        assert!(value.parse::<f64>().expect("a number") != 0.0, "{line:?}");
    }
    let interval = &report["methods"]["wls"]["parameters"][0]["ci95"];
    assert!(number(&interval[0]) < number(&interval[1]), "{interval}");
}

#[test]
fn a_gap_splits_the_log_and_is_noted() {
    let here = directory("identify-gap");
    log(&here.join("whole.csv"), 4000, 0.0, None, 0.1);
    let content = text(here.join("whole.csv"));
    let mut rows: Vec<String> = content.lines().map(str::to_owned).collect();
    rows.drain(1500..1550);
    // The first axis is vertical, so its turn during the gap changes no torque; it is no velocity of the joint.
    for row in &mut rows[1500..] {
        let mut fields: Vec<&str> = row.split(',').collect();
        let turned = fields[1].parse::<f64>().expect("a position") - 3.0;
        let turned = turned.to_string();
        fields[1] = &turned;
        *row = fields.join(",");
    }
    write(here.join("cut.csv"), rows.join("\n"));
    let (stdout, report) = identified(&here, "--log cut.csv --validate whole.csv --methods wls");
    assert!(
        stdout.contains("cut.csv:1501: column t_s: gap of 0.255"),
        "{stdout}"
    );
    let error = &report["methods"]["wls"]["validation"]["whole.csv"]["joints_nrmse_moving_ratio"];
    // The noise of the whole log itself is 1 % of the wrists' torque; a derivative across the gap would be far worse.
    assert!(number(error) < 0.02, "{error}");
}

#[test]
fn drives_that_turn_two_joints_are_identified() {
    let here = directory("identify-coupled");
    let drive = |name: &str| {
        format!(
            "[[joints]]\nname = '{name}'\nlimits = {{ position_rad = [-2.5, 2.5], velocity_rad_s = 2, torque_nm = 20 }}
            friction = {{ stribeck_ratio = 0, cogging_nm = 0 }}\n"
        )
    };
    let [five, six] = ["wrist_2", "wrist_3"].map(drive);
    let text = format!(
        "from = 'ur5'\n{five}{six}[coupling]\njoints = ['wrist_2', 'wrist_3']\nmatrix = [[1, 1], [1, -1]]\n"
    );
    write(here.join("arm.toml"), &text);
    for seed in [1, 2] {
        succeeds(
            &here,
            &format!(
                "simulate --robot arm.toml --trajectory validation --seed {seed} --exact --out {seed}.csv"
            ),
        );
    }
    succeeds(
        &here,
        "identify --robot arm.toml --log 1.csv --validate 2.csv --methods consistent --out out",
    );
    assert!(
        !here.join("out/parameters.bank").exists(),
        "boards have no coupled joints"
    );
    succeeds(
        &here,
        "torque --robot out/robot.toml --in 2.csv --out tau.csv",
    );
    // Torques of the last two drives: measured, and of the identified description.
    for drive in [5, 6] {
        let share = difference(&here, ("2.csv", 18 + drive), ("tau.csv", drive));
        assert!(share < 0.2, "drive {drive}: {share}");
    }
    let run = "run --robot arm.toml --trajectory validation --out x";
    let refused = failure(run, &host_sim(&here, run));
    assert!(refused.contains("without its [coupling]"), "{refused}");
}
