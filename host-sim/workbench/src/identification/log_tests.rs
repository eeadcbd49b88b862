//! Logs for tests: files of any rows, and one motion of a UR5 as every source writes it, which must give the same rows.

use super::{LogRow, WholeLog};
use crate::robot::{EffortKind, LogColumns, Robot};
use std::f64::consts::{PI, TAU};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const ROWS: usize = 60;

/// A file in a directory of its own, which is removed with the first.
pub(super) fn file(name: &str, text: &str) -> (TempDir, PathBuf) {
    let here = tempfile::tempdir().expect("creates");
    let path = here.path().join(name);
    fs::write(&path, text).expect("writes");
    (here, path)
}

pub(super) fn text_of(
    header: &str,
    separator: &str,
    rows: impl Iterator<Item = impl AsRef<[f64]>>,
) -> String {
    let mut text = header.to_owned() + "\n";
    for row in rows {
        let fields: Vec<String> = row.as_ref().iter().map(f64::to_string).collect();
        text += &(fields.join(separator) + "\n");
    }
    text
}

pub(super) fn log_of(
    header: &str,
    rows: impl IntoIterator<Item = impl AsRef<[f64]>>,
) -> (TempDir, PathBuf) {
    file("log.csv", &text_of(header, ",", rows.into_iter()))
}

pub(super) fn first_joints(count: usize) -> Robot {
    let mut robot = ur5();
    robot.joints.truncate(count);
    robot
}

/// Rows and notes of a log of this name and content.
pub(super) fn read_text(
    name: &str,
    text: &str,
    robot: &Robot,
) -> Result<(Vec<LogRow>, String), String> {
    let (_here, path) = file(name, text);
    read(&path, robot)
}

pub(super) fn read(path: &Path, robot: &Robot) -> Result<(Vec<LogRow>, String), String> {
    let plain = |error: crate::table::TableError| {
        let directory = path.parent().expect("has one").display().to_string() + "/";
        error.to_string().replace(&directory, "")
    };
    let mut log = WholeLog::open(path, robot).map_err(plain)?;
    let rows = std::iter::from_fn(|| log.next_row().transpose());
    let rows = rows.collect::<Result<_, _>>().map_err(plain)?;
    let mut notes = log.notes.clone();
    notes.extend(log.reader.wraps());
    Ok((rows, notes.join("\n")))
}

pub(super) fn ur5() -> Robot {
    let mut robot = Robot::load("ur5").expect("built in");
    robot.log_columns = None;
    robot
}

/// Time, positions, velocities and torques of a row.
type Row = (f64, [f64; 6], [f64; 6], [f64; 6]);

/// A row of the motion; joint 6 turns on.
fn row(k: usize) -> Row {
    let t = 0.25 * k as f64;
    let phases: [f64; 6] = std::array::from_fn(|j| t + j as f64);
    let (mut q, mut qd) = (phases.map(f64::sin), phases.map(f64::cos));
    (q[5], qd[5]) = (0.5 * t, 0.5);
    (t, q, qd, std::array::from_fn(|j| 10.0 * j as f64 + t))
}

// Names of the columns of positions, velocities and torques by source: `{0}` and `{1}` stand for the number of a joint from 0
// and from 1, `{name}` for its name.
const OWN: [&str; 3] = ["q{1}_rad", "qd{1}_rad_s", "tau{1}_nm"];
const FRANKA: [&str; 3] = ["state.q[{0}]", "state.dq[{0}]", "state.tau_J[{0}]"];
const LEROBOT: [&str; 3] = ["{name}.pos", "{name}.vel", "{name}.torque"];
const RTDE: [&str; 3] = [
    "actual_q_{0}",
    "actual_qd_{0}",
    "actual_current_as_torque_{0}",
];
const ROS: [&str; 3] = [
    "{name}_joint/position",
    "{name}_joint/velocity",
    "{name}_joint/effort",
];
const DEGREE: f64 = PI / 180.0;

