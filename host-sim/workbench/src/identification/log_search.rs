//! Search for the columns of each quantity in the header of a log.

use crate::dynamics::PerJoint;
use crate::robot::{ColumnNames, LOG_SOURCES, LogColumns, Robot};
use crate::table::{Rows, TableError};
use std::collections::HashSet;

/// The log has a column of that name, or several.
pub(super) fn has(rows: &Rows, name: &str) -> bool {
    !matches!(rows.find(name), Ok(None))
}

/// The log has the column of the first joint.
pub(super) fn is_there(rows: &Rows, names: &ColumnNames, robot: &Robot) -> bool {
    let first = names.of(0, &robot.joints[0].name);
    first.is_some_and(|first| has(rows, &first)) || !joints_of_log(rows, names).is_empty()
}

/// Names of the joints in a log whose columns carry them.
fn joints_of_log<'a>(rows: &'a Rows, names: &ColumnNames) -> Vec<&'a str> {
    let Some((before, after)) = names.around_name() else {
        return Vec::new();
    };
    let inner = |name: &'a String| name.strip_prefix(before)?.strip_suffix(after);
    rows.header.iter().filter_map(inner).collect()
}

/// Names without what all of them begin and end with.
fn cores<'a>(names: &[&'a str]) -> Vec<&'a str> {
    let Some(first) = names.first().filter(|_| names.len() > 1) else {
        return names.to_vec();
    };
    let same =
        |pairs: &dyn Fn(&str) -> usize| names.iter().map(|name| pairs(name)).min().unwrap_or(0);
    let head = same(&|name| {
        let pairs = first.bytes().zip(name.bytes());
        pairs.take_while(|(a, b)| a == b).count()
    });
    let back = |name: &str| {
        let pairs = first.bytes().rev().zip(name.bytes().rev());
        let equal = pairs.take_while(|(a, b)| a == b).count();
        equal.min(name.len() - head)
    };
    let tail = same(&back);
    let cut = |name: &&'a str| name.get(head..name.len() - tail).unwrap_or(name);
    names.iter().map(cut).collect()
}

/// Likeness of the joints of a message to those of the robot: 2 with all their names, 1 with these but for what all begin
/// and end with, beside others or not, else 0.
pub(super) fn likeness(names: &[String], mapped: Option<&ColumnNames>, robot: &Robot) -> usize {
    let ours: Vec<&str> = robot.joints.iter().map(|own| own.name.as_str()).collect();
    let there: Vec<&str> = names.iter().map(String::as_str).collect();
    let is_there = |(joint, own): (usize, &&str)| {
        let column = mapped.and_then(|names| names.of(joint, own));
        let named = column
            .as_ref()
            .and_then(|own| own.strip_suffix("/position"));
        there.contains(&named.unwrap_or(own))
    };
    if ours.iter().enumerate().all(is_there) {
        return 2;
    }
    usize::from(!framed(&there, &cores(&ours)).is_empty())
}

/// Names of the joints of the arm in a log, in the order of the description.
type Names = Vec<String>;

/// Beginnings and ends around all of the `cores` among more names: a gripper has joints of its own, and so has a second arm.
fn framed(there: &[&str], cores: &[&str]) -> Vec<Names> {
    let Some(longest) = cores.iter().max_by_key(|core| core.len()) else {
        return Vec::new();
    };
    let all: HashSet<&str> = there.iter().copied().collect();
    let mut found: Vec<Names> = Vec::new();
    for name in there {
        for (at, _) in name.char_indices() {
            let (head, rest) = name.split_at(at);
            let Some(tail) = rest.strip_prefix(longest) else {
                continue;
            };
            let cores = cores.iter().map(|core| format!("{head}{core}{tail}"));
            let names: Names = cores.collect();
            let is_whole = names.iter().all(|name| all.contains(name.as_str()));
            if is_whole && !found.contains(&names) {
                found.push(names);
            }
        }
    }
    found
}

