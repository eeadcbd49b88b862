//! Refused files: damaged ones, and those that describe no arm.

use super::*;

#[test]
fn what_is_not_an_arm_is_refused_with_one_line() {
    // --base ; --tip ; text of the file ; its replacement ; message
    let cases = r##"
        ; ; ; ; the tree branches at link 'fore' (joints 'left_finger', 'right_finger'): choose the arm's end with --tip
        ; left ; ; ; joint 'left_finger' is prismatic: only revolute, continuous and fixed joints are supported
        ; nose ; ; ; --tip names link 'nose', which does not exist
        cellar ; hand ; ; ; --base names link 'cellar', which does not exist
        hand ; base ; ; ; link 'base' is not carried by link 'hand'
        fore ; hand ; ; ; no moving joint between base and tip
        ; hand ; "elbow" type="continuous" ; "elbow" type="floating" ; joint 'elbow' is floating: only revolute, continuous and fixed joints are supported
        ; hand ; "shoulder" type="revolute" ; "shoulder" type="planar" ; joint 'shoulder' is planar: only revolute, continuous and fixed joints are supported
        ; hand ; <dynamics ; <mimic joint="shoulder"/><dynamics ; joint 'elbow' mimics another joint: an arm's joints move on their own
        ; hand ; <axis xyz="0 1 0"/> ; <axis xyz="0 0 0"/> ; joint 'shoulder' has an axis of length zero
        ; hand ; <mass value="2"/> ; <mass value="0"/> ; link 'upper': mass is 0, must be positive
        ; hand ; <mass value="2"/> ; ; line 8: <inertial> has no <mass>
        ; hand ; <mass value="2"/> ; <mass value="2 kg"/> ; line 8: <mass> value="2 kg" is not a number
        ; hand ; iyy="0.03" ; ; line 9: <inertia> has no attribute 'iyy'
        ; hand ; iyy="0.03" ; iyy="0.3" ; link 'upper': inertia breaks the triangle inequality: no body has these principal moments
        ; hand ; ixx="0.01" ixy="0" ; ixx="0.01" ixy="0.02" ; link 'upper': inertia is not positive definite
        ; hand ; xyz="0 0 0.5" ; xyz="0 0.5" ; line 6: <origin> xyz="0 0.5" is not three numbers
        ; hand ; lower="-2" upper="2" ; ; joint 'shoulder' needs a lower limit below its upper limit
        ; hand ; effort="40" ; ; joint 'shoulder' has no effort limit
        ; hand ; velocity="3" ; velocity="0" ; joint 'shoulder' has the velocity limit 0, must be positive
        ; hand ; <child link="upper"/> ; <child link="uper"/> ; joint 'shoulder' names link 'uper', which does not exist
        ; hand ; <child link="camera"/> ; <child link="fore"/> ; link 'fore' closes a loop or has two parents, only a tree is an arm
        ; hand ; <parent link="base"/> ; <parent link="fore"/> ; link 'upper' closes a loop or has two parents, only a tree is an arm
        ; hand ; <link name="camera"> ; <link name="upper"> ; the name 'upper' is used twice
        ; hand ; <link name="base"/> ; <link name="base"/><link name="loose"/> ; links 'world', 'loose' have no parent: choose one with --base
        ; ; <robot name="Two-Link"> ; <robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/> ; contains xacro macros: expand them first (xacro FILE)"##;
    for case in cases.trim_start_matches('\n').lines() {
        let [base, tip, good, bad, message] =
            case.split(';').map(str::trim).collect::<Vec<_>>()[..]
        else {
            panic!("five columns: {case}");
        };
        assert!(ARM.contains(good), "{good}");
        let option = |name| Some(name).filter(|name: &&str| !name.is_empty());
        let (base, tip) = (option(base), option(tip));
        let error = parse("t", &ARM.replacen(good, bad, 1), &Selection { base, tip });
        assert_eq!(error.unwrap_err().to_string(), format!("t: {message}"));
    }
    let error = parse("t", "<sdf/>", &Selection::default()).unwrap_err();
    assert_eq!(error.to_string(), "t: not a URDF: <sdf> instead of <robot>");
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