/// Values of a row in these units of time, positions, velocities and torques.
fn values((t, q, qd, tau): Row, [of_t, units @ ..]: [f64; 4]) -> Vec<f64> {
    let quantities = [q, qd, tau].into_iter().zip(units);
    let quantities = quantities.flat_map(|(values, unit)| values.map(|value| value / unit));
    std::iter::once(t / of_t).chain(quantities).collect()
}

/// A log of the motion whose columns have these names, and whose time, positions, velocities and torques these units.
pub(super) fn table(names: [&str; 3], time: &str, separator: &str, units: [f64; 4]) -> String {
    let joints = ur5().joints;
    let column = |pattern: &str, j: usize| {
        let pattern = pattern.replace("{0}", &j.to_string());
        let pattern = pattern.replace("{name}", &joints[j].name);
        pattern.replace("{1}", &(j + 1).to_string())
    };
    let columns = names.iter();
    let columns = columns.flat_map(|name| (0..6).map(|j| column(name, j)));
    let header: Vec<String> = std::iter::once(time.to_owned()).chain(columns).collect();
    let rows = (0..ROWS).map(|k| values(row(k), units));
    text_of(&header.join(separator), separator, rows)
}

pub(super) fn own() -> String {
    table(OWN, "t_s", ",", [1.0; 4])
}

/// A log of other rows under the project's own names.
fn own_of(row: impl Fn(usize) -> Row) -> String {
    let own = own();
    let (header, _) = own.split_once('\n').expect("header");
    let rows = (0..ROWS).map(|k| values(row(k), [1.0; 4]));
    text_of(header, ",", rows)
}

fn is_the_motion(rows: &[LogRow], name: &str) {
    assert_eq!(rows.len(), ROWS, "{name}");
    for (k, found) in rows.iter().enumerate() {
        let (t, q, qd, tau) = row(k);
        let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!((found.t_s - t).abs() < 1e-9, "{name}");
        let moved = close(&found.qd, &qd) || found.qd == [0.0; 6].into();
        let same = close(&found.q, &q) && close(&found.tau, &tau) && moved;
        assert!(same, "{name} row {k}: {found:?}");
    }
}

/// A UR5 whose logs have these columns.
fn mapped(columns: LogColumns) -> Robot {
    Robot {
        log_columns: Some(columns),
        ..ur5()
    }
}

