//! The command `identify` as a user runs it: parameters of a known arm, and one line for each defect of a log.

use crate::logs::{Q, TAU, each, planted};
use crate::{Directory, assert_contains, number, states_of};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::table::write_motion;
use serde_json::Value;
use std::fmt::Display;
use std::path::Path;

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

/// Standard output and report of a successful `identify` into `out`.
fn identified(here: &Directory, arguments: impl Display) -> (String, Value) {
    let stdout = here.succeeds(format!("identify --robot ur5 --out out {arguments}"));
    (stdout, here.json("out/report.json"))
}

/// RMS difference of two columns over the RMS of the first; each is a table and a place in it.
fn difference(here: &Directory, wanted: (&str, usize), found: (&str, usize)) -> f64 {
    let [wanted, found] = [wanted, found].map(|(table, index)| -> Vec<f64> {
        let (text, number) = (here.text(table), |field: &str| {
            field.parse().expect("a number")
        });
        let rows = text.lines().skip(1);
        rows.map(|row| number(row.split(',').nth(index).expect("has it")))
            .collect()
    });
    let pairs = wanted.iter().zip(&found);
    let error: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
    let power: f64 = wanted.iter().map(|a| a * a).sum();
    (error / power).sqrt()
}

#[test]
fn parameters_come_back_from_a_log_and_the_bank_loads() {
    let here = Directory::new("identify-round");
    log(&here.join("train.csv.gz"), 6000, 0.0, None, 0.3);
    log(&here.join("unseen.csv"), 2000, 1.1, None, 0.0);
    let logs = "--log train.csv.gz --validate unseen.csv --truth ur5 --columns coulomb-viscous";
    let (_, report) = identified(&here, logs);
    assert_eq!(report["rank"], 52);
    let page = here.text("out/report.html");
    let recommended = report["recommended"].as_str().expect("a name");
    assert_contains(&page, format!("Parameters: {recommended}"));
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
    let torque = "torque --robot ur5 --in unseen.csv --out tau.csv --bank out/parameters.bank";
    here.succeeds(torque);
    // The board's own torque of the bank, first joint, against the log.
    assert!(difference(&here, ("unseen.csv", 19), ("tau.csv", 1)) < 0.02);
}

#[test]
fn the_page_tells_logs_of_one_name_apart() {
    let here = Directory::new("identify-names");
    std::fs::create_dir(here.join("other")).expect("creates");
    log(&here.join("train.csv"), 2000, 0.0, None, 0.1);
    log(&here.join("unseen.csv"), 1000, 1.1, None, 0.0);
    log(&here.join("other/unseen.csv"), 1000, 0.4, None, 3.0);
    let logs = "--log train.csv --validate unseen.csv --test other/unseen.csv --methods wls";
    let (stdout, report) = identified(&here, logs);
    let record = &report["methods"]["wls"]["test"]["other/unseen.csv"];
    let ratio = number(&record["joints_nrmse_moving_ratio"]);
    let shown = format!("{:.2} %", 100.0 * ratio);
    assert_contains(&stdout, &shown);
    assert_contains(&here.text("out/report.html"), &shown);
}

#[test]
fn a_load_in_one_of_the_logs_is_named_with_its_log() {
    let here = Directory::new("identify-loaded");
    log(&here.join("a.csv"), 2000, 0.0, None, 0.05);
    log(&here.join("b.csv"), 2000, 1.1, None, 0.05);
    let loaded = planted(&here.text("b.csv"), each(|row| row[TAU + 2] += 12.0));
    here.write("b.csv", loaded);
    let simulate = "simulate --robot ur5 --exact --trajectory validation --duration-s 12";
    here.succeeds(format!("{simulate} --payload 4@6..12 --out unseen.csv"));
    let plain = "--columns coulomb-viscous --methods wls --validate unseen.csv";
    let (stdout, _) = identified(&here, format!("--log a.csv {plain}"));
    assert_contains(&stdout, "warning  unseen.csv: torque error of joint");
    let (stdout, _) = identified(&here, format!("--log a.csv --log b.csv {plain} --force"));
    assert_contains(
        &stdout,
        "warning  b.csv: torque error of joint 3 changes by",
    );
}

