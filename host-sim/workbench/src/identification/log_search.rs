//! Search for the columns of each quantity in the header of a log.

use crate::dynamics::PerJoint;
use crate::robot::{ColumnNames, LOG_SOURCES, Robot};
use crate::table::{Rows, TableError};

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
/// and end with, else 0.
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
    let cores_there = cores(&there);
    let same = cores(&ours).iter().all(|own| cores_there.contains(own));
    usize::from(same && there.len() == ours.len())
}

/// Columns of one quantity for all joints, and whether they have the project's own names; `None` without a column of it.
///
/// * `mapped` names of the map, and whether they must be there
pub(super) fn joint_places(
    rows: &Rows,
    (name, unit): (&str, &str),
    (mapped, required): (Option<&ColumnNames>, bool),
    robot: &Robot,
) -> Result<Option<(PerJoint<usize>, bool)>, TableError> {
    let joints = robot.joint_count();
    let joint_name = |joint: usize| robot.joints.get(joint).map_or("", |own| own.name.as_str());
    let numbered = |number: usize| format!("{name}{number}_{unit}");
    let from_0 = has(rows, &numbered(0));
    let own = |joint: usize| Some(numbered(joint + usize::from(!from_0)));
    let foreign = |joint: usize| mapped?.of(joint, joint_name(joint));
    let any = |name: &dyn Fn(usize) -> Option<String>| {
        let mut names = (0..=joints).filter_map(name);
        names.any(|name| has(rows, &name))
    };
    let is_own = !any(&foreign) && any(&own) && !(required && mapped.is_some());
    let chosen: &dyn Fn(usize) -> Option<String> = match (is_own, any(&foreign)) {
        (true, _) => &own,
        (false, true) => &foreign,
        (false, false) => {
            let found = renamed(rows, mapped, robot)?;
            if let (None, true, Some(_)) = (&found, required, mapped) {
                let problem = format!("{name} has one column for all joints: write {{}}");
                let first = foreign(0).ok_or_else(|| rows.header_error(problem))?;
                rows.require(&first)?;
            }
            return Ok(found.map(|found| (found, false)));
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
        *column = rows.require(&name)?;
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

/// Places of `cores` among more names, where one beginning and one end go with all of them: a gripper has joints of its own.
fn framed(there: &[&str], cores: &[&str]) -> Option<Vec<usize>> {
    let first = cores.first().filter(|core| !core.is_empty())?;
    let within = |name: &&str| -> Vec<(String, String)> {
        let places = name.match_indices(first);
        places
            .map(|(at, _)| (name[..at].to_owned(), name[at + first.len()..].to_owned()))
            .collect()
    };
    there.iter().flat_map(within).find_map(|(head, tail)| {
        let place = |core: &&str| {
            let own = format!("{head}{core}{tail}");
            there.iter().position(|name| **name == own)
        };
        cores.iter().map(place).collect()
    })
}

/// Columns by names of joints that differ from those of the description in what all of them begin and end with.
fn renamed(
    rows: &Rows,
    mapped: Option<&ColumnNames>,
    robot: &Robot,
) -> Result<Option<PerJoint<usize>>, TableError> {
    let Some(mapped) = mapped else {
        return Ok(None);
    };
    let there = joints_of_log(rows, mapped);
    if there.is_empty() {
        return Ok(None);
    }
    let ours: Vec<&str> = robot.joints.iter().map(|own| own.name.as_str()).collect();
    let (cores_there, cores_ours) = (cores(&there), cores(&ours));
    let mut columns = PerJoint::repeat(ours.len(), 0);
    let framed = framed(&there, &cores_ours);
    for (joint, (column, core)) in columns.iter_mut().zip(&cores_ours).enumerate() {
        let place = cores_there.iter().position(|other| other == core);
        let place = place.filter(|_| there.len() == ours.len());
        let Some(place) = place.or(framed.as_ref().map(|framed| framed[joint])) else {
            let problem = format!(
                "the log has joints {}, the robot {}: name the columns by --columns-from FILE",
                there.join(", "),
                ours.join(", ")
            );
            return Err(rows.header_error(problem));
        };
        *column = rows.require(&mapped.of(0, there[place]).unwrap_or_default())?;
    }
    Ok(Some(columns))
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
    let q = guess(
        &["q", "pos", "ang", "_rad"],
        &[&asked[..], &["qd", "dq", "rad_s", "torq"]].concat(),
    );
    let tau = guess(&["tau", "torq", "eff", "moment", "_nm"], &asked);
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
        assert_eq!(framed(&there, &["base", "wrist"]), Some(vec![2, 1]));
        assert_eq!(framed(&there, &["base", "elbow"]), None);
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