#[test]
fn every_source_gives_the_same_rows() {
    let amid = own().replacen("\n1,", "\n# mark, 2\n1,", 1);
    // Separators at the ends of the rows, and a column that is not read, first without a number.
    let ends = own().replace('\n', ",\n");
    let unread = own().replace('\n', ",1\n").replacen(",1\n", ",x\n", 1);
    let unread = format!("# {}", unread.replacen(",1\n", ",nan\n", 1));
    let zero = ["q{0}_rad", "qd{0}_rad_s", "tau{0}_nm"];
    for (name, text) in [
        ("own.csv", own()),
        ("tabs.csv", own().replace(',', "\t")),
        ("excel.csv", own().replace(',', ";").replace('.', ",")),
        ("excel.txt", own().replace(',', "\t").replace('.', ",")),
        ("spaces.csv", own().replace(',', "   ")),
        ("comment.csv", format!("# {}", own().replace(',', " "))),
        ("ends.csv", ends.clone()),
        ("rows_end.csv", ends.replacen(",\n", "\n", 1)),
        (
            "comment_ends.csv",
            format!("# {}", ends.replacen(",\n", "\n", 1)),
        ),
        ("unread.csv", unread),
        ("above.csv", format!("# by hand\n#\n\n# {}", own())),
        ("amid.csv", format!("# by hand\n{amid}")),
        ("zero.csv", table(zero, "t_s", ",", [1.0; 4])),
    ] {
        is_the_motion(&read_text(name, &text, &ur5()).expect(name).0, name);
    }
    // A driver that has no velocities, or no torques.
    let bare = |places: std::ops::Range<usize>| -> String {
        let own = own();
        let lines = own.lines().enumerate().map(|(k, line)| {
            let mut fields: Vec<&str> = line.split(',').collect();
            let without = fields[places.clone()].iter_mut().filter(|_| k > 0);
            without.for_each(|field| *field = "nan");
            fields.join(",") + "\n"
        });
        lines.collect()
    };
    let error = read_text("bare.csv", &bare(13..19), &ur5()).expect_err("no torques");
    assert!(error.contains("column tau1_nm has no numbers"), "{error}");
    let (rows, notes) = read_text("bare.csv", &bare(7..13), &ur5()).expect("a log");
    is_the_motion(&rows, "bare.csv");
    assert!(notes.contains("its velocities are no numbers"), "{notes}");
    let exported = ROS.map(|name| format!("/arm/joint_states/{name}"));
    let exported = exported.each_ref().map(String::as_str);
    let old = FRANKA.map(|name| name.trim_start_matches("state."));
    let (ms, degrees) = ([1e-3, 1.0, 1.0, 1.0], [1.0, DEGREE, DEGREE, 1.0]);
    let other_joints = "joint shoulder_pan of the description is shoulder_pan_joint/position there";
    for (note, text) in [
        ("columns of rtde", table(RTDE, "timestamp", " ", [1.0; 4])),
        ("columns of franka", table(FRANKA, "time", ",", ms)),
        ("columns of franka", table(old, "duration", ",", ms)),
        (other_joints, table(ROS, "t_s", ",", [1.0; 4])),
        ("columns of ros", table(exported, "__time", ",", [1.0; 4])),
        (
            "columns of lerobot",
            table(LEROBOT, "timestamp", ",", degrees),
        ),
    ] {
        let (rows, notes) = read_text("known.csv", &text, &ur5()).expect(note);
        is_the_motion(&rows, note);
        assert!(notes.contains(note), "{note}: {notes}");
    }
    let units = [1e-3, DEGREE, DEGREE, 1e-3];
    let plain = table(["a{0}", "b{0}", "c{0}"], "T", ",", units);
    let own = own();
    let (header, headless) = own.split_once('\n').expect("header");
    let names: Vec<String> = header.split(',').map(str::to_owned).collect();
    let list = "[\"a0\", \"a1\", \"a2\", \"a3\", \"a4\", \"a5\"]";
    let map = "t_s = \"T\"\nqd_rad_s = \"b{0}\"\ntau_nm = \"c{0}\"\nunits = \"t=ms,q=deg,tau=mNm\"\nq_rad = ";
    let echoed: String = headless.lines().map(|row| format!("x,,{row}\n")).collect();
    let of_text = ["text", "empty"].map(str::to_owned).into_iter();
    let percent = map.replacen('T', "%time", 1) + "\"a{0}\"";
    for (text, names, columns) in [
        (
            &*echoed,
            of_text.chain(names.clone()).collect(),
            String::new(),
        ),
        (&plain.replacen('T', "%time", 1), Vec::new(), percent),
        (&plain, Vec::new(), format!("{map}\"a{{0}}\"")),
        (&plain, Vec::new(), format!("{map}{list}")),
        (headless, names.clone(), String::new()),
        (
            &headless.replace(',', " ").replace('.', ","),
            names,
            String::new(),
        ),
    ] {
        let columns: LogColumns = toml::from_str(&columns).expect("a map");
        let robot = mapped(LogColumns { names, ..columns });
        let (rows, _) = read_text("mapped.csv", text, &robot).expect("mapped");
        is_the_motion(&rows, "mapped");
    }
}

