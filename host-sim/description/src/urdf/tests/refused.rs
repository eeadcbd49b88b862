//! Files that are refused, or mended on demand.

use super::mjcf::MJCF;
use super::*;

#[test]
fn what_is_not_an_arm_is_refused_with_one_line() {
    // --base ; --tip ; text of the file ; its replacement ; message
    let cases = r##"
        ; left ; ; ; joint 'left_finger' is prismatic: only revolute, continuous and fixed joints are supported (--tip 'hand' ends before it)
        ; nose ; ; ; --tip names 'nose', which is neither a link nor a joint
        ; Elbw ; ; ; --tip names 'Elbw', which is neither a link nor a joint (did you mean 'elbow'?)
        cellar ; hand ; ; ; --base names 'cellar', which is neither a link nor a joint
        hand ; base ; ; ; link 'base' is not carried by link 'hand'
        fore ; hand ; ; ; no moving joint between base and tip
        ; hand ; "elbow" type="continuous" ; "elbow" type="floating" ; joint 'elbow' is floating: only revolute, continuous and fixed joints are supported (--tip 'upper' ends before it)
        ; hand ; "shoulder" type="revolute" ; "shoulder" type="planar" ; joint 'shoulder' is planar: only revolute, continuous and fixed joints are supported (--base 'upper' begins behind it)
        ; hand ; <dynamics ; <mimic joint="shoulder"/><dynamics ; joint 'elbow' mimics another joint: an arm's joints move on their own (--tip 'upper' ends before it)
        ; hand ; <axis xyz="0 1 0"/> ; <axis xyz="0 0 0"/> ; joint 'shoulder' has an axis of length zero (--base 'upper' begins behind it)
        ; hand ; <mass value="2"/> ; <mass value="0"/> ; link 'upper': mass is 0, must be positive (--repair leaves it out)
        ; hand ; <mass value="2"/> ; ; line 8: <inertial> has no <mass>
        ; hand ; <mass value="2"/> ; <mass value="2 kg"/> ; line 8: <mass> value="2 kg" is not a number
        ; hand ; iyy="0.03" ; ; line 9: <inertia> has no attribute 'iyy'
        ; hand ; iyy="0.03" ; iyy="0.3" ; link 'upper': inertia breaks the triangle inequality: no body has these principal moments (--repair takes the nearest of a body)
        ; hand ; ixx="0.01" ixy="0" ; ixx="0.01" ixy="0.02" ; link 'upper': inertia is not positive definite (--repair takes the nearest of a body)
        ; hand ; xyz="0 0 0.5" ; xyz="0 0.5" ; line 6: <origin> xyz="0 0.5" is not three numbers
        ; hand ; lower="-2" upper="2" ; lower="2" upper="2" ; joint 'shoulder' needs a lower limit below its upper limit (or none: ±π rad is taken)
        ; hand ; <parent link="base"/> ; <parent link="bass"/> ; joint 'shoulder' names 'bass', which is neither a link nor a joint (--base 'upper' begins the arm behind it)
        ; hand ; <child link="upper"/> ; <child link="uper"/> ; joint 'shoulder' names 'uper', which is neither a link nor a joint
        ; hand ; <child link="camera"/> ; <child link="fore"/> ; link 'fore' closes a loop or has two parents, only a tree is an arm
        ; hand ; <parent link="base"/> ; <parent link="fore"/> ; link 'upper' closes a loop or has two parents, only a tree is an arm
        ; hand ; <link name="camera"> ; <link name="upper"> ; the name 'upper' is used twice
        ; hand ; <link name="base"/> ; <link name="base"/><link name="loose"/> ; links 'world', 'loose' have no parent: choose one with --base
        ; ; <robot name="Two-Link"> ; <robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/> ; contains xacro macros: expand the file first (xacro FILE)
        ; hand ; xyz="0 0 0.5" ; xyz="${h} 0 0.5" ; line 6: <origin> xyz="${h} 0 0.5" is not three numbers: expand the file first (xacro FILE)
        ; hand ; rpy="1.5708 0 0" ; rpy="90 0 0" ; line 14: <origin> has more than a turn in rpy, which is in radians
        ; hand ; damping="0.5" ; damping="-0.5" ; joint 'elbow' has the viscous friction -0.5, must not be negative"##;
    for case in cases.trim_start_matches('\n').lines() {
        let [base, tip, good, bad, message] =
            case.split(';').map(str::trim).collect::<Vec<_>>()[..]
        else {
            panic!("five columns: {case}");
        };
        assert!(ARM.contains(good), "{good}");
        let option = |name| Some(name).filter(|name: &&str| !name.is_empty());
        let (base, tip) = (option(base), option(tip));
        let selection = Selection {
            base,
            tip,
            ..Selection::default()
        };
        let error = refusal(&ARM.replacen(good, bad, 1), &selection);
        assert_eq!(error, format!("t: {message}"));
    }
    let to = |tip| Selection {
        tip: Some(tip),
        ..Selection::default()
    };
    let error = refusal("<sdf/>", &to("fore"));
    let message = "t: not a URDF or MJCF: <sdf> instead of <robot> or <mujoco>";
    assert_eq!(error, message);
    assert!(refusal("<robot", &to("fore")).starts_with("t: not a URDF or MJCF: "));
    let fore = r#"<link name="fore"/>"#;
    let weightless = with(fore, r#"<link name="fore">"#, r#"<joint name="wrist""#);
    let message = "t: link 'fore' is moved by joint 'elbow' but has no inertial data: give such links a mass with --link-mass";
    assert_eq!(refusal(&weightless, &to("fore")), message);
    // Between two joints that no arm can have.
    let revolute = r#""shoulder" type="revolute""#;
    let planar = ARM.replacen(revolute, r#""shoulder" type="planar""#, 1);
    let error = refusal(&planar, &to("left"));
    let message = " (--base 'upper' --tip 'hand' leave it out)";
    assert!(error.ends_with(message), "{error}");
}

#[test]
fn too_many_joints_are_cut_at_either_end_and_a_lift_below_them_first() {
    let chain = |first: &str| {
        let joint = |k: usize| {
            let (kind, next) = (if k == 0 { first } else { "continuous" }, k + 1);
            format!(
                r#"<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{next}"/></joint>
                <link name="l{next}"><inertial><mass value="1"/>
                <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>"#
            )
        };
        let joints: String = (0..10).map(joint).collect();
        format!("<robot name=\"chain\"><link name=\"l0\"/>{joints}</robot>")
    };
    let long = chain("continuous");
    let ends = "t: 10 moving joints, an arm has at most 8: choose its ends, such as --base 'l2' or --tip 'l8'";
    assert_eq!(refusal(&long, &Selection::default()), ends);
    for (base, tip) in [(Some("l2"), None), (None, Some("l8"))] {
        let selection = Selection {
            base,
            tip,
            ..Selection::default()
        };
        assert_eq!(
            parse("t", &long, &selection).unwrap().robot.joint_count(),
            8
        );
    }
    let error = refusal(&chain("prismatic"), &Selection::default());
    assert!(error.ends_with("(--base 'l1' begins behind it)"), "{error}");
}

#[test]
fn an_assumed_torque_limit_moves_friction_and_rotor() {
    let limit = |text: &str| {
        let text = text.replacen(" actuatorfrcrange=\"-40 50\"", "", 1);
        let text = text.replacen("forcerange=\"-35 35\"", "", 1);
        let import = imported(&text);
        import.robot.joints[0].limits.torque
    };
    // 9.81 (2·0.2 + 1·(0.4 + 0.1)) N·m, damping 1 at 2 rad/s, rotor 0.1 at 10 rad/s²; then 4 N·m of friction.
    let bare = limit(MJCF);
    for more in ["frictionloss=\"4\"", "armature=\"0.5\""] {
        let text = format!("name=\"shoulder\" {more}");
        let changed = MJCF.replacen("name=\"shoulder\"", &text, 1);
        assert_eq!(limit(&changed) - bare, 6.0, "{more}");
    }
}

#[test]
fn a_speed_that_friction_does_not_allow_is_no_limit() {
    // 20 N·m, 3 rad/s; 10 N·m·s/rad of damping take three quarters of the torque at 1.475 rad/s, after 0.25 N·m.
    let sticky = ARM.replacen("damping=\"0.5\"", "damping=\"10\"", 1);
    let import = parse("t", &sticky, &TO_HAND).unwrap();
    assert!((import.robot.joints[1].limits.velocity - 1.475).abs() < 1e-12);
    let note = "joint 'elbow': friction takes 75 % of the torque limit";
    assert!(import.begins(note), "{:?}", import.notes);
    let free = parse("t", ARM, &TO_HAND).unwrap();
    assert_eq!(free.robot.joints[1].limits.velocity, 3.0);
    assert!(!free.begins(note), "{:?}", free.notes);
}

#[test]
fn inertia_without_mass_is_left_out_on_demand() {
    let massless = ARM.replacen("<mass value=\"0.5\"/>", "<mass value=\"0\"/>", 1);
    let error = refusal(&massless, &TO_HAND);
    assert!(error.ends_with("(--repair leaves it out)"), "{error}");
    let repaired = Selection {
        repair: true,
        ..TO_HAND
    };
    let import = parse("t", &massless, &repaired).unwrap();
    assert_eq!(import.robot.joints[1].link.mass, 1.0);
    assert!(import.has("link 'hand': inertia without mass is left out"));
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
