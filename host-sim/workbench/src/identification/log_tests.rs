//! One motion of a UR5 as every source writes it: the same rows.

use super::{LogRow, WholeLog};
use crate::robot::{EffortKind, LogColumns, Robot};
use std::f64::consts::{PI, TAU};
use std::fs;
use std::path::PathBuf;

const ROWS: usize = 60;

/// Rows and notes of a log of this name and content.
pub(super) fn read_text(
    name: &str,
    text: &str,
    robot: &Robot,
) -> Result<(Vec<LogRow>, String), String> {
    let here = tempfile::tempdir().expect("creates");
    let path = here.path().join(name);
    fs::write(&path, text).expect("writes");
    read(&path, robot)
}

pub(super) fn read(path: &std::path::Path, robot: &Robot) -> Result<(Vec<LogRow>, String), String> {
    let plain = |error: crate::table::TableError| {
        let directory = path.parent().expect("has one").display().to_string() + "/";
        error.to_string().replace(&directory, "")
    };
    let mut log = WholeLog::open(path, robot).map_err(plain)?;
    let mut rows = Vec::new();
    while let Some(row) = log.next_row().map_err(plain)? {
        rows.push(row);
    }
    let mut notes = log.notes.clone();
    notes.extend(log.reader.wraps());
    Ok((rows, notes.join("\n")))
}

pub(super) fn ur5() -> Robot {
    let mut robot = Robot::load("ur5").expect("built in");
    robot.log_columns = None;
    robot
}

/// Time, positions, velocities and torques of a row; joint 6 turns on.
fn row(k: usize) -> (f64, [f64; 6], [f64; 6], [f64; 6]) {
    let t = 0.25 * k as f64;
    let phases: [f64; 6] = std::array::from_fn(|j| t + j as f64);
    let (mut q, mut qd) = (phases.map(f64::sin), phases.map(f64::cos));
    (q[5], qd[5]) = (0.5 * t, 0.5);
    (t, q, qd, std::array::from_fn(|j| 10.0 * j as f64 + t))
}

/// A log whose columns of positions, velocities and torques have these names, and whose quantities these units.
///
/// `{0}` and `{1}` stand for the number of a joint from 0 and from 1, `{name}` for its name.
pub(super) fn table(names: [&str; 3], time: &str, separator: &str, units: [f64; 4]) -> String {
    let joints = ur5().joints;
    let column = |pattern: &str, j: usize| {
        let pattern = pattern
            .replace("{0}", &j.to_string())
            .replace("{name}", &joints[j].name);
        pattern.replace("{1}", &(j + 1).to_string())
    };
    let columns = names
        .iter()
        .flat_map(|name| (0..6).map(|j| column(name, j)));
    let header: Vec<String> = std::iter::once(time.to_owned()).chain(columns).collect();
    let rows = (0..ROWS).map(|k| {
        let (t, q, qd, tau) = row(k);
        let values = [
            (&[t][..], units[0]),
            (&q, units[1]),
            (&qd, units[2]),
            (&tau, units[3]),
        ];
        let fields = values
            .iter()
            .flat_map(|(values, unit)| values.iter().map(move |v| v / unit));
        fields.map(|field| field.to_string()).collect::<Vec<_>>()
    });
    let lines = std::iter::once(header).chain(rows);
    lines.map(|line| line.join(separator) + "\n").collect()
}