#[test]
fn a_validation_log_at_rest_is_refused_and_chooses_nothing() {
    let here = Directory::new("identify-rest");
    log(&here.join("train.csv"), 2000, 0.0, None, 0.1);
    let rest = planted(&here.text("train.csv"), |rows| {
        let mut first = rows[0].clone();
        first[Q + N..TAU].fill(0.0);
        for row in rows {
            row[Q..].copy_from_slice(&first[Q..]);
        }
    });
    here.write("rest.csv", rest);
    let identify = "--log train.csv --validate rest.csv --methods ols,consistent --out out";
    let identify = format!("identify --robot ur5 {identify}");
    let reason = "rest.csv: no joint moves faster than 0.05 rad/s: record a motion";
    here.refused(&identify, reason);
    here.succeeds(format!("{identify} --force"));
    let report = here.json("out/report.json");
    assert_eq!(report["recommended"], "consistent");
    let record = &report["methods"]["ols"]["validation"]["rest.csv"];
    assert!(record["joints_nrmse_moving_ratio"].is_null(), "{record}");
}

#[test]
fn warnings_on_unseen_logs_name_the_log() {
    let here = Directory::new("identify-warned");
    log(&here.join("train.csv"), 2000, 0.0, None, 0.1);
    log(&here.join("unseen.csv"), 2000, 1.1, None, 0.1);
    let clipped = planted(&here.text("unseen.csv"), |rows| {
        let mut torques: Vec<f64> = rows.iter().map(|row| row[TAU + 1]).collect();
        torques.sort_by(f64::total_cmp);
        let most = torques[rows.len() * 49 / 50];
        let torques = rows.iter_mut().map(|row| &mut row[TAU + 1]);
        torques.for_each(|torque| *torque = torque.min(most));
    });
    for name in ["clipped.csv", "copy.csv"] {
        here.write(name, &clipped);
    }
    here.write("same.csv", here.text("train.csv"));
    let unseen = "--validate clipped.csv --test copy.csv --test same.csv";
    let logs = format!("--log train.csv {unseen} --methods wls");
    let (stdout, report) = identified(&here, format!("{logs} --motion-hz 10"));
    assert_contains(
        &stdout,
        "warning  clipped.csv: torque of joint 2 is cut off at",
    );
    for words in [
        "warning  copy.csv holds what the validation log clipped.csv holds",
        "warning  same.csv holds what the training log train.csv holds",
        "torque error joint by joint, wls, first log of --validate:",
    ] {
        assert_contains(&stdout, words);
    }
    // The torque is filtered well below the motion, unless the user wants it otherwise.
    assert_eq!(number(&report["torque_cutoff_hz"]), 5.0);
    let (stdout, report) = identified(&here, format!("{logs} --motion-hz 10 --torque-hz 15"));
    assert_eq!(number(&report["torque_cutoff_hz"]), 15.0);
    assert_contains(&stdout, "note  torque and regressor are filtered at 15 Hz");
    // A report that cannot be written leaves the bank of the run before.
    let bank = std::fs::read(here.join("out/parameters.bank")).expect("written");
    std::fs::remove_file(here.join("out/report.html")).expect("written");
    std::fs::create_dir(here.join("out/report.html")).expect("creates");
    let identify = format!("identify --robot ur5 --out out {logs}");
    here.refused(&identify, "report.html");
    let left = std::fs::read(here.join("out/parameters.bank"));
    assert_eq!(left.expect("left"), bank);
}

