//! Logs: mistakes planted into a sound one, none of which yields a bank; ROS 2 bags of real arms, identified from and replayed
//! as they are; and MCAP beside CSV: every tick, the same numbers, read back by this program and, where it is installed, by
//! another reader.

use crate::identification::{log, log_of};
use crate::{Directory, assert_contains, number};
use foretorque_workbench::robot::{Link, Robot};
use nalgebra::{Matrix3, Vector3};
use std::fs;
use std::ops::Range;
use std::path::Path;
use std::process::Command;

fn data(name: &str) -> String {
    let bags = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/ros2-bags");
    format!("{bags}/{name}")
}

#[test]
fn real_arms_are_identified_from_their_bags_and_no_load_is_seen_in_these() {
    let of_ur10 = "--motion-hz 20 --torque-hz 10 --columns coulomb-viscous+offset+load";
    for (robot, bag, filters) in [
        (data("ur10.toml"), "ur10", of_ur10),
        // At 30 rows a second the cut-offs follow from the rows.
        ("panda".to_owned(), "panda", ""),
    ] {
        let here = Directory::new(&format!("bag-{bag}"));
        let log = data(&format!("{bag}.db3"));
        let identify = format!("identify --robot {robot} --log {log} --methods wls {filters}");
        let printed = here.succeeds(format!("{identify} --force --out out"));
        let load = "torque error of joint";
        assert!(!printed.contains(load), "{bag}: {printed}");
    }
}

#[test]
fn bags_are_replayed_to_the_board_which_learns_them_without_harm_or_alarm() {
    // Panda: 24 s at 30 Hz in 33 ticks a row. UR10: 27.5 s at 125 Hz in 8 ticks a row. The ends belong to the filters.
    for (robot, bag, ticks) in [
        ("panda".to_owned(), "panda", 20e3..24.8e3),
        (data("ur10.toml"), "ur10", 26e3..27.6e3),
    ] {
        let here = Directory::new(&format!("bag-replay-{bag}"));
        let log = format!("--robot {robot} --log {}", data(&format!("{bag}.db3")));
        here.succeeds(format!("identify {log} --out bank"));
        for (start, worst) in [("", 0.5), ("--bank bank/parameters.bank", 1.05)] {
            here.succeeds(format!("replay {log} {start} --out out"));
            let report = here.json("out/report.json");
            assert_eq!(report["robot"], bag);
            assert_eq!(report["start"] == "description", start.is_empty());
            let seen = number(&report["ticks_count"]);
            assert!(ticks.contains(&seen), "{bag}: {seen}");
            let found = number(&report["worst_window_over_start_ratio"]);
            assert!(found < worst, "{bag} {start}: {found}");
            assert!(number(&report["frozen_vs_rich_wls_ratio"]) > 1.0);
            let decisions = report["decisions"].as_array().expect("a list");
            let alarms = decisions.iter().filter(|own| own["reason"] == "alarm");
            assert_eq!(alarms.count(), 0, "{bag} {start}: {decisions:?}");
        }
    }
}

/// Compares FILE.mcap with FILE.csv column by column: prints the number of rows and of topics.
const OUTSIDE: &str = include_str!("compare_mcap.py");

#[test]
fn a_run_is_written_as_mcap_with_every_tick_and_the_numbers_of_the_csv() {
    let here = Directory::new("mcap");
    let run = "run --robot ur5 --trajectory validation --duration-s 3 --telemetry all/1 --out out";
    here.succeeds(run);
    let check = |log: &str| {
        let arguments = format!("identify --robot ur5 --log out/log.{log} --data-check");
        let shown = String::from_utf8(here.run(&arguments).stdout).expect("text");
        assert_contains(&shown, "joint 6");
        shown.replace(&format!("log.{log}"), "log")
    };
    assert_eq!(check("csv"), check("mcap"));
    let Some(python) = crate::python::with("mcap") else {
        return;
    };
    for (table, expected) in [("out/log", "3000 "), ("out/telemetry", "2999 ")] {
        let mut read = Command::new(&python);
        let output = read
            .args(["-c", OUTSIDE, table])
            .current_dir(&*here)
            .output();
        let shown = String::from_utf8_lossy(&output.expect("it starts").stdout).into_owned();
        assert!(shown.starts_with(expected), "{table}: {shown}");
    }
}