#[test]
fn units_replace_those_of_the_quantities_they_name() {
    let read_with = |name: &str, text: &str, units: &str, effort| {
        let robot = mapped(LogColumns {
            all_units: Some(units.parse().expect("known")),
            effort,
            ..LogColumns::default()
        });
        read_text(name, text, &robot).expect(name).0
    };
    // Degrees of the one source and milliseconds of the other stay.
    let lerobot = table(LEROBOT, "timestamp", ",", [1.0, DEGREE, DEGREE, 1e-3]);
    let franka = table(FRANKA, "time", ",", [1e-3, 1.0, 1.0, 1e-3]);
    for (name, text) in [("lerobot.csv", lerobot), ("franka.csv", franka)] {
        is_the_motion(&read_with(name, &text, "tau=mNm", None), name);
    }
    let robot = mapped(LogColumns {
        all_units: Some("i=mA".parse().expect("known")),
        ..LogColumns::default()
    });
    let (_, notes) = read_text("torques.csv", &own(), &robot).expect("a log");
    assert!(notes.contains("the unit of i is not used"), "{notes}");
    // Currents in the columns of torques.
    let current = Some(EffortKind::Current);
    let [ampere, milli] = [("i=A", 1.0), ("i=mA", 1e-3)].map(|(units, unit)| {
        let text = table(ROS, "t_s", ",", [1.0, 1.0, 1.0, unit]);
        read_with("currents.csv", &text, units, current)
    });
    let gains: Vec<f64> = ur5().joints.iter().map(|joint| joint.gain()).collect();
    for ((one, other), k) in ampere.iter().zip(&milli).zip(0..) {
        for (joint, tau) in row(k).3.iter().enumerate() {
            let wanted = gains[joint] * tau;
            assert!((one.tau[joint] - wanted).abs() < 1e-9);
            assert!((other.tau[joint] - wanted).abs() < 1e-9);
        }
    }
}

#[test]
fn a_required_map_wins_over_own_names() {
    // Commands under the own names, measured torques beside them.
    let own = own();
    let measured = (0..ROWS).map(|k| row(k).3.map(|tau| -1e3 * tau));
    let measured = text_of("a1,a2,a3,a4,a5,a6", ",", measured);
    let lines = own.lines().zip(measured.lines());
    let text: String = lines
        .map(|(own, measured)| format!("{own},{measured}\n"))
        .collect();
    let read_by = |map: &str| {
        let map: LogColumns = toml::from_str(map).expect("a map");
        let robot = mapped(LogColumns {
            required: true,
            all_units: map.units.clone(),
            ..map
        });
        read_text("both.csv", &text, &robot)
    };
    let measured = "tau_nm = 'a{}'\nunits = 'tau=-mNm'";
    let rate_hz = 1.0 / (row(1).0 - row(0).0);
    for map in [
        measured.to_owned(),
        format!("{measured}\nrate_hz = {rate_hz}"),
    ] {
        is_the_motion(&read_by(&map).expect("a log").0, &map);
    }
    // Maps, and the words of the refusal.
    let cases = "\
q_rad = 'pos{}' | column pos1 is missing: mend its name in the file of --columns-from
q_rad = 'q{2}_rad' | q_rad: {2} is none of {}, {0}, {1} and {name}
q_rad = 'pos_{nam}_{}' | q_rad: {nam} is none of
q_rad = 'q' | q_rad: q has one column for all joints: write {}
qd_rad_s = 'speed_{name}' | column speed_shoulder_pan is missing
i_a = 'current{}' | column current1 is missing
tau_nm = 'a{}';i_a = 'a{}' | tau_nm and i_a in one map of columns: keep one
tau_nm = ['a1', 'a2'] | 2 names of columns for 6 joints
t_s = 'time' | column time is missing
rate_hz = 100.0;t_s = 't_s' | keep one of them
rate_hz = -1.0 | rate_hz is -1, no number of rows
tau_nm = 'a' | tau has one column for all joints: write {}";
    for case in cases.lines() {
        let (map, problem) = case.split_once(" | ").expect("two parts");
        let error = read_by(&map.replace(';', "\n")).expect_err(map);
        assert!(error.contains(problem), "{map}: {error}");
    }
    let mut robot = ur5();
    robot.joints[2].drive.gain = None;
    let currents = own.replace("_nm", "_a").replace("tau", "i");
    let error = read_text("currents.csv", &currents, &robot).expect_err("no gain");
    let wanted = "the gain of joint 3 is not known";
    assert!(error.contains(wanted), "{error}");
    for effort in [EffortKind::Torque, EffortKind::Motor] {
        let robot = mapped(LogColumns {
            effort: Some(effort),
            ..LogColumns::default()
        });
        let error = read_text("currents.csv", &currents, &robot).expect_err("no torques");
        assert!(error.contains("column i1_a is a motor current"), "{error}");
    }
    let (_here, path) = file("currents.csv", &currents);
    let error = super::with_gains(&robot, &[path], 0.05).expect_err("no standstill");
    let wanted = "standstill does not show the gain of joint 3: give --drive-gains";
    assert!(error.to_string().contains(wanted), "{error}");
}

