//! Mistakes planted into a sound log: each is named in one line, none yields a bank.

use crate::logged::{identify, log, log_of};
use crate::program::{command, directory, failure, succeeds, text, write};
use foretorque_workbench::robot::{Link, Robot};
use nalgebra::{Matrix3, Vector3};
use std::fs;
use std::ops::Range;
use std::path::Path;

/// One row: time, then positions, velocities, accelerations and torques of six joints.
type Row = Vec<f64>;
/// First columns of positions and torques.
const Q: usize = 1;
const TAU: usize = 19;

/// The rows of a table after a change, as a table.
fn planted(text: &str, change: &dyn Fn(&mut Vec<Row>)) -> String {
    let mut lines = text.lines();
    let header = lines.next().expect("header").to_owned();
    let parse = |line: &str| -> Row {
        line.split(',')
            .map(|field| field.parse().expect("number"))
            .collect()
    };
    let mut rows: Vec<Row> = lines.map(parse).collect();
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
            row[columns.clone()]
                .iter_mut()
                .for_each(|value| *value *= factor)
        })
    };
    let noise = |rows: &mut Vec<Row>| {
        let mut state = 1_u64;
        for row in rows {
            for tau in &mut row[TAU..] {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
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
    let swapped_joints = each(|row| {
        let quantities = [0, 6, 12, 18].iter();
        quantities.for_each(|k| row.swap(Q + 1 + k, Q + 2 + k));
    });
    let cases: [(Change, &str); 14] = [
        (
            scale(Q..Q + 18, 57.295_779_513),
            "are these degrees (--units q=deg)?",
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
        (scale(all, -1.0), "has the wrong sign"),
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
        let done = identify(&here, "--log bad.csv --methods wls --out out");
        let message = failure(words, &done);
        assert!(message.contains(words), "{words}: {message}");
        assert!(!here.join("out/parameters.bank").exists(), "{words}");
    };
    for (change, words) in &cases {
        write(here.join("bad.csv"), planted(&good, change.as_ref()));
        judged(words);
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
    let replay = |force: &str| {
        let line = format!("replay --robot ur5 --log bad.csv --out replayed {force}");
        command(&here, &line).output().expect("it starts")
    };
    let message = failure("replay", &replay(""));
    assert!(message.contains("another arm"), "{message}");
    assert!(replay("--force").status.success());
    // A sound log of a plant that is not its description passes, and so does a refused one by force.
    for (arguments, bank) in [
        ("good.csv --methods wls", true),
        ("bad.csv --methods wls", false),
        ("bad.csv --methods wls --force", true),
    ] {
        identify(&here, &format!("--out out --log {arguments}"));
        assert_eq!(
            here.join("out/parameters.bank").exists(),
            bank,
            "{arguments}"
        );
    }
}

#[test]
fn an_inaccurate_description_is_no_mistake() {
    let here = directory("planted-none");
    for seed in [1, 2] {
        succeeds(
            &here,
            &format!(
                "simulate --robot ur5 --trajectory validation --seed {seed} --duration-s 15 --torque-noise 0.002 --out plant.csv"
            ),
        );
        let stdout = succeeds(&here, "identify --robot ur5 --log plant.csv --data-check");
        let sound = "no finding that refuses a bank";
        assert!(stdout.contains(sound), "{stdout}");
        let stdout = succeeds(
            &here,
            "identify --robot ur5 --log plant.csv --validate plant.csv --methods wls --out out",
        );
        for words in [
            "holds what the training log",
            "torque error joint by joint, wls:",
        ] {
            assert!(stdout.contains(words), "{stdout}");
        }
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
            succeeds(
                &here,
                "identify --data-check --robot arm.toml --log log.csv",
            );
        }
    }
}