#[test]
fn the_consistent_parameters_are_a_description_that_can_be_used() {
    let here = Directory::new("identify-consistent");
    // Noise enough to drive least squares out of the physical parameters.
    log(&here.join("train.csv"), 2000, 0.0, None, 3.0);
    let (stdout, report) = identified(&here, "--log train.csv --methods irls,consistent");
    let lost = "have no place for all of the friction columns offset, load:";
    assert_contains(&stdout, lost);
    let load = |name: &str| Robot::load(&here.join(name).to_string_lossy()).expect(name);
    let identified = load("out/robot.toml");
    let parameters = &report["methods"]["consistent"]["parameters"];
    // The base parameters of the description are the ones that were reported.
    let reported = parameters.as_array().expect("a list").iter();
    for (parameter, value) in reported.zip(identified.base_parameters()) {
        let error = number(&parameter["value"]) - value;
        assert!(error.abs() < 1e-9, "{parameter}");
    }
    for joint in &identified.joints {
        assert!(joint.link.mass > 0.0 && joint.drive.rotor_inertia > 0.0);
        assert!(joint.link.second_moments().symmetric_eigenvalues().min() > 0.0);
        assert!(joint.friction.viscous > 0.0 && joint.friction.coulomb > 0.0);
    }
    let in_urdf = load("out/robot.urdf");
    assert!((in_urdf.joints[1].link.mass - identified.joints[1].link.mass).abs() < 1e-12);
    here.succeeds("generate --robot out/robot.toml --out ur5.rs");
    // Without rotors in the description, those of the first axes are like the others, and no part of a link.
    log(&here.join("train.csv"), 2000, 0.0, None, 0.1);
    let bare = "identify --robot ur5 --rotor-inertia 0 --methods irls,consistent";
    here.succeeds(format!("{bare} --log train.csv --out out"));
    let arm = Robot::load("ur5").expect("built in");
    for (joint, described) in load("out/robot.toml").joints.iter().zip(&arm.joints) {
        let [mass, rotor] = [
            joint.link.mass / described.link.mass,
            joint.drive.rotor_inertia / described.drive.rotor_inertia,
        ];
        assert!((0.7..1.4).contains(&mass), "{mass}");
        assert!((0.7..1.4).contains(&rotor), "{rotor}");
    }
}

#[test]
fn a_log_that_does_not_show_what_is_asked_is_refused_in_one_line() {
    let here = Directory::new("identify-wrong");
    log(&here.join("good.csv"), 2000, 0.0, None, 0.1);
    let series = include_str!("../paths/ur5-excitation.json");
    let other = series.replacen("\"ur5\"", "\"other\"", 1);
    here.write("other.json", other);
    let long = series.replacen("\"period_s\": 10.0", "\"period_s\": 1e9", 1);
    assert_ne!(long, series);
    here.write("long.json", long);
    here.write("geared.toml", "gear_ratios = [nan]");
    here.write("bare.toml", "# later\n");
    here.write("copy.csv", here.text("good.csv"));
    // Options, and the words of the refusal.
    let cases = "\
--gains standstill | no motor currents
--log ./good.csv | --log ./good.csv is given twice
--log copy.csv | --log copy.csv is a copy of --log good.csv
--still-rad-s 50 | no joint moves
--filter fourier --period-s 5 | do not repeat every 5 s
--filter fourier --period-s 1e9 | must be positive and at most 1000
--filter fourier --excitation long.json | long.json: excitation: period of 1000000000 s, not above 0
--methods bp_black_box | bp_black_box has no bank
--columns-from geared.toml | geared.toml: gear_ratios: NaN is no ratio
--columns-from bare.toml | bare.toml: no columns: write t_s (or rate_hz), q_rad and tau_nm (or i_a)
--truth panda | an arm with other parameters
--filter fourier --excitation other.json | excitation is for robot 'other', not 'ur5'";
    for case in cases.lines() {
        let (wrong, expected) = case.split_once(" | ").expect("two parts");
        let identify = format!("identify --robot ur5 --log good.csv --out out {wrong}");
        here.refused(&identify, expected);
    }
}

#[test]
fn joints_that_are_predicted_worse_than_by_the_description_are_named() {
    let here = Directory::new("identify-half");
    here.write("series.json", include_str!("../paths/ur5-excitation.json"));
    for (name, path) in [("a.csv", "series.json"), ("b.csv", "validation")] {
        let motion = format!("--trajectory {path} --duration-s 10");
        here.succeeds(format!("simulate --robot ur5 {motion} --out {name}"));
        // Less than the motion of joint 3, and too little less to be told by the judgement.
        let less = each(|row| (0..3).for_each(|k| row[Q + 6 * k + 2] *= 0.8));
        here.write(name, planted(&here.text(name), less));
    }
    let text = here.succeeds("identify --robot ur5 --log a.csv --validate b.csv --out out");
    assert_contains(
        &text,
        "the identified parameters predict worse than the description",
    );
}