#[test]
fn positions_and_torques_are_of_one_topic_and_one_arm() {
    // Two tables side by side, of which only the first one has times.
    let beside = |left: &str, right: &str| -> String {
        let rows = left.lines().zip(right.lines());
        let rows = rows.map(|(left, right)| format!("{left},{right}\n"));
        rows.collect()
    };
    let topic = |head: &str, of_torque: &str, wrong: f64| {
        let quantities = ["position", "velocity", of_torque];
        let names = quantities.map(|quantity| format!("{head}{{name}}/{quantity}"));
        let names = names.each_ref().map(String::as_str);
        table(names, "__time", ",", [1.0, wrong, wrong, wrong])
    };
    let states = topic("/robot/joint_states/", "effort", 1.0);
    for head in ["/arm_controller/command/", "", "/joint_states/"] {
        let commands = topic(head, "other", 0.5);
        let commands = commands.replace("__time", "other_time");
        for text in [beside(&states, &commands), beside(&commands, &states)] {
            let (rows, notes) = read_text("commands.csv", &text, &ur5()).expect(head);
            is_the_motion(&rows, head);
            assert!(rows[9].qd != [0.0; 6].into(), "{head}");
            let there = "is /robot/joint_states/shoulder_pan/position there";
            assert!(notes.contains(there), "{notes}");
        }
    }
    // The names of the description win.
    let both = beside(
        &topic("/cmd/", "effort", 0.5),
        &topic("/joint_states/", "effort", 1.0),
    );
    let both = both.replacen("__time", "other_time", 1);
    is_the_motion(
        &read_text("exact.csv", &both, &ur5()).expect("one").0,
        "exact",
    );
    // Positions in one topic, and torques in another.
    let efforts = table(
        ["/a/{name}/x", "/a/{name}/y", "/b/{name}/effort"],
        "x",
        ",",
        [1.0; 4],
    );
    let parted = beside(&topic("/a/", "other", 1.0), &efforts);
    let (rows, notes) = read_text("parted.csv", &parted, &ur5()).expect("two topics");
    is_the_motion(&rows, "parted");
    let wanted = "positions are of /a/shoulder_pan/position, torques of /b/shoulder_pan/effort";
    assert!(notes.contains(wanted), "{notes}");
    // Several that could be meant, and the file that the refusal asks for.
    let lerobot = LEROBOT.map(|name| name.replace("{name}", "left_{name}"));
    let lerobot = lerobot.each_ref().map(String::as_str);
    let left = table(lerobot, "timestamp", ",", [1.0, DEGREE, DEGREE, 1.0]);
    let right = left.replace("left_", "right_").replace("timestamp", "x");
    let other = topic("/bbb/", "effort", 0.5).replace("__time", "x");
    for (one, other, all, units) in [
        (
            topic("/aaa/", "effort", 1.0),
            &other,
            "/aaa/shoulder_pan/position, /bbb/shoulder_pan/position",
            "",
        ),
        (
            topic("/joint_states/left_", "effort", 1.0),
            &other,
            "/joint_states/left_shoulder_pan/position, /bbb/shoulder_pan/position",
            "",
        ),
        (
            left,
            &right,
            "left_shoulder_pan.pos, right_shoulder_pan.pos",
            "\nunits = \"q=deg\"",
        ),
    ] {
        let text = beside(&one, other);
        let refused = read_text("two.csv", &text, &ur5()).expect_err(all);
        let start = format!("two.csv:1: several arms or topics have the joints: {all}\n");
        let rest = refused.strip_prefix(&start).expect(&refused);
        let (_, lines) = rest.split_once("FILE:\n").expect("lines of a file");
        assert!(
            lines.contains("\nqd_rad_s = ") && lines.ends_with(units),
            "{lines}"
        );
        let map: LogColumns = toml::from_str(lines).expect("a map");
        let map = LogColumns {
            required: true,
            all_units: map.units.clone(),
            ..map
        };
        is_the_motion(
            &read_text("two.csv", &text, &mapped(map)).expect(all).0,
            all,
        );
    }
    // A name that is not there leaves nothing of the file out.
    for (map, missing) in [
        (
            "t_s = '__time'\nq_rad = '/robot/joint_state/{name}/position'",
            "/robot/joint_state/shoulder_pan/position",
        ),
        (
            "tau_nm = '/robot/joint_states/{name}/efort'",
            "/robot/joint_states/shoulder_pan/efort",
        ),
    ] {
        let map: LogColumns = toml::from_str(map).expect("a map");
        let map = LogColumns {
            required: true,
            ..map
        };
        let refused = read_text("typo.csv", &states, &mapped(map)).expect_err(missing);
        assert!(
            refused.contains(&format!("column {missing} is missing")),
            "{refused}"
        );
    }
}

