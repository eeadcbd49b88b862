//! URDFs without an arm, and damaged ones.

use super::*;

#[test]
fn what_is_not_an_arm_is_refused_with_one_line() {
    let swap = |good: &str, bad: &str| {
        assert!(ARM.contains(good), "{good}");
        ARM.replacen(good, bad, 1)
    };
    let two_fingers = "t: the tree branches at link 'fore' (joints 'left_finger', 'right_finger'): choose the arm's end with --tip";
    let cases = [
        (ARM.to_owned(), None, None, two_fingers),
        (
            ARM.to_owned(),
            None,
            Some("left"),
            "t: joint 'left_finger' is prismatic: only revolute, continuous and fixed joints are supported",
        ),
        (
            ARM.to_owned(),
            None,
            Some("nose"),
            "t: --tip names link 'nose', which does not exist",
        ),
        (
            ARM.to_owned(),
            Some("cellar"),
            Some("hand"),
            "t: --base names link 'cellar', which does not exist",
        ),
        (
            ARM.to_owned(),
            Some("hand"),
            Some("base"),
            "t: link 'base' is not carried by link 'hand'",
        ),
        (
            ARM.to_owned(),
            Some("fore"),
            Some("hand"),
            "t: no moving joint between base and tip",
        ),
        (
            swap(r#""elbow" type="continuous""#, r#""elbow" type="floating""#),
            None,
            Some("hand"),
            "t: joint 'elbow' is floating: only revolute, continuous and fixed joints are supported",
        ),
        (
            swap(
                r#""shoulder" type="revolute""#,
                r#""shoulder" type="planar""#,
            ),
            None,
            Some("hand"),
            "t: joint 'shoulder' is planar: only revolute, continuous and fixed joints are supported",
        ),
        (
            swap("<dynamics", r#"<mimic joint="shoulder"/><dynamics"#),
            None,
            Some("hand"),
            "t: joint 'elbow' mimics another joint: an arm's joints move on their own",
        ),
        (
            swap(r#"<axis xyz="0 1 0"/>"#, r#"<axis xyz="0 0 0"/>"#),
            None,
            Some("hand"),
            "t: joint 'shoulder' has an axis of length zero",
        ),
        (
            swap(r#"<mass value="2"/>"#, r#"<mass value="0"/>"#),
            None,
            Some("hand"),
            "t: link 'upper': mass is 0, must be positive",
        ),
        (
            swap(r#"<mass value="2"/>"#, ""),
            None,
            Some("hand"),
            "t: line 8: <inertial> has no <mass>",
        ),
        (
            swap(r#"<mass value="2"/>"#, r#"<mass value="2 kg"/>"#),
            None,
            Some("hand"),
            "t: line 8: <mass> value=\"2 kg\" is not a number",
        ),
        (
            swap(r#"iyy="0.03" "#, ""),
            None,
            Some("hand"),
            "t: line 9: <inertia> has no attribute 'iyy'",
        ),
        (
            swap(r#"iyy="0.03""#, r#"iyy="0.3""#),
            None,
            Some("hand"),
            "t: link 'upper': inertia breaks the triangle inequality: no body has these principal moments",
        ),
        (
            swap(r#"ixx="0.01" ixy="0""#, r#"ixx="0.01" ixy="0.02""#),
            None,
            Some("hand"),
            "t: link 'upper': inertia is not positive definite",
        ),
        (
            swap(r#"xyz="0 0 0.5""#, r#"xyz="0 0.5""#),
            None,
            Some("hand"),
            "t: line 6: <origin> xyz=\"0 0.5\" is not three numbers",
        ),
        (
            swap(r#"lower="-2" upper="2""#, ""),
            None,
            Some("hand"),
            "t: joint 'shoulder' needs a lower limit below its upper limit",
        ),
        (
            swap(r#"effort="40""#, ""),
            None,
            Some("hand"),
            "t: joint 'shoulder' has no effort limit",
        ),
        (
            swap(r#"velocity="3""#, r#"velocity="0""#),
            None,
            Some("hand"),
            "t: joint 'shoulder' has the velocity limit 0, must be positive",
        ),
        (
            swap(r#"<child link="upper"/>"#, r#"<child link="uper"/>"#),
            None,
            Some("hand"),
            "t: joint 'shoulder' names link 'uper', which does not exist",
        ),
        (
            swap(r#"<child link="camera"/>"#, r#"<child link="fore"/>"#),
            None,
            Some("hand"),
            "t: link 'fore' closes a loop or has two parents, only a tree is an arm",
        ),
        (
            swap(r#"<parent link="base"/>"#, r#"<parent link="fore"/>"#),
            None,
            Some("hand"),
            "t: link 'upper' closes a loop or has two parents, only a tree is an arm",
        ),
        (
            swap(r#"<link name="camera">"#, r#"<link name="upper">"#),
            None,
            Some("hand"),
            "t: the name 'upper' is used twice",
        ),
        (
            swap(
                r#"<link name="base"/>"#,
                r#"<link name="base"/><link name="loose"/>"#,
            ),
            None,
            Some("hand"),
            "t: links 'world', 'loose' have no parent: choose one with --base",
        ),
        (
            swap(
                r#"<robot name="Two-Link">"#,
                r#"<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/>"#,
            ),
            None,
            None,
            "t: contains xacro macros: expand them first (xacro FILE)",
        ),
        (
            "<sdf/>".to_owned(),
            None,
            None,
            "t: not a URDF: <sdf> instead of <robot>",
        ),
    ];
    for (text, base, tip, message) in cases {
        let error = parse("t", &text, &Selection { base, tip }).unwrap_err();
        assert_eq!(error.to_string(), message);
    }
    let start = ARM.find(r#"<link name="fore">"#).unwrap();
    let end = ARM.find(r#"<joint name="wrist""#).unwrap();
    let weightless = format!("{}<link name=\"fore\"/>{}", &ARM[..start], &ARM[end..]);
    let selection = Selection {
        base: None,
        tip: Some("fore"),
    };
    assert_eq!(
        parse("t", &weightless, &selection).unwrap_err().to_string(),
        "t: link 'fore' is moved by joint 'elbow' but has no inertial data"
    );
    let missing = load(Path::new("/no/such.urdf"), &selection)
        .unwrap_err()
        .to_string();
    assert!(
        missing.starts_with("/no/such.urdf: cannot be read: "),
        "{missing}"
    );
    assert!(
        parse("t", "<robot", &selection)
            .unwrap_err()
            .to_string()
            .starts_with("t: not a URDF: ")
    );
}

#[test]
fn a_damaged_file_is_read_or_refused_but_never_panics() {
    for (at, letter) in ARM.char_indices() {
        let damaged = format!("{}{}", &ARM[..at], &ARM[at + letter.len_utf8()..]);
        let _ = parse("t", &damaged, &TO_HAND);
    }
    // Numbers whose squares no longer fit.
    for huge in ["1e200", "1e308", "-1e308"] {
        for name in ["value", "ixx", "xyz", "rpy", "upper"] {
            let start = format!("{name}=\"");
            for (at, _) in ARM.match_indices(&start) {
                let at = at + start.len();
                let end = at + ARM[at..].find([' ', '"']).unwrap();
                let damaged = format!("{}{huge}{}", &ARM[..at], &ARM[end..]);
                if let Ok(import) = parse("t", &damaged, &TO_HAND) {
                    let standard = import.robot.standard_parameters();
                    assert!(standard.iter().all(|x| x.is_finite()), "{damaged}");
                }
            }
        }
    }
}
