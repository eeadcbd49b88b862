//! The command `identify` as a user runs it: parameters of a known arm, one line for each defect of a log, and mistakes planted
//! into a sound log, none of which yields a bank.

use crate::{
    assert_contains, directory, fails, host_sim, json, number, refused, succeeds, text, write,
};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use foretorque_workbench::robot::{Link, Robot};
use foretorque_workbench::table::write_motion;
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;
use std::fs;
use std::ops::Range;
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
fn log(path: &Path, rows: usize, phase: f64, still: Option<usize>, noise: f64) {
    let robot = Robot::load("ur5").expect("built in");
    log_of(&robot, path, rows, phase, still, noise);
}

/// A log of another robot.
fn log_of(robot: &Robot, path: &Path, rows: usize, phase: f64, still: Option<usize>, noise: f64) {
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
fn identified(directory: &Path, arguments: &str) -> (String, Value) {
    let arguments = format!("identify --robot ur5 --out out {arguments}");
    let stdout = succeeds(directory, &arguments);
    (stdout, json(directory.join("out/report.json")))
}

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
    let logs = "--log train.csv.gz --validate unseen.csv --truth ur5 --columns coulomb-viscous";
    let (_, report) = identified(&here, logs);
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
    let torque = "torque --robot ur5 --in unseen.csv --out tau.csv --bank out/parameters.bank";
    succeeds(&here, torque);
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
    succeeds(&here, "generate --robot out/robot.toml --out ur5.rs");
}

#[test]
fn a_log_that_does_not_show_what_is_asked_is_refused_in_one_line() {
    let here = directory("identify-wrong");
    log(&here.join("good.csv"), 2000, 0.0, None, 0.1);
    let series = include_str!("../paths/ur5-excitation.json");
    let other = series.replacen("\"ur5\"", "\"other\"", 1);
    write(here.join("other.json"), other);
    for (wrong, expected) in [
        ("--gains standstill", "no motor currents"),
        ("--still-rad-s 50", "no joint moves"),
        ("--filter fourier --period-s 5", "do not repeat every 5 s"),
        ("--truth panda", "an arm with other parameters"),
        (
            "--filter fourier --excitation other.json",
            "excitation is for robot 'other', not 'ur5'",
        ),
    ] {
        let identify = format!("identify --robot ur5 --log good.csv --out out {wrong}");
        refused(&here, &identify, expected);
    }
}

#[test]
fn joints_that_are_predicted_worse_than_by_the_description_are_named() {
    let here = directory("identify-half");
    write(
        here.join("series.json"),
        include_str!("../paths/ur5-excitation.json"),
    );
    for (name, path) in [("a.csv", "series.json"), ("b.csv", "validation")] {
        let motion = format!("--trajectory {path} --duration-s 10");
        succeeds(
            &here,
            &format!("simulate --robot ur5 {motion} --out {name}"),
        );
        // Less than the motion of joint 3, and too little less to be told by the judgement.
        let less = each(|row| (0..3).for_each(|k| row[Q + 6 * k + 2] *= 0.8));
        let log = planted(&text(here.join(name)), &less);
        write(here.join(name), log);
    }
    let text = succeeds(
        &here,
        "identify --robot ur5 --log a.csv --validate b.csv --out out",
    );
    assert_contains(
        &text,
        "the identified parameters predict worse than the description",
    );
}