#[test]
fn wrapped_angles_continue_on_continuous_joints_only() {
    let text = own_of(|k| {
        let (t, mut q, qd, tau) = row(k);
        q[5] -= TAU * ((q[5] + PI) / TAU).floor();
        (t, q, qd, tau)
    });
    let (rows, notes) = read_text("wrapped.csv", &text, &ur5()).expect("continuous");
    is_the_motion(&rows, "wrapped");
    let wraps = "angles un-wrapped: joint 6 1 times";
    assert!(notes.contains(wraps), "{notes}");
    let mut limited = ur5();
    limited.joints[5].limits.position = (-3.0, 3.0);
    let refused = read_text("wrapped.csv", &text, &limited).expect_err("limited");
    let jump = "wrapped.csv:28: column q6_rad: a jump of -6.158 rad";
    assert!(refused.starts_with(jump), "{refused}");
    // Over ten seconds without rows it can make that way.
    let apart = own_of(|k| {
        let (t, mut q, qd, tau) = row(k);
        let behind = f64::from(u8::from(k >= ROWS / 2));
        q[5] = 2.8 * (2.0 * behind - 1.0);
        (t + 10.0 * behind, q, qd, tau)
    });
    let (rows, notes) = read_text("apart.csv", &apart, &limited).expect("two sections");
    assert_eq!((rows[0].q[5], rows[ROWS - 1].q[5]), (-2.8, 2.8));
    assert!(!notes.contains("un-wrapped"), "{notes}");
    // Torques stand for the positions.
    let swapped = own_of(|k| {
        let (t, q, qd, _) = row(k);
        let noise = std::array::from_fn(|j| 3.1 * (((k + j) * 7 % 3) as f64 - 1.0));
        (t, noise, qd, q)
    });
    let refused = read_text("swapped.csv", &swapped, &limited).expect_err("no position");
    let wanted = "positions and torques are swapped";
    assert!(refused.contains(wanted), "{refused}");
}