/// One row: time, then positions, velocities, accelerations and torques of six joints.
pub(crate) type Row = Vec<f64>;
/// First columns of positions and torques.
pub(crate) const Q: usize = 1;
pub(crate) const TAU: usize = 19;

/// The rows of a table after a change, as a table.
pub(crate) fn planted(text: &str, change: impl Fn(&mut Vec<Row>)) -> String {
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

/// A change of the rows of a log.
type Change = Box<dyn Fn(&mut Vec<Row>)>;

/// One change made to every row.
pub(crate) fn each(change: impl Fn(&mut Row) + 'static) -> Change {
    Box::new(move |rows| rows.iter_mut().for_each(&change))
}

/// The rows of a log after a mistake of this name.
fn mistake(name: &str) -> Change {
    let swap = |a: usize, b: usize, width: usize| {
        each(move |row| (0..width).for_each(|k| row.swap(a + k, b + k)))
    };
    let scale = |columns: Range<usize>, factor: f64| {
        each(move |row| {
            let values = row[columns.clone()].iter_mut();
            values.for_each(|value| *value *= factor);
        })
    };
    // Of the position of a joint, its velocity, and so on.
    let scale_joint = |joint: usize, quantities: usize, factor: f64| {
        each(move |row| (0..quantities).for_each(|k| row[Q + 6 * k + joint - 1] *= factor))
    };
    let absolute = |joints: Range<usize>| {
        each(move |row| {
            let torques = row[joints.clone()].iter_mut();
            torques.for_each(|tau| *tau = tau.abs());
        })
    };
    let wrong_row =
        |column: usize, value: f64| -> Change { Box::new(move |rows| rows[1500][column] = value) };
    let stuck = |column: usize| -> Change {
        Box::new(move |rows| {
            let value = rows[1500][column];
            rows[1500..].iter_mut().for_each(|row| row[column] = value);
        })
    };
    let late = |by: isize| -> Change {
        Box::new(move |rows| {
            let before = rows.clone();
            for (k, row) in rows.iter_mut().enumerate() {
                let from = k.saturating_add_signed(-by).min(before.len() - 1);
                row[TAU..].copy_from_slice(&before[from][TAU..]);
            }
        })
    };
    let all = TAU..TAU + 6;
    let one = |joint: usize| TAU + joint - 1..TAU + joint;
    match name {
        "absolute torques" => absolute(all),
        "absolute torque 5" => absolute(one(5)),
        "degrees" => scale(Q..TAU, 57.295_779_513),
        "milliseconds" => scale(0..1, 1e3),
        "no torques" => scale(all, 0.0),
        "millinewtons" => scale(all, 1e3),
        "turned torques" => scale(all, -1.0),
        "turned torque 3" => scale(one(3), -1.0),
        "turned torque 1" => scale(one(1), -1.0),
        "turned positions 1" => scale_joint(1, 3, -1.0),
        "threefold torques" => scale(all, 3.0),
        "swapped torques" => swap(TAU + 1, TAU + 3, 1),
        "swapped positions" => each(|row| (0..3).for_each(|k| row.swap(Q + 6 * k, Q + 1 + 6 * k))),
        "swapped joints" => each(|row| (0..4).for_each(|k| row.swap(Q + 1 + 6 * k, Q + 2 + 6 * k))),
        "turned positions 3" => scale_joint(3, 3, -1.0),
        "turned joint 2" => scale_joint(2, 4, -1.0),
        "slow velocity 3" => each(|row| row[Q + 6 + 2] *= 0.6),
        "slow time" => scale(0..1, 3.0),
        "half of joint 3" => scale_joint(3, 3, 0.5),
        "other zero" => each(|row| row[Q + 2] -= std::f64::consts::FRAC_PI_2),
        "cut off" => each(|row| row[TAU + 1] = row[TAU + 1].clamp(-45.0, 45.0)),
        "frozen" => each(|row| row[TAU + 4] = 1.5),
        "stuck position" => stuck(Q + 2),
        "stuck torque" => stuck(TAU + 2),
        "wrong position" => wrong_row(Q + 2, -6.0),
        "wrong torque" => wrong_row(TAU, 1e6),
        "torques for positions" => swap(Q, TAU, 6),
        "tenfold torque 4" => scale(one(4), 10.0),
        "thousandfold torque 3" => scale(one(3), 1e3),
        "late" => late(4),
        "very late" => late(40),
        "very early" => late(-40),
        "offset" => each(|row| row[TAU] += 40.0),
        "turned velocity 4" => each(|row| row[Q + 6 + 3] *= -1.0),
        "no velocities" => scale(Q + 6..Q + 12, 0.0),
        "half accelerations" => scale(Q + 12..Q + 18, 0.5),
        "swapped velocities" => {
            Box::new(|rows| rows.iter_mut().for_each(|row| row.swap(Q + 6, Q + 10)))
        }
        "offset and row 5" => Box::new(|rows| {
            rows.iter_mut().for_each(|row| row[TAU + 4] += 32.0);
            rows[1500][TAU + 4] = 1e3;
        }),
        "wrong torques" => Box::new(|rows| {
            let wrong = rows.iter_mut().skip(500).step_by(500).take(3);
            wrong.for_each(|row| row[TAU + 2] = 9999.0);
        }),
        "noise" => Box::new(|rows| {
            let mut state = 1_u64;
            for tau in rows.iter_mut().flat_map(|row| &mut row[TAU..]) {
                state = state.wrapping_mul(6_364_136_223_846_793_005);
                state = state.wrapping_add(1);
                *tau = (state >> 40) as f64 / f64::from(1 << 23) * 20.0 - 20.0;
            }
        }),
        other => panic!("no mistake {other}"),
    }
}

#[test]
fn each_planted_mistake_is_named_and_none_yields_a_bank() {
    let here = Directory::new("planted");
    log(&here.join("good.csv"), 3000, 0.0, None, 0.05);
    let good = here.text("good.csv");
    let judged = |words: &str| {
        let identify = "identify --robot ur5 --log bad.csv --methods wls --out out";
        here.refused(identify, words);
        assert!(!here.join("out/parameters.bank").exists(), "{words}");
    };
    // Mistakes, and words of the refusal.
    let cases = "\
absolute torques | torque of joint 1, 4, 5, 6 is never negative
absolute torque 5 | torque of joint 5 is never negative: is it an absolute value?
degrees | are these degrees (--units q=deg, for all logs), does it jump there, or are the limits
milliseconds | s apart: are its times in ms (--units t=ms)?
no torques | are noise: they follow neither the motion nor gravity
millinewtons | is this mN·m or N·cm (--units tau=mNm or tau=Ncm), or a share of the rated torque
turned torques | is this a log that counts the other way (--units tau=-Nm or i=-A)?
turned torque 3 | torque of joint 3 has the wrong sign
turned torque 1 | torque of joint 1 has the wrong sign
turned positions 1 | positions of joint 1 count the other way
threefold torques | the torques of all joints are 3.
swapped torques | torques of joints 2 and 4 are swapped
swapped positions | positions of joints 1 and 2 are swapped
swapped joints | positions and torques of joints 2 and 3 are swapped
turned positions 3 | positions of joint 3 count the other way
turned joint 2 | positions and torques of joint 2 count the other way
slow velocity 3 | positions of joint 3 change 1.67 times as fast
slow time | positions change 0.33 times as fast as the logged velocities
half of joint 3 | positions of joint 3 have another scale: doubled
other zero | positions of joint 3 have another zero: with 90° more
cut off | torque of joint 2 is cut off at
frozen | joint 5: its torque is always 1.5000 N·m
stuck position | position of joint 3 does not change from 7.500 to
stuck torque | torque of joint 3 does not change from 7.500 to
wrong position | q3 jumps at
wrong torque | tau1 reaches 1000000.0 N·m at 7.500 s, its limit is 150 N·m: delete such rows
torques for positions | positions and torques are swapped
wrong torques | tau3 reaches 9999.0 N·m at 2.500 s, its limit is 150 N·m: delete such rows
offset and row 5 | tau5 reaches 1000.0 N·m at 7.500 s, its limit is 28 N·m: those of the others
tenfold torque 4 | torque of joint 4 is
thousandfold torque 3 | those of the others are nearer to theirs; drive gain, unit, or a limit of the description (--torque-limits)?
late | ms behind the positions
very late | torques are 100 ms or more behind the positions
very early | torques are 100 ms or more ahead of the positions
noise | are noise: they follow neither the motion nor gravity";
    for case in cases.lines() {
        let (name, words) = case.split_once(" | ").expect("two parts");
        here.write("bad.csv", planted(&good, mistake(name)));
        judged(words);
    }
    // Mapped velocities and accelerations are used as they are.
    let map = "t_s = 't_s'\nq_rad = 'q{}_rad'\nqd_rad_s = 'qd{}_rad_s'\nqdd_rad_s2 = 'qdd{}_rad_s2'\ntau_nm = 'tau{}_nm'\n";
    here.write("map.toml", map);
    for (name, words) in [
        (
            "turned velocity 4",
            "logged velocities of joint 4 have the other sign",
        ),
        (
            "swapped velocities",
            "logged velocities of joint 1, 5 are not the change of their positions",
        ),
        (
            "no velocities",
            "logged velocities of joint 1, 2, 3, 4, 5, 6 are zero",
        ),
        (
            "half accelerations",
            "velocities change 2.00 times as fast as the logged accelerations",
        ),
    ] {
        here.write("bad.csv", planted(&good, mistake(name)));
        let mapped = "identify --robot ur5 --log bad.csv --columns-from map.toml --data-check";
        here.refused(mapped, words);
    }
    here.write(
        "geared.toml",
        map.to_owned() + "gear_ratios = [1, 1, 1, 1, 1, 1]\n",
    );
    let geared = "identify --robot ur5 --log good.csv --columns-from geared.toml --data-check";
    here.shows(geared, "gear_ratios are not used");
    let list = "['q1_rad', 'q2_rad', 'q3_rad', 'q4_rad', 'q5_rad', 'q5_rad']";
    here.write("map.toml", map.replacen("'q{}_rad'", list, 1));
    let twice = "identify --robot ur5 --log bad.csv --columns-from map.toml --data-check";
    here.refused(twice, "column q5_rad is q of joints 5 and 6");
    here.write("bad.csv", planted(&good, mistake("offset")));
    let warning = "warning  torque of joint 1 has an offset of";
    here.shows(
        "identify --robot ur5 --log bad.csv --methods wls --out offset",
        warning,
    );
    // Boards take no such torques.
    here.write("bad.csv", planted(&good, mistake("millinewtons")));
    let forced = "identify --robot ur5 --log bad.csv --methods wls --force --out forced";
    here.refused(
        forced,
        "no bank: no board takes the fitted parameters: torque of joint",
    );
    assert!(!here.join("forced/parameters.bank").exists());
    // A delay is that of its log, whatever the rate of the last one.
    here.write("bad.csv", planted(&good, mistake("late")));
    let halved = good.lines().take(1).chain(good.lines().skip(1).step_by(2));
    let halved: Vec<&str> = halved.collect();
    here.write("slow.csv", halved.join("\n") + "\n");
    for logs in [
        "--log bad.csv --log slow.csv",
        "--log slow.csv --log bad.csv",
    ] {
        let check = format!("identify --robot ur5 {logs} --data-check");
        here.refused(&check, "ms behind the positions");
    }
    // A log of --test changes no fit, however far apart its rows are.
    let header = good.lines().take(1);
    let eighth: Vec<&str> = header.chain(good.lines().skip(1).step_by(8)).collect();
    here.write("test.csv", eighth.join("\n") + "\n");
    let bank = |tested: &str| {
        let fit = "identify --robot ur5 --log good.csv --methods wls --force --out fit";
        here.succeeds(format!("{fit} {tested}"));
        std::fs::read(here.join("fit/parameters.bank")).expect("written")
    };
    assert!(bank("") == bank("--test test.csv"));
    // The filters of a data check are those of the training logs.
    let alone = "identify --robot ur5 --log good.csv --validate bad.csv --data-check";
    here.write("bad.csv", planted(&good, mistake("milliseconds")));
    here.shows(alone, "no finding that refuses");
    // Of two mistakes the check names both.
    let frozen = planted(&good, mistake("frozen"));
    here.write("bad.csv", planted(&frozen, mistake("turned torque 3")));
    let output = here.run("identify --robot ur5 --log bad.csv --data-check");
    let shown = String::from_utf8(output.stdout).expect("UTF-8");
    assert_contains(&shown, "also wrong  torque of joint 3 has the wrong sign");
    let refusal = String::from_utf8(output.stderr).expect("UTF-8");
    assert_contains(&refusal, "joint 5: its torque is always");
    // The rate of this clock is in the torques alone.
    let bare = |line: &str| -> String {
        let fields: Vec<&str> = line.split(',').collect();
        [&fields[..Q + 6], &fields[TAU..]].concat().join(",")
    };
    let fast = planted(&good, each(|row| row[0] *= 0.5));
    let bare: Vec<String> = fast.lines().map(bare).collect();
    here.write("bad.csv", bare.join("\n"));
    judged("times: doubled they follow the description");
    // A limit that some export has put there.
    here.write("good.csv", &good);
    let weak = "--torque-limits 150,5,150,28,28,28";
    let remedy = "of the arm's own weight: correct it (--torque-limits)";
    let identify = format!("identify --robot ur5 --log good.csv {weak} --methods wls --out out");
    here.refused(&identify, remedy);
    let described = here.succeeds(format!("describe ur5 {weak}"));
    assert_contains(&described, "torque limit of 5 N·m is below the");
    here.write("turned.csv", planted(&good, mistake("turned torques")));
    let step = std::f64::consts::TAU / 4096.0;
    let coarse = each(move |row| {
        let values = row[Q..Q + 6].iter_mut();
        values.for_each(|q| *q = (*q / step).round() * step);
    });
    here.write("coarse.csv", planted(&good, coarse));
    // A sensor whose zero is beyond all torques of its joint.
    let zero = each(|row| row[TAU + 4] += 8.0);
    here.write("zero.csv", planted(&good, zero));
    for sound in ["turned.csv --units tau=-Nm", "coarse.csv", "zero.csv"] {
        let identify = format!("identify --robot ur5 --log {sound} --data-check");
        here.shows(&identify, "no finding that refuses");
    }
    let held =
        each(|row| row[TAU + 1] = row[TAU + 1].clamp(-45.0, 45.0) + 0.1 * (1e3 * row[0]).sin());
    here.write("held.csv", planted(&good, held));
    // Log, torque limits, and words of the warning.
    let cases = "\
held | 150,45,150,28,28,28 | joint 2: torque held at its limit of 45 N·m in
good | 150,30,150,28,28,28 | joint 2: torque above its limit of 30 N·m in
good | 2000 | % of its limit: are the limits placeholders?
good | 2000 | the scale of the torques is unchecked:";
    for case in cases.lines() {
        let [log, limits, warning] = case.splitn(3, " | ").collect::<Vec<_>>()[..] else {
            panic!("{case}: not three parts");
        };
        let identify = format!("identify --robot ur5 --log {log}.csv --torque-limits {limits}");
        here.shows(format!("{identify} --data-check"), warning);
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
    for (gravity, words) in [
        (
            Vector3::new(0.0, 3.355, -9.218),
            "gravity is another one than in the description: with gravity_m_s2 = [0.0, 3.",
        ),
        (
            Vector3::new(0.0, 0.0, 9.81),
            "gravity is another one than in the description: with gravity_m_s2 = [0.0, 0.",
        ),
        (Vector3::zeros(), "the torques are without gravity"),
    ] {
        let hung = Robot {
            gravity,
            ..Robot::load("ur5").expect("built in")
        };
        log_of(&hung, &here.join("bad.csv"), 3000, 0.0, None, 0.05);
        judged(words);
    }
    // Beside the flange, where it loads the last joints most.
    let tool = "from = 'panda'\n[tool]\nmass_kg = 2\ncom_m = [0, 0.05, 0.05]\ninertia_kg_m2 = { xx = 0.01, yy = 0.01, zz = 0.01 }\n";
    here.write("tool.toml", tool);
    let simulate =
        "simulate --robot tool.toml --trajectory validation --duration-s 12 --out hand.csv";
    here.succeeds(simulate);
    let identify = "identify --robot panda --log hand.csv --data-check";
    here.refused(identify, " kg at the flange explains what");
    let ur10 = Robot::load(&data("ur10.toml")).expect("a robot");
    log_of(&ur10, &here.join("bad.csv"), 3000, 0.0, None, 0.05);
    judged("another arm");
    // The learner is not replayed on it either, but by force.
    let replay = "replay --robot ur5 --log bad.csv --out replayed";
    here.refused(replay, "another arm");
    here.succeeds(format!("{replay} --force"));
    // A bus slower than the log, every fourth row of which is the one before.
    let learnt = |change: fn(&mut Vec<Row>)| {
        here.write("slow.csv", planted(&good, change));
        here.succeeds("replay --robot ur5 --log slow.csv --out replayed");
        let report = here.json("replayed/report.json");
        report["rows_accepted_count"].as_u64().expect("a count")
    };
    fn every_other(rows: &mut Vec<Row>) {
        *rows = rows.iter().skip(1).step_by(2).cloned().collect();
    }
    let copies = |rows: &mut Vec<Row>| {
        every_other(rows);
        for k in (3..rows.len()).step_by(4) {
            let before = rows[k - 1][1..].to_vec();
            rows[k][1..].copy_from_slice(&before);
        }
    };
    let [all, slow] = [learnt(every_other), learnt(copies)];
    assert!(slow > 3 * all / 4, "{slow} of {all}");
    // A sound log of a plant that is not its description passes, and so does a refused one by force.
    // A refused one leaves the bank of before.
    let bank = here.join("out/parameters.bank");
    let mut before = None;
    for (arguments, writes) in [
        ("good.csv --methods wls", true),
        ("bad.csv --methods wls", false),
        ("bad.csv --methods wls --force", true),
    ] {
        here.run(format!("identify --robot ur5 --out out --log {arguments}"));
        let written = fs::read(&bank).ok();
        assert_eq!(written != before, writes, "{arguments}");
        before = written;
    }
}

#[test]
fn columns_of_real_logs_are_read_in_another_way_by_no_description_however_poor() {
    let here = Directory::new("poor");
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/ur5-real");
    let log = format!("{data}/Movement_No6_Acc_slow_Verify_Model.csv.gz");
    for seed in 0..16_u32 {
        let mut robot = Robot::load("ur5").expect("built in");
        // Uniform from -1 to 1.
        let mut draws =
            (1..).map(|k| (4e4 * (f64::from(100 * seed + k) * 12.9).sin()).rem_euclid(1.0));
        let mut draw = || 2.0 * draws.next().expect("endless") - 1.0;
        for joint in &mut robot.joints {
            joint.link.mass *= (0.5 * draw()).exp();
            joint.link.com += 0.05 * Vector3::new(draw(), draw(), draw());
            joint.link.inertia_com *= (0.7 * draw()).exp();
            joint.drive.rotor_inertia *= (1.0 + draw()).max(0.0);
        }
        here.write("poor.toml", robot.to_toml().expect("text"));
        let judged = format!("identify --data-check --robot poor.toml --log {log}");
        let output = here.run(&judged);
        let text =
            String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        assert_contains(&text, "joint 6 ");
        for reading in ["swapped", "another scale", "the other way"] {
            assert!(!text.contains(reading), "seed {seed}: {text}");
        }
    }
}

#[test]
fn a_sound_log_of_any_arm_is_refused_for_nothing() {
    let here = Directory::new("sound_logs");
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
            here.write("arm.toml", robot.to_toml().expect("text"));
            let path = "--trajectory validation --duration-s 8 --robot arm.toml --out log.csv";
            here.succeeds(format!("simulate {path} --seed {seed}"));
            here.succeeds("identify --data-check --robot arm.toml --log log.csv");
        }
    }
    // Few seconds of slow motion, in which what friction leaves looks like a delay.
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/paths/ur5.toml");
    here.succeeds(format!(
        "simulate --robot ur5 --trajectory {path} --torque-noise 0 --seed 1 --out log.csv"
    ));
    here.succeeds("identify --data-check --robot ur5 --log log.csv");
}

#[test]
fn the_real_ur5_is_replayed_with_the_figures_of_the_snapshot() {
    let here = Directory::new("replay_real");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests");
    here.succeeds(format!(
        "experiment replay-real --logs {root}/data/ur5-real --out out --snapshot {root}/snapshots/replay-real.txt"
    ));
}