fn is_ours(names: &[String], robot: &Robot) -> bool {
    names.iter().eq(robot.joints.iter().map(|own| &own.name))
}

/// Names under which the joints have a column each: those of the description, and those that differ from them in what all of
/// them begin and end with.
fn names_there(rows: &Rows, columns: &ColumnNames, robot: &Robot) -> Vec<Names> {
    let ours: Vec<&str> = robot.joints.iter().map(|own| own.name.as_str()).collect();
    let column = |(joint, own): (usize, &&str)| columns.of(joint, own);
    let mut own = ours.iter().enumerate().map(column);
    let is_exact = own.all(|own| own.is_some_and(|own| has(rows, &own)));
    let exact = is_exact.then(|| ours.iter().map(|own| (*own).to_owned()).collect());
    let mut found = framed(&joints_of_log(rows, columns), &cores(&ours));
    found.retain(|names| !is_ours(names, robot));
    exact.into_iter().chain(found).collect()
}

/// Names of the joints in the columns of positions and in those of torques or currents: the same ones where some have both,
/// which are of one arm and one topic.
fn names_of_both(rows: &Rows, map: &LogColumns, robot: &Robot) -> (bool, [Vec<Names>; 2]) {
    let [q, _, _, tau, i] = map.quantities().map(|columns| {
        let found = columns.map(|columns| names_there(rows, columns, robot));
        found.unwrap_or_default()
    });
    let torques = if tau.is_empty() { i } else { tau };
    let mut both = q.clone();
    both.retain(|names| torques.contains(names));
    match both.is_empty() {
        true => (false, [q, torques]),
        false => (true, [both.clone(), both]),
    }
}

/// Rank of a map for a log: it has positions and torques by the names of the description, and of how many arms and topics.
pub(super) fn rank(rows: &Rows, map: &LogColumns, robot: &Robot) -> (bool, usize) {
    let (is_of_one, [names, _]) = names_of_both(rows, map, robot);
    let count = if is_of_one { names.len() } else { 0 };
    let is_exact = is_of_one && names.iter().any(|names| is_ours(names, robot));
    (is_exact, count)
}

/// Names of the joints in the columns of motions and in those of torques; `None` without a column of all joints.
///
/// Errors: several arms or topics, and none with the names of the description.
pub(super) fn names_in_log(
    rows: &Rows,
    map: &LogColumns,
    robot: &Robot,
) -> Result<[Option<Names>; 2], TableError> {
    let (_, sets) = names_of_both(rows, map, robot);
    let chosen = sets.each_ref().map(|sets| {
        let exact = sets.iter().find(|names| is_ours(names, robot));
        exact.or(sets.first()).cloned()
    });
    let quantities = map.quantities();
    for (sets, columns) in sets.iter().zip([&quantities[..1], &quantities[3..]]) {
        if sets.len() < 2 || sets.iter().any(|names| is_ours(names, robot)) {
            continue;
        }
        let first = |names: &Names| {
            let own = columns.iter().flatten();
            let mut own = own.filter_map(|columns| columns.of(0, names.first()?));
            own.find(|name| has(rows, name))
        };
        let mut all: Vec<String> = sets.iter().filter_map(first).collect();
        if all.len() > SHOWN_ARMS {
            all.splice(SHOWN_ARMS.., ["…".to_owned()]);
        }
        let time = map.t_s.iter().filter(|name| has(rows, name));
        let time = time.map(|name| format!("t_s = \"{name}\""));
        let keys = ["q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm", "i_a"];
        let lines = (0..keys.len()).filter_map(|kind| {
            let (columns, names) = (quantities[kind]?, chosen[kind / 3].as_ref()?);
            let there = columns.of(0, names.first()?)?;
            has(rows, &there)
                .then(|| format!("{} = {}", keys[kind], written(columns, names, robot)))
        });
        let units = map
            .units
            .iter()
            .filter(|units| units.scale(None) != [1.0; 6]);
        let units = units.map(|units| format!("units = \"{}\"", String::from(units.clone())));
        let lines: Vec<String> = time.chain(lines).chain(units).collect();
        return Err(rows.header_error(format!(
            "several arms or topics have the joints: {}\n  write these lines, or those of another, into a file, and add --columns-from FILE:\n{}",
            all.join(", "),
            lines.join("\n")
        )));
    }
    Ok(chosen)
}