pub(super) fn own() -> String {
    table(
        ["q{1}_rad", "qd{1}_rad_s", "tau{1}_nm"],
        "t_s",
        ",",
        [1.0; 4],
    )
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

#[test]
fn every_source_gives_the_same_rows() {
    let degrees = [1.0, PI / 180.0, PI / 180.0, 1.0];
    let semicolons = own().replace(',', ";").replace('.', ",");
    let rtde = [
        "actual_q_{0}",
        "actual_qd_{0}",
        "actual_current_as_torque_{0}",
    ];
    let franka = ["state.q[{0}]", "state.dq[{0}]", "state.tau_J[{0}]"];
    let ros = [
        "{name}_joint/position",
        "{name}_joint/velocity",
        "{name}_joint/effort",
    ];
    let zero = ["q{0}_rad", "qd{0}_rad_s", "tau{0}_nm"];
    let exported = ros.map(|name| format!("/arm/joint_states/{name}"));
    let exported = exported.each_ref().map(String::as_str);
    let lerobot = ["{name}.pos", "{name}.vel", "{name}.torque"];
    let known = [
        ("own.csv", own(), ""),
        ("tabs.csv", own().replace(',', "\t"), ""),
        ("excel.csv", semicolons.clone(), ""),
        ("excel.txt", semicolons.replace(';', "\t"), ""),
        ("spaces.csv", own().replace(',', "   "), ""),
        ("comment.csv", format!("# {}", own().replace(',', " ")), ""),
        ("above.csv", format!("# by hand\n#\n\n# {}", own()), ""),
        (
            "amid.csv",
            format!(
                "# by hand\n{}",
                own().replacen("\n1,", "\n# mark, 2\n1,", 1)
            ),
            "",
        ),
        ("zero.csv", table(zero, "t_s", ",", [1.0; 4]), ""),
        (
            "rtde.csv",
            table(rtde, "timestamp", " ", [1.0; 4]),
            "columns of rtde",
        ),
        (
            "franka.csv",
            table(franka, "time", ",", [1e-3, 1.0, 1.0, 1.0]),
            "columns of franka",
        ),
        (
            "ros.csv",
            table(ros, "t_s", ",", [1.0; 4]),
            "joint shoulder_pan of the description is shoulder_pan_joint/position there",
        ),
        (
            "plotjuggler.csv",
            table(exported, "__time", ",", [1.0; 4]),
            "columns of ros",
        ),
        (
            "lerobot.csv",
            table(lerobot, "timestamp", ",", degrees),
            "columns of lerobot",
        ),
    ];
    for (name, text, note) in known {
        let (rows, notes) = read_text(name, &text, &ur5()).expect(name);
        is_the_motion(&rows, name);
        assert!(notes.contains(note), "{name}: {notes}");
    }
    let units = [1e-3, PI / 180.0, PI / 180.0, 1e-3];
    let plain = table(["a{0}", "b{0}", "c{0}"], "T", ",", units);
    let own = own();
    let (header, headless) = own.split_once('\n').expect("header");
    let names: Vec<String> = header.split(',').map(str::to_owned).collect();
    let list = "[\"a0\", \"a1\", \"a2\", \"a3\", \"a4\", \"a5\"]";
    let map = "t_s = \"T\"\nqd_rad_s = \"b{0}\"\ntau_nm = \"c{0}\"\nunits = \"t=ms,q=deg,tau=mNm\"\nq_rad = ";
    for (text, names, columns) in [
        (&*plain, Vec::new(), format!("{map}\"a{{0}}\"")),
        (&plain, Vec::new(), format!("{map}{list}")),
        (headless, names, String::new()),
    ] {
        let mut robot = ur5();
        let columns: LogColumns = toml::from_str(&columns).expect("a map");
        robot.log_columns = Some(LogColumns { names, ..columns });
        let (rows, _) = read_text("mapped.csv", text, &robot).expect("mapped");
        is_the_motion(&rows, "mapped");
    }
}

#[test]
fn units_replace_those_of_the_quantities_they_name() {
    let read_with = |name: &str, text: &str, units: &str, effort| {
        let mut robot = ur5();
        robot.log_columns = Some(LogColumns {
            all_units: Some(units.parse().expect("known")),
            effort,
            ..LogColumns::default()
        });
        read_text(name, text, &robot).expect(name).0
    };
    // Degrees of the one source and milliseconds of the other stay.
    let degree = PI / 180.0;
    let lerobot = ["{name}.pos", "{name}.vel", "{name}.torque"];
    let lerobot = table(lerobot, "timestamp", ",", [1.0, degree, degree, 1e-3]);
    let franka = ["state.q[{0}]", "state.dq[{0}]", "state.tau_J[{0}]"];
    let franka = table(franka, "time", ",", [1e-3, 1.0, 1.0, 1e-3]);
    for (name, text) in [("lerobot.csv", lerobot), ("franka.csv", franka)] {
        is_the_motion(&read_with(name, &text, "tau=mNm", None), name);
    }
    // Currents in the columns of torques.
    let ros = [
        "{name}_joint/position",
        "{name}_joint/velocity",
        "{name}_joint/effort",
    ];
    let current = Some(EffortKind::Current);
    let [ampere, milli] = [("i=A", 1.0), ("i=mA", 1e-3)].map(|(units, unit)| {
        let text = table(ros, "t_s", ",", [1.0, 1.0, 1.0, unit]);
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
    let mut lines = own.lines();
    let mut text = format!(
        "{},{}\n",
        lines.next().expect("header"),
        "a1,a2,a3,a4,a5,a6"
    );
    for (k, line) in lines.enumerate() {
        let (_, _, _, tau) = row(k);
        let measured = tau.map(|tau| (-1e3 * tau).to_string()).join(",");
        text += &format!("{line},{measured}\n");
    }
    let read_by = |map: &str| {
        let mut robot = ur5();
        let map: LogColumns = toml::from_str(map).expect("a map");
        let all_units = map.units.clone();
        robot.log_columns = Some(LogColumns {
            required: true,
            all_units,
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
        let (rows, _) = read_by(&map).expect("a log");
        is_the_motion(&rows, &map);
    }
    for (map, problem) in [
        ("q_rad = 'pos{}'", "column pos1 is missing"),
        ("q_rad = 'q{2}_rad'", "q has one column for all joints"),
        ("tau_nm = ['a1', 'a2']", "2 names of columns for 6 joints"),
        ("t_s = 'time'", "column time is missing"),
        ("t_s = 't_s'\nrate_hz = 100.0", "keep one of them"),
        ("rate_hz = -1.0", "rate_hz is -1, no number of rows"),
        (
            "tau_nm = 'a'",
            "tau has one column for all joints: write {}",
        ),
    ] {
        let error = read_by(map).expect_err(map);
        assert!(error.contains(problem), "{map}: {error}");
    }
    let mut robot = ur5();
    robot.joints[2].drive.gain = None;
    let currents = own.replace("_nm", "_a").replace("tau", "i");
    let error = read_text("currents.csv", &currents, &robot).expect_err("no gain");
    assert!(
        error.contains("the gain of joint 3 is not known"),
        "{error}"
    );
    for effort in [EffortKind::Torque, EffortKind::Motor] {
        let mut robot = ur5();
        robot.log_columns = Some(LogColumns {
            effort: Some(effort),
            ..LogColumns::default()
        });
        let error = read_text("currents.csv", &currents, &robot).expect_err("no torques");
        assert!(error.contains("column i1_a is a motor current"), "{error}");
    }
    let here = tempfile::tempdir().expect("creates");
    let path = here.path().join("currents.csv");
    fs::write(&path, currents).expect("writes");
    let error = super::with_gains(&robot, &[path], 0.05).expect_err("no standstill");
    let wanted = "standstill does not show the gain of joint 3: give --drive-gains";
    assert!(error.to_string().contains(wanted), "{error}");
}

#[test]
fn wrapped_angles_continue_on_continuous_joints_only() {
    let mut text = own().lines().next().expect("header").to_owned() + "\n";
    for k in 0..ROWS {
        let (t, mut q, qd, tau) = row(k);
        q[5] -= TAU * ((q[5] + PI) / TAU).floor();
        let values = [&[t][..], &q, &qd, &tau].concat();
        let fields: Vec<String> = values.iter().map(f64::to_string).collect();
        text += &(fields.join(",") + "\n");
    }
    let (rows, notes) = read_text("wrapped.csv", &text, &ur5()).expect("continuous");
    is_the_motion(&rows, "wrapped");
    let wraps = "angles un-wrapped: joint 6 1 times";
    assert!(notes.contains(wraps), "{notes}");
    let mut limited = ur5();
    limited.joints[5].limits.position = (-3.0, 3.0);
    let refused = read_text("wrapped.csv", &text, &limited);
    let refused = refused.expect_err("limited");
    let jump = "wrapped.csv:28: column q6_rad: a jump of -6.158 rad";
    assert!(refused.starts_with(jump), "{refused}");
    // Over ten seconds without rows it can make that way.
    let mut apart = own().lines().next().expect("header").to_owned() + "\n";
    for k in 0..ROWS {
        let (t, mut q, qd, tau) = row(k);
        let behind = f64::from(u8::from(k >= ROWS / 2));
        q[5] = 2.8 * (2.0 * behind - 1.0);
        let values = [&[t + 10.0 * behind][..], &q, &qd, &tau].concat();
        let fields: Vec<String> = values.iter().map(f64::to_string).collect();
        apart += &(fields.join(",") + "\n");
    }
    let (rows, notes) = read_text("apart.csv", &apart, &limited).expect("two sections");
    assert_eq!((rows[0].q[5], rows[ROWS - 1].q[5]), (-2.8, 2.8));
    assert!(!notes.contains("un-wrapped"), "{notes}");
    // Torques stand for the positions.
    let mut text = own().lines().next().expect("header").to_owned() + "\n";
    for k in 0..ROWS {
        let (t, q, qd, _) = row(k);
        let noise = std::array::from_fn::<f64, 6, _>(|j| 3.1 * (((k + j) * 7 % 3) as f64 - 1.0));
        let values = [&[t][..], &noise, &qd, &q].concat();
        let fields: Vec<String> = values.iter().map(f64::to_string).collect();
        text += &(fields.join(",") + "\n");
    }
    let refused = read_text("swapped.csv", &text, &limited);
    let refused = refused.expect_err("noise is no position");
    assert!(
        refused.contains("positions and torques are swapped"),
        "{refused}"
    );
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
    for log in ["panda.db3", "panda.mcap"] {
        same("panda", data.join(log), data.join("panda.csv.gz"), 727);
    }
    // A file that was cut reads up to its last whole chunk, and a cut database is refused.
    let here = tempfile::tempdir().expect("creates");
    let whole = fs::read(data.join("panda.mcap")).expect("reads");
    let cut = here.path().join("cut.mcap");
    fs::write(&cut, &whole[..whole.len() / 2]).expect("writes");
    let panda = Robot::load("panda").expect("built in");
    match read(&cut, &panda) {
        Ok((rows, _)) => assert!(rows.len() < 727),
        // The whole file is one chunk.
        Err(refused) => assert!(refused.contains("cut.mcap"), "{refused}"),
    }
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
    let (rows, _) = read(&unstamped, &panda).expect("a bag");
    assert_eq!(rows.len(), 727);
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
    let map = LogColumns {
        of_joints: true,
        ..LogColumns::default()
    };
    robot.log_columns = Some(map);
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