#[test]
fn the_bank_has_the_drive_gains_of_standstill() {
    const SHARE: f64 = 1.25;
    let here = Directory::new("identify-standstill");
    let robot = Robot::load("ur5").expect("built in");
    let model = ReferenceModel::<N>::new(&robot).expect("six joints");
    // Eight poses that are held, and a motion.
    let states = (0..3000).map(|row| match row / 100 {
        stand @ 0..8 => State::rest(motion(3.0 * f64::from(stand), 0.0, None).q),
        _ => motion(f64::from(row) * PERIOD_S, 0.0, None),
    });
    let rows = states.enumerate().map(|(row, state)| {
        let mut current = model.inverse_dynamics(&state);
        let joints = robot.joints.iter().zip(current.iter_mut());
        joints.for_each(|(joint, current)| *current /= SHARE * joint.gain());
        // A second between the poses.
        let t_s = row as f64 * PERIOD_S + f64::from(row.min(800) as u32 / 100);
        (t_s, state, [current])
    });
    write_motion(&here.join("torques.csv"), ["tau"], rows).expect("writes");
    let torques = here.text("torques.csv");
    // Without velocities, by which a pose and the next one would be one stand.
    let currents = torques.lines().map(|line| {
        let fields: Vec<&str> = line.split(',').collect();
        let kept = [&fields[..Q + N], &fields[TAU..]].concat().join(",");
        kept.replace("tau", "i").replace("_nm", "_a") + "\n"
    });
    here.write("currents.csv", currents.collect::<String>());
    let identify =
        "identify --robot ur5 --log currents.csv --methods wls --gains standstill --out out";
    here.shows(identify, "gain  joint 2  13.370 N·m/A");
    let bank = here.succeeds("bank out/parameters.bank");
    let of_joint = |joint: &str| {
        let mut lines = bank
            .lines()
            .map(|line| line.split_whitespace().collect::<Vec<_>>());
        let line = lines.rfind(|line| line.len() == 5 && line[0] == joint);
        line.expect("a line for the joint")[4]
            .parse::<f64>()
            .expect("a gain")
    };
    for (joint, expected) in [("1", 10.70), ("2", SHARE * 10.696), ("3", SHARE * 10.655)] {
        assert!((of_joint(joint) - expected).abs() < 0.02, "{joint}: {bank}");
    }
}

#[test]
fn a_joint_that_stands_still_is_named_and_the_others_are_learnt() {
    let here = Directory::new("identify-still");
    log(&here.join("still.csv"), 2000, 0.0, Some(5), 0.1);
    let message = here.fails("identify --robot ur5 --log still.csv --out out");
    assert_contains(&message, "rank deficient (");
    assert_contains(
        &message,
        "joints at rest: 6: add a --log in which every joint moves",
    );
    // The board learns the others: the reference is the description.
    let stdout = here.succeeds("replay --robot ur5 --log still.csv --out replayed");
    assert_contains(&stdout, "1.000 × the description without friction");
    let report = here.json("replayed/report.json");
    assert!(number(&report["newest_vs_rich_wls_ratio"]) < 0.5);
    assert!(report["plain_wls_vs_rich_wls_ratio"].is_null());
    let notes = report["notes"].to_string();
    assert_contains(&notes, "do not show all columns of coulomb-viscous\"");
}

#[test]
fn columns_absent_on_the_board_are_named_the_others_reach_it() {
    let here = Directory::new("identify-columns");
    log(&here.join("log.csv"), 4000, 0.0, None, 0.1);
    let columns = "--columns coulomb-viscous+offset+stribeck+load+cogging+cubic";
    let arguments = format!("--log log.csv --methods wls,irls {columns}");
    let (stdout, report) = identified(&here, &arguments);
    assert_contains(&stdout, "the board has no column cubic");
    let bank = here.succeeds("bank out/parameters.bank");
    // An identified column has a value other than zero.
    for name in ["Fv1", "Fc1", "Fs1", "Fb1", "Fl2", "Fo1", "Gs1", "Gc1"] {
        let mut rows = bank.lines().map(str::split_whitespace);
        let row = rows.find_map(|mut row| (row.next() == Some(name)).then(|| row.next()));
        let value = row.flatten().expect(name).parse::<f64>();
        assert!(value.expect("a number") != 0.0, "{name}");
    }
    let interval = &report["methods"]["wls"]["parameters"][0]["ci95"];
    assert!(number(&interval[0]) < number(&interval[1]), "{interval}");
}