/// Arms or topics that a refusal lists.
const SHOWN_ARMS: usize = 6;

/// Columns in TOML: a pattern where the names hold those of the description, else a list.
fn written(columns: &ColumnNames, names: &[String], robot: &Robot) -> String {
    let pattern = || {
        let (before, after) = columns.around_name()?;
        let (head, tail) = names.first()?.split_once(&robot.joints[0].name)?;
        let mut pairs = names.iter().zip(&robot.joints);
        let is_so = pairs.all(|(name, own)| *name == format!("{head}{}{tail}", own.name));
        is_so.then(|| format!("\"{before}{head}{{name}}{tail}{after}\""))
    };
    let column = |(joint, name): (usize, &String)| columns.of(joint, name);
    pattern().unwrap_or_else(|| {
        let all: Vec<String> = names.iter().enumerate().filter_map(column).collect();
        format!("{all:?}")
    })
}

/// Place of a column that the file of `--columns-from` names.
pub(super) fn required_column(rows: &Rows, name: &str) -> Result<usize, TableError> {
    rows.find(name)?.ok_or_else(|| {
        let way = "mend its name in the file of --columns-from";
        rows.header_error(format!("column {name} is missing: {way}"))
    })
}

/// Columns of one quantity for all joints, and whether they have the project's own names; `None` without a column of it.
///
/// * `mapped` names of the map, and whether they must be there
/// * `in_log` names of the joints in the log
pub(super) fn joint_places(
    rows: &Rows,
    (name, unit): (&str, &str),
    (mapped, required): (Option<&ColumnNames>, bool),
    in_log: Option<&[String]>,
    robot: &Robot,
) -> Result<Option<(PerJoint<usize>, bool)>, TableError> {
    let joints = robot.joint_count();
    let joint_name = |joint: usize| match in_log {
        Some(names) => names.get(joint).map_or("", String::as_str),
        None => robot.joints.get(joint).map_or("", |own| own.name.as_str()),
    };
    let numbered = |number: usize| format!("{name}{number}_{unit}");
    let from_0 = has(rows, &numbered(0));
    let own = |joint: usize| Some(numbered(joint + usize::from(!from_0)));
    let foreign = |joint: usize| mapped?.of(joint, joint_name(joint));
    let any = |name: &dyn Fn(usize) -> Option<String>| {
        let mut names = (0..=joints).filter_map(name);
        names.any(|name| has(rows, &name))
    };
    let required = mapped.filter(|_| required);
    let is_own = !any(&foreign) && any(&own) && required.is_none();
    let chosen: &dyn Fn(usize) -> Option<String> = match (is_own, any(&foreign)) {
        (true, _) => &own,
        (false, true) => &foreign,
        (false, false) => {
            let others = mapped.filter(|_| in_log.is_none());
            let others = others.map(|mapped| joints_of_log(rows, mapped));
            if let Some(others) = others.filter(|others| !others.is_empty()) {
                let ours: Vec<&str> = (0..joints).map(joint_name).collect();
                let (others, ours) = (others.join(", "), ours.join(", "));
                return Err(rows.header_error(format!(
                    "the log has joints {others}, the robot {ours}: name the columns by --columns-from FILE"
                )));
            }
            let Some(required) = required else {
                return Ok(None);
            };
            let problem = match (required.unknown_mark(), foreign(0)) {
                (Some(mark), _) => format!("{mark} is none of {{}}, {{0}}, {{1}} and {{name}}"),
                (None, Some(first)) => return required_column(rows, &first).map(|_| None),
                (None, None) => format!("{name} has one column for all joints: write {{}}"),
            };
            return Err(rows.header_error(format!("{name}_{unit}: {problem}")));
        }
    };
    let last = numbered(joints);
    if is_own && from_0 && has(rows, &last) {
        let (first, count) = (numbered(0), joints + 1);
        let problem = format!(
            "columns {first} to {last} are of {count} joints: the robot has {joints}; name its own by --columns-from FILE"
        );
        return Err(rows.header_error(problem));
    }
    // A seventh joint in the log of an arm with six is a log of another robot.
    if let Some(next) =
        chosen(joints).filter(|_| mapped.is_none_or(|map| map.around_name().is_none()))
    {
        rows.refuse(&next, joints)?;
    }
    let mut columns = PerJoint::repeat(joints, 0);
    for (joint, column) in columns.iter_mut().enumerate() {
        let Some(name) = chosen(joint) else {
            let problem = format!("{name}: {joint} names of columns for {joints} joints");
            return Err(rows.header_error(problem));
        };
        *column = match required {
            Some(_) => required_column(rows, &name)?,
            None => rows.require(&name)?,
        };
    }
    for (joint, column) in columns.iter().enumerate() {
        if let Some(before) = columns.iter().take(joint).position(|other| other == column) {
            let header = &rows.header[*column];
            let (one, other) = (before + 1, joint + 1);
            let problem = format!(
                "column {header} is {name} of joints {one} and {other}: one column a joint"
            );
            return Err(rows.header_error(problem));
        }
    }
    Ok(Some((columns, is_own)))
}