#[test]
fn bags_are_read_as_another_reader_reads_them() {
    let data = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/ros2-bags");
    fn same(robot: &str, one: PathBuf, two: PathBuf, rows: usize) {
        let robot = Robot::load(robot).expect("a robot");
        let (one, _) = read(&one, &robot).expect("a bag");
        let (two, _) = read(&two, &robot).expect("another reader's");
        assert_eq!((one.len(), two.len()), (rows, rows));
        for (a, b) in one.iter().zip(&two) {
            assert_eq!((a.t_s, a.q, a.qd, a.tau), (b.t_s, b.q, b.qd, b.tau));
        }
    }
    let ur10 = data.join("ur10.toml").display().to_string();
    same(&ur10, data.join("ur10.db3"), data.join("ur10.csv.gz"), 3441);
    // 14 of its 727 rows repeat the one before.
    for log in ["panda.db3", "panda.mcap"] {
        same("panda", data.join(log), data.join("panda.csv.gz"), 713);
    }
    let here = tempfile::tempdir().expect("creates");
    let panda = Robot::load("panda").expect("built in");
    // Without stamps in the headers the times are those of the receipts.
    let unstamped = here.path().join("unstamped.db3");
    fs::copy(data.join("panda.db3"), &unstamped).expect("copies");
    let bag = rusqlite::Connection::open(&unstamped).expect("a database");
    let mut messages = bag.prepare("SELECT id, data FROM messages").expect("reads");
    let messages = messages.query_map([], |row| Ok((row.get(0)?, row.get(1)?)));
    for message in messages.expect("reads").map(Result::unwrap) {
        let (id, mut data): (i64, Vec<u8>) = message;
        data[4..12].fill(0);
        let update = "UPDATE messages SET data = ?2 WHERE id = ?1";
        bag.execute(update, (id, data)).expect("writes");
    }
    let (_, notes) = read(&data.join("panda.db3"), &panda).expect("a bag");
    assert!(notes.contains("time by the stamps of"), "{notes}");
    let (rows, notes) = read(&unstamped, &panda).expect("a bag");
    assert!(notes.contains("time by their receipt"), "{notes}");
    assert_eq!(rows.len(), 713);
    assert!((0.0..0.1).contains(&(rows[1].t_s - rows[0].t_s)));
    let bag = fs::read(data.join("panda.db3")).expect("reads");
    let cut = here.path().join("cut.db3");
    fs::write(&cut, &bag[..bag.len() / 2]).expect("writes");
    let refused = read(&cut, &panda).expect_err("malformed");
    assert!(refused.contains("malformed"), "{refused}");
}

/// Motions and torques of the joints, and currents of the drives, of an arm whose last drives turn two joints.
#[test]
fn logs_of_coupled_joints_become_those_of_the_drives() {
    let mut text = ur5().to_toml().expect("serialises");
    text += "\n[coupling]\njoints = ['wrist_2', 'wrist_3']\nmatrix = [[1, 1], [1, -1]]\n";
    let mut robot = Robot::parse("coupled", &text).expect("a description");
    let (drives, _) = read_text("drives.csv", &own(), &robot).expect("a log");
    is_the_motion(&drives, "drives");
    robot.log_columns = Some(LogColumns {
        of_joints: true,
        ..LogColumns::default()
    });
    let (joints, _) = read_text("joints.csv", &own(), &robot).expect("a log");
    let currents = own().replace("_nm", "_a").replace("tau", "i");
    let (currents, _) = read_text("currents.csv", &currents, &robot).expect("a log");
    for ((joint, current), k) in joints.iter().zip(&currents).zip(0..) {
        let (_, q, _, tau) = row(k);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(close(joint.q[4], q[4] + q[5]) && close(joint.q[5], q[4] - q[5]));
        // The same power: tau5 q5' + tau6 q6' = m5 (q5' + q6') + m6 (q5' - q6').
        assert!(close(joint.tau[4] + joint.tau[5], tau[4]));
        assert!(close(joint.tau[4] - joint.tau[5], tau[5]));
        assert!(close(current.q[4], joint.q[4]));
        assert!(close(current.tau[4], tau[4] * robot.joints[4].gain()));
    }
}