#[test]
fn a_gap_splits_the_log_and_is_noted() {
    let here = Directory::new("identify-gap");
    log(&here.join("whole.csv"), 4000, 0.0, None, 0.1);
    let cut = planted(&here.text("whole.csv"), |rows| {
        rows.drain(1499..1549);
        // The first axis is vertical, so its turn during the gap changes no torque; it is no velocity of the joint.
        rows[1499..].iter_mut().for_each(|row| row[Q] -= 3.0);
    });
    here.write("cut.csv", cut);
    let (stdout, report) = identified(&here, "--log cut.csv --validate whole.csv --methods wls");
    assert_contains(&stdout, "cut.csv:1501: column t_s: gap of 0.255");
    let error = &report["methods"]["wls"]["validation"]["whole.csv"]["joints_nrmse_moving_ratio"];
    // The noise of the whole log itself is 1 % of the wrists' torque; a derivative across the gap would be far worse.
    assert!(number(error) < 0.02, "{error}");
}

#[test]
fn an_arm_with_calibrated_angles_is_identified() {
    let here = Directory::new("identify-calibrated");
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/data/ur5_calibrated.toml"
    );
    let robot = Robot::load(file).expect("in the tree");
    log_of(&robot, &here.join("log.csv"), 4000, 0.0, None, 0.1);
    log_of(&robot, &here.join("other.csv"), 2000, 0.4, None, 0.1);
    let logs = "--log log.csv --validate other.csv --methods wls --out out";
    here.succeeds(format!("identify --robot {file} {logs}"));
    let report = here.json("out/report.json");
    let error = &report["methods"]["wls"]["validation"]["other.csv"]["joints_nrmse_moving_ratio"];
    assert!(number(error) < 0.02, "{error}");
}

#[test]
fn drives_that_turn_two_joints_are_identified() {
    let here = Directory::new("identify-coupled");
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
    here.write("arm.toml", &text);
    for command in [
        "simulate --robot arm.toml --trajectory validation --seed 1 --exact --out 1.csv",
        "simulate --robot arm.toml --trajectory validation --seed 2 --exact --out 2.csv",
        "identify --robot arm.toml --log 1.csv --validate 2.csv --methods consistent --out out",
        "torque --robot out/robot.toml --in 2.csv --out tau.csv",
    ] {
        here.succeeds(command);
    }
    let described = here.succeeds("describe arm.toml --format urdf");
    assert!(described.contains("<!-- without the coupling of the drives"));
    let without = "identify --robot arm.toml --log 1.csv --validate 2.csv --methods wls --out wls";
    here.refused(without, "--methods consistent gives a robot.toml");
    // Boards have no coupled joints.
    assert!(!here.join("out/parameters.bank").exists());
    // Torques of the last two drives: measured, and of the identified description.
    for drive in [5, 6] {
        let share = difference(&here, ("2.csv", 18 + drive), ("tau.csv", drive));
        assert!(share < 0.2, "drive {drive}: {share}");
    }
    here.write("states.csv", states_of(6, &[100.0]));
    let far = "torque --robot ur5 --in states.csv --out far.csv";
    here.shows(far, "note  q1 is 100.000 rad in size, beyond its range");
    let run = "run --robot arm.toml --trajectory validation --out x";
    here.refused(run, "without its [coupling]");
    for (values, reason) in [
        (&[1e200][..], "state 1: its torque is not a number"),
        (&[], "states.csv: no rows"),
    ] {
        here.write("states.csv", states_of(6, values));
        let torque = "torque --robot arm.toml --in states.csv --out x.csv";
        here.refused(torque, reason);
    }
}