/// The error of a log without times.
pub(super) fn no_times(rows: &Rows, name: Option<&str>) -> TableError {
    let name = name.unwrap_or("t_s");
    rows.header_error(format!(
        "column {name} is missing: name it by t_s, or give the rows a second by rate_hz, in --columns-from FILE"
    ))
}

/// The error of a log without known columns: its header, and the lines of a map with what can be guessed.
pub(super) fn no_columns(rows: &Rows, robot: &Robot) -> TableError {
    const SHOWN: usize = 40;
    let header = &rows.header;
    let joints = robot.joint_count();
    let mut families: Vec<String> = Vec::new();
    for name in header {
        let joint_name = |joint: usize| robot.joints[joint].name.as_str();
        for (first, mark) in [("0", "{0}"), ("1", "{1}"), (joint_name(0), "{name}")] {
            for (at, _) in name.match_indices(first) {
                let pattern = format!("{}{mark}{}", &name[..at], &name[at + first.len()..]);
                let names = ColumnNames::Pattern(pattern.clone());
                let column = |joint| names.of(joint, joint_name(joint)).unwrap_or_default();
                if (0..joints).all(|joint| header.contains(&column(joint))) {
                    families.push(pattern);
                }
            }
        }
    }
    let guess = |words: &[&str], but: &[&str]| {
        let fits = |family: &&String| {
            let name = family.to_lowercase();
            words.iter().any(|word| name.contains(word))
                && !but.iter().any(|word| name.contains(word))
        };
        families.iter().find(fits).map_or("…", String::as_str)
    };
    let time = |name: &&String| {
        let name = name.to_lowercase();
        name == "t" || name.starts_with("t_") || name.contains("time") || name.contains("stamp")
    };
    let time = match header.iter().find(time) {
        Some(name) => format!("t_s = \"{name}\""),
        None => "rate_hz = …  # rows a second".to_owned(),
    };
    let asked = ["des", "target", "cmd", "ref", "con"];
    let torques = ["tau", "torq", "eff", "moment", "_nm"];
    let others = ["qd", "dq", "rad_s", "vel", "speed", "acc", "iq", "cur"];
    let q = guess(
        &["q", "pos", "ang", "_rad"],
        &[&asked[..], &torques, &others].concat(),
    );
    let tau = guess(&torques, &asked);
    let all = header[..header.len().min(SHOWN)].join(", ");
    let more = if header.len() > SHOWN { ", …" } else { "" };
    // Positions and torques need as many.
    let title = match header.len() < 2 * joints {
        true => " (a title above the header must begin with #)",
        false => "",
    };
    let problem = format!(
        "no columns for time, positions and torques (t_s, q1_rad…, tau1_nm…) and none of a known source{title}\n  header: {all}{more}\n  write these lines into a file, mend them, and add --columns-from FILE (or {}):\n\
         {time}\nq_rad = \"{q}\"\ntau_nm = \"{tau}\"",
        LOG_SOURCES.join(", ")
    );
    rows.header_error(problem)
}

