//! Mistakes planted into a sound log: each is named in one line, none yields a bank.

#[expect(dead_code, reason = "other tests use the rest of it")]
mod logged;

use foretorque_workbench::robot::{Link, Robot};
use logged::{Directory, log, log_of};
use nalgebra::{Matrix3, Vector3};
use std::fs;

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
    let here = Directory::new("planted");
    log(&here.file("good.csv"), 3000, 0.0, None, 0.05);
    let good = fs::read_to_string(here.file("good.csv")).expect("reads");
    let swap = |a: usize, b: usize, width: usize| {
        each(move |row: &mut Row| (0..width).for_each(|k| row.swap(a + k, b + k)))
    };
    let scale = |from: usize, to: usize, factor: f64| {
        each(move |row: &mut Row| row[from..to].iter_mut().for_each(|value| *value *= factor))
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
    let cases: [(&str, Change, &str); 11] = [
        (
            "degrees",
            scale(Q, Q + 18, 57.295_779_513),
            "are these degrees (--units q=deg)?",
        ),
        (
            "mN·m",
            scale(TAU, TAU + 6, 1e3),
            "is this mN·m (--units tau=mNm)?",
        ),
        (
            "sign of all",
            scale(TAU, TAU + 6, -1.0),
            "has the wrong sign",
        ),
        (
            "sign of one",
            scale(TAU + 2, TAU + 3, -1.0),
            "torque of joint 3 has the wrong sign",
        ),
        (
            "swapped torques",
            swap(TAU + 1, TAU + 3, 1),
            "torques of joints 2 and 4 are swapped",
        ),
        (
            "swapped positions",
            each(|row| (0..3).for_each(|k| row.swap(Q + 6 * k, Q + 1 + 6 * k))),
            "positions of joints 1 and 2 are swapped",
        ),
        (
            "swapped joints",
            each(|row| {
                [0, 6, 12, 18]
                    .iter()
                    .for_each(|k| row.swap(Q + 1 + k, Q + 2 + k))
            }),
            "positions and torques of joints 2 and 3 are swapped",
        ),
        (
            "q and tau",
            swap(Q, TAU, 6),
            "positions and torques are swapped",
        ),
        (
            "gain of one",
            scale(TAU + 3, TAU + 4, 10.0),
            "torque of joint 4 is ",
        ),
        ("late torque", Box::new(late), " ms behind the positions"),
        (
            "noise",
            Box::new(noise),
            "are noise: they follow neither the motion nor gravity",
        ),
    ];
    let judged = |name: &str, words: &str| {
        let done = here.identify("--log bad.csv --methods wls --out out");
        let message = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(1), "{name}: {message}");
        assert!(
            message.starts_with("error: ") && message.contains(words),
            "{name}: {message}"
        );
        assert_eq!(message.lines().count(), 1, "{name}: {message}");
        assert!(!here.file("out/parameters.bank").exists(), "{name}");
    };
    for (name, change, words) in &cases {
        fs::write(here.file("bad.csv"), planted(&good, change.as_ref())).expect("writes");
        judged(name, words);
    }
    let mut loaded = Robot::load("ur5").expect("built in");
    let last = loaded.joints.last_mut().expect("six");
    let hand = Link {
        mass: 3.0,
        com: loaded.flange.origin + loaded.flange.rot_parent_child * Vector3::new(0.0, 0.0, 0.06),
        inertia_com: Matrix3::identity() * 0.005,
    };
    last.link = Link::lumped(&[last.link, hand]).expect("two");
    log_of(&loaded, &here.file("bad.csv"), 3000, 0.0, None, 0.05);
    judged(
        "payload",
        " kg at the flange explains what the description does not",
    );
    let ur10 = format!(
        "{}/../tests/data/ros2-bags/ur10.toml",
        env!("CARGO_MANIFEST_DIR")
    );
    let ur10 = Robot::load(&ur10).expect("a robot");
    log_of(&ur10, &here.file("bad.csv"), 3000, 0.0, None, 0.05);
    judged("another arm", "another arm");
    // A sound log of a plant that is not its description passes, and so does a refused one by force.
    here.succeeds("identify --robot ur5 --log good.csv --methods wls --out out");
    assert!(here.file("out/parameters.bank").exists());
    here.identify("--log bad.csv --methods wls --out out");
    assert!(
        !here.file("out/parameters.bank").exists(),
        "a bank of an earlier run"
    );
    here.succeeds("identify --robot ur5 --log bad.csv --methods wls --force --out out");
    assert!(here.file("out/parameters.bank").exists());
}

#[test]
fn an_inaccurate_description_is_no_mistake() {
    let here = Directory::new("planted-none");
    for seed in [1, 2, 3] {
        here.succeeds(&format!(
            "simulate --robot ur5 --trajectory validation --seed {seed} --duration-s 15 --torque-noise 0.002 --out plant.csv"
        ));
        let stdout = here.succeeds("identify --robot ur5 --log plant.csv --data-check");
        assert!(
            stdout.contains("no finding that refuses a bank"),
            "{stdout}"
        );
        let stdout = here.succeeds(
            "identify --robot ur5 --log plant.csv --validate plant.csv --methods wls --out out",
        );
        assert!(stdout.contains("holds what the training log"), "{stdout}");
        assert!(
            stdout.contains("torque error joint by joint, wls:"),
            "{stdout}"
        );
    }
}