#[test]
fn the_bank_has_the_drive_gains_of_standstill() {
    const SHARE: f64 = 1.25;
    let here = directory("identify-standstill");
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
    let torques = text(here.join("torques.csv"));
    // Without velocities, by which a pose and the next one would be one stand.
    let currents = torques.lines().map(|line| {
        let fields: Vec<&str> = line.split(',').collect();
        let kept = [&fields[..Q + N], &fields[TAU..]].concat().join(",");
        kept.replace("tau", "i").replace("_nm", "_a") + "\n"
    });
    write(here.join("currents.csv"), currents.collect::<String>());
    let identify =
        "identify --robot ur5 --log currents.csv --methods wls --gains standstill --out out";
    assert_contains(&succeeds(&here, identify), "gain  joint 2  13.370 N·m/A");
    let bank = succeeds(&here, "bank out/parameters.bank");
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
fn a_joint_that_stands_still_is_named_by_its_unseen_parameters_and_the_others_are_learnt() {
    let here = directory("identify-still");
    log(&here.join("still.csv"), 2000, 0.0, Some(5), 0.1);
    let message = fails(&here, "identify --robot ur5 --log still.csv --out out");
    for name in ["rank deficient", "Ia6", "Fv6", "Fc6"] {
        assert_contains(&message, name);
    }
    assert!(!message.contains("Fv1"), "{message}");
    // The board learns the others: the reference is the description.
    let stdout = succeeds(&here, "replay --robot ur5 --log still.csv --out replayed");
    assert_contains(&stdout, "1.000 × the description without friction");
    let report = json(here.join("replayed/report.json"));
    assert!(number(&report["newest_vs_rich_wls_ratio"]) < 0.5);
    assert!(report["plain_wls_vs_rich_wls_ratio"].is_null());
    let notes = report["notes"].to_string();
    assert_contains(&notes, "do not show all columns of coulomb-viscous\"");
}

#[test]
fn columns_absent_on_the_board_are_named_the_others_reach_it() {
    let here = directory("identify-columns");
    log(&here.join("log.csv"), 4000, 0.0, None, 0.1);
    let columns = "--columns coulomb-viscous+offset+stribeck+load+cogging+cubic";
    let arguments = format!("--log log.csv --methods wls,irls {columns}");
    let (stdout, report) = identified(&here, &arguments);
    assert_contains(&stdout, "the board has no column cubic");
    let bank = succeeds(&here, "bank out/parameters.bank");
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
    let here = directory("identify-gap");
    log(&here.join("whole.csv"), 4000, 0.0, None, 0.1);
    let cut = planted(&text(here.join("whole.csv")), &|rows| {
        rows.drain(1499..1549);
        // The first axis is vertical, so its turn during the gap changes no torque; it is no velocity of the joint.
        rows[1499..].iter_mut().for_each(|row| row[Q] -= 3.0);
    });
    write(here.join("cut.csv"), cut);
    let (stdout, report) = identified(&here, "--log cut.csv --validate whole.csv --methods wls");
    assert_contains(&stdout, "cut.csv:1501: column t_s: gap of 0.255");
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
    for command in [
        "simulate --robot arm.toml --trajectory validation --seed 1 --exact --out 1.csv",
        "simulate --robot arm.toml --trajectory validation --seed 2 --exact --out 2.csv",
        "identify --robot arm.toml --log 1.csv --validate 2.csv --methods consistent --out out",
        "torque --robot out/robot.toml --in 2.csv --out tau.csv",
    ] {
        succeeds(&here, command);
    }
    // Boards have no coupled joints.
    assert!(!here.join("out/parameters.bank").exists());
    // Torques of the last two drives: measured, and of the identified description.
    for drive in [5, 6] {
        let share = difference(&here, ("2.csv", 18 + drive), ("tau.csv", drive));
        assert!(share < 0.2, "drive {drive}: {share}");
    }
    let run = "run --robot arm.toml --trajectory validation --out x";
    refused(&here, run, "without its [coupling]");
}

/// One row: time, then positions, velocities, accelerations and torques of six joints.
type Row = Vec<f64>;
/// First columns of positions and torques.
const Q: usize = 1;
const TAU: usize = 19;

/// The rows of a table after a change, as a table.
fn planted(text: &str, change: &dyn Fn(&mut Vec<Row>)) -> String {
    let mut lines = text.lines();
    let header = lines.next().expect("header").to_owned();
    let number = |field: &str| field.parse().expect("number");
    let row = |line: &str| -> Row { line.split(',').map(number).collect() };
    let mut rows: Vec<Row> = lines.map(row).collect();
    change(&mut rows);
    let write = |row: &Row| row.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let rows: Vec<String> = rows.iter().map(write).collect();
    format!("{header}\n{}\n", rows.join("\n"))
}

/// A change of all rows of a log.
type Change = Box<dyn Fn(&mut Vec<Row>)>;

/// One change made to every row.
fn each(change: impl Fn(&mut Row) + 'static) -> Change {
    Box::new(move |rows| rows.iter_mut().for_each(&change))
}

#[test]
fn each_planted_mistake_is_named_and_none_yields_a_bank() {
    let here = directory("planted");
    log(&here.join("good.csv"), 3000, 0.0, None, 0.05);
    let good = text(here.join("good.csv"));
    let swap = |a: usize, b: usize, width: usize| {
        each(move |row: &mut Row| (0..width).for_each(|k| row.swap(a + k, b + k)))
    };
    let scale = |columns: Range<usize>, factor: f64| {
        each(move |row| {
            let values = row[columns.clone()].iter_mut();
            values.for_each(|value| *value *= factor);
        })
    };
    let noise = |rows: &mut Vec<Row>| {
        let mut state = 1_u64;
        for row in rows {
            for tau in &mut row[TAU..] {
                state = state.wrapping_mul(6_364_136_223_846_793_005);
                state = state.wrapping_add(1);
                *tau = (state >> 40) as f64 / f64::from(1 << 23) * 20.0 - 20.0;
            }
        }
    };
    let late = |rows: &mut Vec<Row>| {
        let before = rows.clone();
        for k in 0..rows.len() {
            rows[k][TAU..].copy_from_slice(&before[k.saturating_sub(4)][TAU..]);
        }
    };
    let all = TAU..TAU + 6;
    let one = |joint: usize| TAU + joint - 1..TAU + joint;
    let swapped_positions = each(|row| (0..3).for_each(|k| row.swap(Q + 6 * k, Q + 1 + 6 * k)));
    let half_joint = each(|row| (0..3).for_each(|k| row[Q + 6 * k + 2] *= 0.5));
    let swapped_joints = each(|row| {
        let quantities = [0, 6, 12, 18].iter();
        quantities.for_each(|k| row.swap(Q + 1 + k, Q + 2 + k));
    });
    let cases: [(Change, &str); 15] = [
        (
            scale(Q..Q + 18, 57.295_779_513),
            "are these degrees (--units q=deg), or are the limits too low",
        ),
        (
            scale(0..1, 1e3),
            "s apart: are its times in ms (--units t=ms)?",
        ),
        (
            scale(all.clone(), 0.0),
            "are noise: they follow neither the motion nor gravity",
        ),
        (scale(all.clone(), 1e3), "is this mN·m (--units tau=mNm)?"),
        (
            scale(all, -1.0),
            "is this a log that counts the other way (--units tau=-Nm or i=-A)?",
        ),
        (scale(one(3), -1.0), "torque of joint 3 has the wrong sign"),
        (
            swap(TAU + 1, TAU + 3, 1),
            "torques of joints 2 and 4 are swapped",
        ),
        (swapped_positions, "positions of joints 1 and 2 are swapped"),
        (
            swapped_joints,
            "positions and torques of joints 2 and 3 are swapped",
        ),
        (
            half_joint,
            "positions of joint 3 have another scale: 2 times",
        ),
        (swap(Q, TAU, 6), "positions and torques are swapped"),
        (scale(one(4), 10.0), "torque of joint 4 is "),
        (
            scale(one(3), 1e3),
            "those of the others are within theirs: drive gain or unit?",
        ),
        (Box::new(late), " ms behind the positions"),
        (
            Box::new(noise),
            "are noise: they follow neither the motion nor gravity",
        ),
    ];
    let judged = |words: &str| {
        let identify = "identify --robot ur5 --log bad.csv --methods wls --out out";
        refused(&here, identify, words);
        assert!(!here.join("out/parameters.bank").exists(), "{words}");
    };
    for (change, words) in &cases {
        write(here.join("bad.csv"), planted(&good, change.as_ref()));
        judged(words);
    }
    let turned = planted(&good, scale(TAU..TAU + 6, -1.0).as_ref());
    write(here.join("turned.csv"), turned);
    let step = std::f64::consts::TAU / 4096.0;
    let coarse = each(move |row| {
        let values = row[Q..Q + 6].iter_mut();
        values.for_each(|q| *q = (*q / step).round() * step);
    });
    write(here.join("coarse.csv"), planted(&good, coarse.as_ref()));
    for sound in ["turned.csv --units tau=-Nm", "coarse.csv"] {
        let identify = format!("identify --robot ur5 --log {sound} --data-check");
        assert_contains(&succeeds(&here, &identify), "no finding that refuses");
    }
    let mut loaded = Robot::load("ur5").expect("built in");
    let last = loaded.joints.last_mut().expect("six");
    let hand = Link {
        mass: 3.0,
        com: loaded.flange.origin + loaded.flange.rot_parent_child * Vector3::new(0.0, 0.0, 0.06),
        inertia_com: Matrix3::identity() * 0.005,
    };
    last.link = Link::lumped(&[last.link, hand]).expect("two");
    log_of(&loaded, &here.join("bad.csv"), 3000, 0.0, None, 0.05);
    judged(" kg at the flange explains what the description does not");
    let bags = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/ros2-bags");
    let ur10 = Robot::load(&format!("{bags}/ur10.toml")).expect("a robot");
    log_of(&ur10, &here.join("bad.csv"), 3000, 0.0, None, 0.05);
    judged("another arm");
    // The learner is not replayed on it either, but by force.
    let replay = "replay --robot ur5 --log bad.csv --out replayed";
    refused(&here, replay, "another arm");
    succeeds(&here, &format!("{replay} --force"));
    // A sound log of a plant that is not its description passes, and so does a refused one by force.
    for (arguments, bank) in [
        ("good.csv --methods wls", true),
        ("bad.csv --methods wls", false),
        ("bad.csv --methods wls --force", true),
    ] {
        let identify = format!("identify --robot ur5 --out out --log {arguments}");
        host_sim(&here, &identify);
        let written = here.join("out/parameters.bank").exists();
        assert_eq!(written, bank, "{arguments}");
    }
}

#[test]
fn an_inaccurate_description_is_no_mistake() {
    let here = directory("planted-none");
    for seed in [1, 2] {
        let plant = "--duration-s 15 --torque-noise 0.002 --out plant.csv";
        let path = format!("--trajectory validation --seed {seed}");
        succeeds(&here, &format!("simulate --robot ur5 {path} {plant}"));
        let identify = "identify --robot ur5 --log plant.csv";
        let stdout = succeeds(&here, &format!("{identify} --data-check"));
        assert_contains(&stdout, "no finding that refuses a bank");
        let wls = "--validate plant.csv --methods wls --out out";
        let stdout = succeeds(&here, &format!("{identify} {wls}"));
        assert_contains(&stdout, "holds what the training log");
        assert_contains(&stdout, "torque error joint by joint, wls:");
    }
}

#[test]
fn a_sound_log_of_any_arm_is_refused_for_nothing() {
    let here = directory("sound_logs");
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
    let files = fs::read_dir(robots).expect("robots");
    for file in files.map(|file| file.expect("readable").path()) {
        let described = Robot::load(&file.display().to_string()).expect("described");
        // Without friction and rotors, as most URDF describe arms; the simulated arm has neither friction.
        let mut bare = described.clone();
        for joint in &mut bare.joints {
            (joint.friction.viscous, joint.friction.coulomb) = (0.0, 0.0);
            joint.drive.rotor_inertia = 0.0;
        }
        // With a friction that stands for none, as MJCF often has it.
        let mut light = bare.clone();
        for joint in &mut light.joints {
            (joint.friction.viscous, joint.friction.coulomb) = (0.1, 0.01);
        }
        for (robot, seed) in [(&described, 1), (&bare, 17), (&light, 1)] {
            write(here.join("arm.toml"), robot.to_toml().expect("text"));
            let path = "--trajectory validation --duration-s 8 --robot arm.toml --out log.csv";
            succeeds(&here, &format!("simulate {path} --seed {seed}"));
            let identify = "identify --data-check --robot arm.toml --log log.csv";
            succeeds(&here, identify);
        }
    }
}