#[cfg(test)]
mod tests {
    use super::super::log_tests::{own, read, read_text, table, ur5};
    use super::*;

    #[test]
    fn joints_are_found_under_another_prefix() {
        assert_eq!(cores(&["fer_joint1", "fer_joint2"]), ["1", "2"]);
        assert_eq!(cores(&["a_joint", "wrist_joint"]), ["a", "wrist"]);
        assert_eq!(cores(&["aa", "aaa"]), ["", "a"]);
        let there = ["l_grip", "l_wrist_j", "l_base_j", "l_tip_j"];
        assert_eq!(
            framed(&there, &["base", "wrist"]),
            [["l_base_j", "l_wrist_j"]]
        );
        assert!(framed(&there, &["base", "elbow"]).is_empty());
        let two = ["r1", "l1", "l11", "r11", "l111"];
        let sets = [["l1", "l11"], ["l11", "l111"], ["r1", "r11"]];
        let mut found = framed(&two, &["1", "11"]);
        found.sort();
        assert_eq!(found, sets);
        // Joints of a message: the arm's, these under a prefix beside those of a gripper, and those of a gripper alone.
        let robot = ur5();
        let named = |prefix: &str| -> Vec<String> {
            let joints = robot.joints.iter();
            joints.map(|own| prefix.to_owned() + &own.name).collect()
        };
        let finger = || ["l_finger".to_owned()].into_iter();
        assert_eq!(likeness(&named(""), None, &robot), 2);
        let beside: Vec<String> = named("l_").into_iter().chain(finger()).collect();
        assert_eq!(likeness(&beside, None, &robot), 1);
        assert_eq!(likeness(&finger().collect::<Vec<_>>(), None, &robot), 0);
    }

    #[test]
    fn logs_that_do_not_fit_are_refused_by_name() {
        let own = own();
        let lines: Vec<&str> = own.split_inclusive('\n').collect();
        let named = ["{name}_rad", "{name}_rad_s", "{name}_nm"];
        let rtde = ["actual_q_{0}", "actual_qd_{0}", "actual_current_{0}"];
        let text_of = |name: &str| match name {
            "headless.csv" => lines[1..5].concat(),
            "marked.csv" => format!("# by hand\n# 2\n{}", lines[1..5].concat()),
            "late.csv" => own.replace("\n1,", "\n# mark\n1,").replace("51.5", "") + "# end\n",
            "echo.csv" => lines[1..5].iter().map(|row| format!("x,,{row}")).collect(),
            "words.csv" => table(
                ["q_effort{0}", "ang_vel{0}", "jnt_pos{0}"],
                "T",
                ",",
                [1.0; 4],
            ),
            "renamed.csv" => format!("# by hand\n\n{}", own.replace("tau", "load")),
            "twice.csv" => [&lines[..3], &lines[2..]].concat().concat(),
            "back.csv" => [&lines[..1], &lines[9..], &lines[1..9]].concat().concat(),
            "cell.csv" => own.replace(",51.5\n", ",\n"),
            "date.csv" => own.replace("\n1.5,", "\n2024-05-03T10:11:12.5,"),
            "capitals.csv" => own.to_uppercase(),
            "named.csv" => table(named, "t_s", ",", [1.0; 4]),
            "untimed.csv" => table(rtde, "stamp", ",", [1.0; 4]),
            "ragged.csv" => own.replacen('\n', ",x\n", 1),
            "seven.csv" => own.replacen("q1_rad", "q0_rad,q1_rad", 1),
            "one.csv" => lines[..2].concat(),
            "none.csv" => lines[0].to_owned(),
            "title.csv" => format!("Arm in cell 4\n{own}"),
            "huge.csv" => lines[..9].concat().replace("51.5", "1e300"),
            "foreign.csv" => own
                .replace("t_s", "clock_time")
                .replace("q", "jnt_pos")
                .replace("tau", "load_torque"),
            "other.csv" => own.replace("_rad,", "/position,").replace("_nm", "/effort"),
            "broken.db3" => "no database".to_owned(),
            "broken.mcap" => "no MCAP".to_owned(),
            _ => String::new(),
        };
        // Names, and words of the refusal.
        let cases = "\
headless.csv | headless.csv:1: no header row, 19 numbers: name the columns by --names
marked.csv | marked.csv:3: no header row, 19 numbers
late.csv | late.csv:9: column tau6_nm
echo.csv | echo.csv:1: no header row, 21 fields with numbers among them: name the columns by --names
words.csv | q_rad = \"jnt_pos{0}\"\\ntau_nm = \"q_effort{0}\"
renamed.csv | renamed.csv:3: column tau1_nm is missing
twice.csv | twice.csv:4: column t_s: 0.25 does not come after 0.25: rows that are written twice: keep one of each; coarse stamps of even rows: leave t_s out and give rate_hz
back.csv | back.csv:54: column t_s: 0 does not come after 14.75: sort the rows by time, or cut the log here
cell.csv | cell.csv:8: column tau6_nm: \"\" is not a finite number: delete such rows: up to four in a row
date.csv | is not a finite number: write seconds, with pandas
capitals.csv | t_s = \"T_S\"\\nq_rad = \"Q{1}_RAD\"\\ntau_nm = \"TAU{1}_NM\"
named.csv | t_s = \"t_s\"\\nq_rad = \"{name}_rad\"\\ntau_nm = \"{name}_nm\"
untimed.csv | column timestamp is missing: name it by t_s, or give
ragged.csv | ragged.csv:2: 19 fields where the header has 20: name every column once
seven.csv | seven.csv:1: columns q0_rad to q6_rad are of 7 joints: the robot has 6
one.csv | one.csv: 1 rows, a motion needs 3 at least
none.csv | none.csv: no rows
empty.csv | empty.csv: no rows
title.csv | none of a known source (a title above the header must begin with #)
huge.csv | huge.csv:8: column tau6_nm: 1e300 is no measurement
foreign.csv | t_s = \"clock_time\"\\nq_rad = \"jnt_pos{1}_rad\"\\ntau_nm = \"load_torque{1}_nm\"
other.csv | the log has joints q1, q2, q3, q4, q5, q6, the robot shoulder_pan,
robot.parquet | robot.parquet: .parquet is not read; convert it: python3
robot.bag | robot.bag: .bag is not read; convert it: rosbags-convert
broken.db3 | broken.db3: no ROS 2 bag: file is not a database
broken.mcap | broken.mcap: no MCAP";
        for case in cases.lines() {
            let (name, wanted) = case.split_once(" | ").expect("a name and words");
            let refused = read_text(name, &text_of(name), &ur5()).expect_err(name);
            let refused = refused.replace('\n', "\\n");
            assert!(refused.contains(wanted), "{name}: {refused}");
        }
        let refused = read(std::path::Path::new("/dev/null"), &ur5()).expect_err("no file");
        assert!(refused.contains("a pipe or device"), "{refused}");
    }
}
