use super::*;
use crate::dynamics::{Joints, ReferenceModel, State};
use crate::robot::Placement;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::FRAC_PI_2;

/// A shoulder and an elbow about y, a hand with two fingers bolted to the forearm, and a camera on the upper arm.
const ARM: &str = r#"<robot name="Two-Link">
  <link name="world"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0 0 1"/></joint>
  <link name="base"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.5"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="40"/>
  </joint>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
  <joint name="camera_mount" type="fixed"><parent link="upper"/><child link="camera"/><origin xyz="0 0 0.1"/></joint>
  <link name="camera"><inertial><mass value="1"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.4 0 0" rpy="1.5708 0 0"/><axis xyz="0 0 1"/><limit velocity="3" effort="20"/>
    <dynamics damping="0.5" friction="0.25"/>
  </joint>
  <link name="fore"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0.3 0 0"/></joint>
  <link name="hand"><inertial><mass value="0.5"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="left_finger" type="prismatic"><parent link="hand"/><child link="left"/></joint>
  <link name="left"/>
  <joint name="right_finger" type="prismatic"><parent link="hand"/><child link="right"/>
    <mimic joint="left_finger"/></joint>
  <link name="right"/>
</robot>"#;

const TO_HAND: Selection<'static> = Selection {
    base: None,
    tip: Some("hand"),
    weld: false,
    repair: false,
    link_mass: None,
};

fn gravity_torques(robot: &Robot) -> Joints<2> {
    let model = ReferenceModel::<2>::new(robot).unwrap();
    model.gravity_torques(&Joints::zeros())
}

#[test]
fn bolted_links_become_part_of_the_link_that_moves_them() {
    let import = parse("t", ARM, &TO_HAND).unwrap();
    let robot = &import.robot;
    assert_eq!(robot.name, "two_link");
    let upper = &robot.joints[0].link;
    assert_eq!(upper.mass, 3.0);
    // About y only the two masses 2/3 kg·(0.2² + 0.1²) m² apart and their own tensors count; y is the joint's z.
    let expected = 0.03 + 0.001 + 2.0 / 3.0 * (0.2 * 0.2 + 0.1 * 0.1);
    assert!(
        (upper.inertia_com.m33 - expected).abs() < 1e-15,
        "{upper:?}"
    );
    assert_eq!(robot.joints[1].link.mass, 1.5);
    // Held out level: 9.81 (2·0.2 + 1·0.5 + 0.5·0.7) about the shoulder, 9.81 (1·0.1 + 0.5·0.3) about the elbow. The
    // shoulder turns about +y, which lowers the arm; the elbow about −y once its frame is rolled by 90°.
    let tau = gravity_torques(robot);
    let expected = Joints::<2>::new(-9.81 * 1.25, 9.81 * 0.25);
    assert!((tau - expected).amax() < 1e-12, "{tau}");
}

#[test]
fn axes_other_than_z_are_turned_onto_z_without_moving_the_zero() {
    // A door whose hinge points along each axis in turn must have M and G of a body turning about that axis.
    for axis in [
        Vector3::x(),
        -Vector3::x(),
        Vector3::y(),
        -Vector3::y(),
        Vector3::z(),
        -Vector3::z(),
        Vector3::new(1.0, -2.0, 0.5),
    ] {
        let text = format!(
            r#"<robot name="door"><link name="wall"/>
            <joint name="hinge" type="revolute"><parent link="wall"/><child link="leaf"/>
              <axis xyz="{} {} {}"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
            <link name="leaf"><inertial><origin xyz="0.3 0.2 -0.1"/><mass value="2"/>
              <inertia ixx="0.1" iyy="0.12" izz="0.14" ixy="0.01" ixz="0.02" iyz="-0.03"/></inertial></link>
            </robot>"#,
            axis.x, axis.y, axis.z
        );
        let robot = parse("t", &text, &Selection::default()).unwrap().robot;
        let model = ReferenceModel::<1>::new(&robot).unwrap();
        let unit = axis.normalize();
        let (com, mass) = (Vector3::new(0.3, 0.2, -0.1), 2.0);
        let tensor = Matrix3::new(0.1, 0.01, 0.02, 0.01, 0.12, -0.03, 0.02, -0.03, 0.14);
        let inertia = unit.dot(&(tensor * unit)) + mass * unit.cross(&com).norm_squared();
        for q in [0.0, 0.7, -2.0] {
            let turn = nalgebra::Rotation3::new(unit * q);
            let lift = unit
                .cross(&(turn * com))
                .dot(&Vector3::new(0.0, 0.0, mass * 9.81));
            let state = State {
                q: Joints::<1>::new(q),
                qd: Joints::<1>::new(1.5),
                qdd: Joints::<1>::new(2.0),
            };
            let tau = model.inverse_dynamics(&state)[0];
            assert!((tau - (2.0 * inertia + lift)).abs() < 1e-12, "{axis} {q}");
        }
        let exact = robot.joints[0]
            .placement
            .rot_parent_child
            .iter()
            .all(|x| x.fract() == 0.0);
        assert_eq!(exact, axis.amax() == axis.norm(), "{axis}");
    }
}

#[test]
fn a_point_of_mass_may_be_bolted_on_but_not_be_a_link() {
    let tensor = r#"ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001""#;
    let nothing = r#"ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0""#;
    assert_eq!(ARM.matches(tensor).count(), 2);
    let points = ARM.replace(tensor, nothing);
    let bolted = parse("t", &points, &TO_HAND).unwrap().robot;
    assert_eq!(bolted.joints[1].link.mass, 1.5);
    let only_a_point = points.replacen(
        r#"<parent link="fore"/><child link="hand"/>"#,
        r#"<parent link="fore"/><child link="hand"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" velocity="1" effort="1"/>"#,
        1,
    );
    let only_a_point =
        only_a_point.replacen(r#""wrist" type="fixed""#, r#""wrist" type="revolute""#, 1);
    assert_eq!(
        parse("t", &only_a_point, &TO_HAND).unwrap_err().to_string(),
        "t: link 'hand': inertia is not positive definite (--repair takes the nearest of a body)"
    );
}

#[test]
fn a_tip_cuts_off_its_children_with_a_note() {
    let selection = Selection {
        base: Some("base"),
        tip: Some("fore"),
        ..Selection::default()
    };
    let import = parse("t", ARM, &selection).unwrap();
    assert_eq!(import.robot.joints[1].link.mass, 1.0);
    // The base frame is that of the base link, not of the world it stands in.
    assert_eq!(
        import.robot.joints[0].placement.origin,
        Vector3::new(0.0, 0.0, 0.5)
    );
    let left_out = "left out: link 'hand' on joint 'wrist' and all it carries".to_owned();
    assert!(import.notes.contains(&left_out), "{:?}", import.notes);
    let whole = parse("t", ARM, &TO_HAND).unwrap();
    assert_eq!(whole.robot.joints[0].placement.origin.z, 1.5);
    assert!(!whole.notes.contains(&left_out));
    for finger in ["left", "right"] {
        let note =
            format!("left out: link '{finger}' on joint '{finger}_finger' and all it carries");
        assert!(whole.notes.contains(&note), "{:?}", whole.notes);
    }
}

#[test]
fn assumptions_are_listed_in_the_notes() {
    let import = parse("t", ARM, &TO_HAND).unwrap();
    let elbow = &import.robot.joints[1];
    assert_eq!(elbow.limits.position, (-4.0 * FRAC_PI_2, 4.0 * FRAC_PI_2));
    assert_eq!(
        (elbow.friction.viscous, elbow.friction.coulomb),
        (0.5, 0.25)
    );
    assert_eq!(elbow.drive.rotor_inertia, 0.0);
    for note in [
        "joint 'elbow': angles near right angles are taken as right angles",
        "joint 'elbow' is continuous: its range is taken as ±2π rad",
        "no acceleration limit at joints 'shoulder', 'elbow': 10 rad/s² is taken",
        "drives are not described: rotor inertias 0, gains 1 N·m/A, 17-bit encoders",
    ] {
        assert!(import.notes.iter().any(|n| n == note), "{:?}", import.notes);
    }
    let flange = import.robot.flange;
    assert_eq!(flange.origin, Vector3::new(0.3, 0.0, 0.0));
}

#[test]
fn an_arm_ends_where_only_fingers_follow_and_joints_may_name_base_and_tip() {
    let whole = parse("t", ARM, &Selection::default()).unwrap();
    assert_eq!(whole.robot, parse("t", ARM, &TO_HAND).unwrap().robot);
    let end = "the arm ends at link 'hand'".to_owned();
    assert!(whole.notes.contains(&end), "{:?}", whole.notes);
    // A jaw that turns is a finger by its name; without such a name it is a joint.
    let jaw = ARM.replace(
        "\"left_finger\" type=\"prismatic\"",
        "\"jaw\" type=\"revolute\"",
    );
    let jaw = jaw.replace("<mimic joint=\"left_finger\"/>", "<mimic joint=\"jaw\"/>");
    let ends = parse("t", &jaw, &Selection::default()).unwrap();
    assert_eq!(ends.robot.joint_count(), 2);
    let by_joint = Selection {
        base: Some("elbow"),
        tip: Some("elbow"),
        ..Selection::default()
    };
    let forearm = parse("t", ARM, &by_joint).unwrap().robot;
    assert_eq!(
        (forearm.joint_count(), &*forearm.joints[0].name),
        (1, "elbow")
    );
    // Two arms: the tips to choose from, the longer first.
    let torso = ARM.replace("</robot>", r#"
        <joint name="a" type="revolute"><parent link="base"/><child link="b"/></joint><link name="b"/>
        <joint name="c" type="revolute"><parent link="b"/><child link="d"/></joint><link name="d"/>
        <joint name="e" type="revolute"><parent link="d"/><child link="f"/></joint><link name="f"/></robot>"#);
    let error = parse("t", &torso, &Selection::default())
        .unwrap_err()
        .to_string();
    let expected =
        "t: the tree branches at link 'world': choose the arm's end with --tip 'f' or --tip 'fore'";
    assert_eq!(error, expected);
}

#[test]
fn values_that_a_file_leaves_out_are_assumed_with_a_note() {
    let bare = ARM
        .replace(" effort=\"40\"", "")
        .replacen("velocity=\"3\"", "velocity=\"0\"", 1);
    let import = parse("t", &bare, &Selection::default()).unwrap();
    let shoulder = import.robot.joints[0].limits;
    // 1.5 of 9.81 (3·0.137 + 1.5·(0.4 + 0.167)) N·m, and 1 N·m.
    assert_eq!((shoulder.velocity, shoulder.torque), (2.0, 20.0));
    for note in [
        "joint 'shoulder': no velocity limit, 2 rad/s",
        "joint 'shoulder': no torque limit, 20 N·m",
    ] {
        assert!(
            import.notes.iter().any(|found| found.starts_with(note)),
            "{:?}",
            import.notes
        );
    }
    let broken = ARM.replace("iyy=\"0.03\"", "iyy=\"0.3\"");
    let repair = Selection {
        repair: true,
        ..Selection::default()
    };
    let repaired = parse("t", &broken, &repair).unwrap();
    assert!(
        repaired
            .notes
            .iter()
            .any(|note| note.starts_with("link 'upper': inertia moved"))
    );
    let moments = repaired.robot.joints[0]
        .link
        .second_moments()
        .symmetric_eigenvalues();
    assert!(moments.min() > 0.0);
    assert_eq!(
        parse("t", ARM, &repair).unwrap().robot,
        parse("t", ARM, &TO_HAND).unwrap().robot
    );
    let weld = Selection {
        weld: true,
        ..Selection::default()
    };
    let finger = r#"<link name="left"><inertial><mass value="0.1"/>
        <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>"#;
    let fingers = ARM.replace("<link name=\"left\"/>", finger);
    let welded = parse("t", &fingers, &weld).unwrap();
    assert!((welded.robot.joints[1].link.mass - 1.6).abs() < 1e-12);
    let start = ARM.find(r#"<link name="upper">"#).unwrap();
    let end = ARM.find(r#"<joint name="camera_mount""#).unwrap();
    let hollow = format!("{}<link name=\"upper\"/>{}", &ARM[..start], &ARM[end..]);
    let hollow = hollow.replacen(
        "<inertial><mass value=\"1\"/>",
        "<collision/><inertial><mass value=\"0\"/>",
        1,
    );
    let hollow = hollow.replacen(
        "<inertia ixx=\"0.001\" ixy=\"0\" ixz=\"0\" iyy=\"0.001\" iyz=\"0\" izz=\"0.001\"/>",
        "<inertia ixx=\"0\" ixy=\"0\" ixz=\"0\" iyy=\"0\" iyz=\"0\" izz=\"0\"/>",
        1,
    );
    assert!(
        parse("t", &hollow, &Selection::default())
            .unwrap_err()
            .to_string()
            .ends_with("--link-mass")
    );
    let rods = Selection {
        link_mass: Some(2.0),
        ..Selection::default()
    };
    assert_eq!(
        parse("t", &hollow, &rods).unwrap().robot.joints[0]
            .link
            .mass,
        2.0
    );
}

#[test]
fn panda_reaches_as_its_manufacturer_states() {
    // All joints at zero: x = a7, z = d1 + d3 + d5 − flange (table of the manufacturer).
    let robot = Robot::load("panda").unwrap();
    let joints = robot.joints.iter();
    let flange = joints.fold(Placement::identity(), |frame, joint| {
        frame.then(&joint.placement)
    });
    let flange = flange.then(&robot.flange);
    let expected = Vector3::new(0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107);
    assert!((flange.origin - expected).norm() < 1e-15, "{flange:?}");
    let mut entries = robot
        .joints
        .iter()
        .flat_map(|joint| joint.placement.rot_parent_child.iter());
    assert!(
        entries.all(|entry| entry.fract() == 0.0),
        "a right angle is not exact"
    );
}

#[test]
fn what_is_not_an_arm_is_refused_with_one_line() {
    // --base ; --tip ; text of the file ; its replacement ; message
    let cases = r##"
        ; left ; ; ; joint 'left_finger' is prismatic: only revolute, continuous and fixed joints are supported (--tip 'hand' ends before it)
        ; nose ; ; ; --tip names 'nose', which is neither a link nor a joint
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
        let error = parse(
            "t",
            &ARM.replacen(good, bad, 1),
            &Selection {
                base,
                tip,
                ..Selection::default()
            },
        );
        assert_eq!(error.unwrap_err().to_string(), format!("t: {message}"));
    }
    let error = parse("t", "<sdf/>", &Selection::default()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "t: not a URDF or MJCF: <sdf> instead of <robot> or <mujoco>"
    );
    let start = ARM.find(r#"<link name="fore">"#).unwrap();
    let end = ARM.find(r#"<joint name="wrist""#).unwrap();
    let weightless = format!("{}<link name=\"fore\"/>{}", &ARM[..start], &ARM[end..]);
    let selection = Selection {
        tip: Some("fore"),
        ..Selection::default()
    };
    assert_eq!(
        parse("t", &weightless, &selection).unwrap_err().to_string(),
        "t: link 'fore' is moved by joint 'elbow' but has no inertial data: give such links a mass with --link-mass"
    );
    // Between two joints that no arm can have.
    let planar = ARM.replacen(
        "\"shoulder\" type=\"revolute\"",
        "\"shoulder\" type=\"planar\"",
        1,
    );
    let to_finger = Selection {
        tip: Some("left"),
        ..Selection::default()
    };
    let error = parse("t", &planar, &to_finger).unwrap_err().to_string();
    assert!(
        error.ends_with(" (--base 'upper' --tip 'hand' leave it out)"),
        "{error}"
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
            .starts_with("t: not a URDF or MJCF: ")
    );
}

#[test]
fn an_assumed_torque_limit_moves_friction_and_rotor() {
    let limit = |text: &str| {
        let text = text.replacen(" actuatorfrcrange=\"-40 50\"", "", 1);
        let text = text.replacen("forcerange=\"-35 35\"", "", 1);
        let import = parse("t", &text, &Selection::default()).unwrap();
        import.robot.joints[0].limits.torque
    };
    // 9.81 (2·0.2 + 1·(0.4 + 0.1)) N·m, damping 1 at 2 rad/s, rotor 0.1 at 10 rad/s²; then 4 N·m of friction.
    let bare = limit(MJCF);
    let sticky = MJCF.replacen(
        "name=\"shoulder\"",
        "name=\"shoulder\" frictionloss=\"4\"",
        1,
    );
    assert_eq!(limit(&sticky) - bare, 6.0);
    let heavy = MJCF.replacen("name=\"shoulder\"", "name=\"shoulder\" armature=\"0.5\"", 1);
    assert_eq!(limit(&heavy) - bare, 6.0);
}

#[test]
fn a_speed_that_friction_does_not_allow_is_no_limit() {
    // 20 N·m, 3 rad/s; 10 N·m·s/rad of damping take three quarters of the torque at 1.475 rad/s, after 0.25 N·m.
    let sticky = ARM.replacen("damping=\"0.5\"", "damping=\"10\"", 1);
    let import = parse("t", &sticky, &TO_HAND).unwrap();
    assert!((import.robot.joints[1].limits.velocity - 1.475).abs() < 1e-12);
    let named = |note: &String| note.contains("'elbow': friction takes 75 % of the torque limit");
    assert!(import.notes.iter().any(named), "{:?}", import.notes);
    let free = parse("t", ARM, &TO_HAND).unwrap();
    assert_eq!(free.robot.joints[1].limits.velocity, 3.0);
    assert!(!free.notes.iter().any(named), "{:?}", free.notes);
}

#[test]
fn inertia_without_mass_is_left_out_on_demand() {
    let massless = ARM.replacen("<mass value=\"0.5\"/>", "<mass value=\"0\"/>", 1);
    let error = parse("t", &massless, &TO_HAND).unwrap_err().to_string();
    assert!(error.ends_with("(--repair leaves it out)"), "{error}");
    let repaired = Selection {
        repair: true,
        ..TO_HAND
    };
    let import = parse("t", &massless, &repaired).unwrap();
    assert_eq!(import.robot.joints[1].link.mass, 1.0);
    let note = "link 'hand': inertia without mass is left out";
    assert!(import.notes.iter().any(|n| n == note), "{:?}", import.notes);
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

/// Default classes, degrees, a turned and shifted joint, an actuator's limit, a gripper whose fingers are coupled.
const MJCF: &str = r#"<!DOCTYPE mujoco><mujoco model="Two">
  <compiler angle="degree" eulerseq="XYZ"/>
  <option gravity="0 0 -9.8"/>
  <default><joint armature="0.1" damping="1"/>
    <default class="arm"><joint axis="0 1 0" range="-90 90"/><motor ctrlrange="-30 30"/>
      <default class="small"><joint armature="0.02" frictionloss="0.3"/></default></default></default>
  <worldbody><body name="stand" pos="0 0 1" childclass="arm">
    <body name="upper" pos="0 0 0.5"><inertial pos="0.2 0 0" mass="2" diaginertia="0.01 0.03 0.03"/>
      <joint name="shoulder" actuatorfrcrange="-40 50"/>
      <frame pos="0.3 0 0"><body name="fore" euler="90 0 0">
        <inertial pos="0.2 0 0" mass="1" fullinertia="0.01 0.02 0.02 0 0 0"/>
        <joint name="elbow" class="small" axis="0 0 1" pos="0.1 0 0" ref="10"/>
        <body name="left"><joint name="slide" type="slide"/><inertial pos="0 0 0" mass="0.1" diaginertia="1 1 1"/></body>
        <body name="right"><joint name="turn"/><inertial pos="0 0 0" mass="0.1" diaginertia="1 1 1"/></body>
      </body></frame></body></body></worldbody>
  <actuator><motor joint="elbow" class="arm" gear="0.5"/><position joint="shoulder" forcerange="-35 35"/></actuator>
  <equality><joint joint1="turn" joint2="slide"/></equality></mujoco>"#;

#[test]
fn an_mjcf_is_read_with_its_classes_units_and_anchors() {
    let import = parse("t", MJCF, &Selection::default()).unwrap();
    let [shoulder, elbow] = &import.robot.joints[..] else {
        panic!("{:?}", import.notes);
    };
    assert_eq!(import.robot.gravity.z, -9.8);
    assert_eq!((&*shoulder.name, &*elbow.name), ("shoulder", "elbow"));
    assert_eq!(shoulder.limits.position, (-FRAC_PI_2, FRAC_PI_2));
    assert_eq!(
        (shoulder.drive.rotor_inertia, elbow.drive.rotor_inertia),
        (0.1, 0.02)
    );
    assert_eq!((elbow.friction.viscous, elbow.friction.coulomb), (1.0, 0.3));
    assert_eq!((shoulder.limits.torque, elbow.limits.torque), (35.0, 15.0));
    // The elbow turns about z of the forearm, y of the upper arm, at (0.3 + 0.1, 0, 0); at q = 10° the forearm is as drawn.
    let q = Joints::<2>::new(0.0, 10.0_f64.to_radians());
    let lever_elbow = 0.1;
    let gravity = ReferenceModel::<2>::new(&import.robot)
        .unwrap()
        .gravity_torques(&q);
    let expected = -9.8 * (2.0 * 0.2 + 0.5);
    assert!((gravity[0] - expected).abs() < 1e-12, "{gravity}");
    assert!(
        (gravity[1].abs() - 9.8 * lever_elbow).abs() < 1e-12,
        "{gravity}"
    );
    assert!(
        import
            .notes
            .iter()
            .any(|note| note.contains("ends at link 'fore'")),
        "{:?}",
        import.notes
    );
}

#[test]
fn an_mjcf_without_a_unit_of_angles_has_that_of_its_ranges() {
    let read = |text: &str| parse("t", text, &Selection::default()).unwrap();
    let noted = |import: &Import| import.notes.iter().any(|note| note.contains("as radians"));
    let bare = MJCF.replace("angle=\"degree\" ", "");
    // ±90 are degrees, ±1.5 of a part of a file are not, unless it says so.
    let degrees = read(&bare);
    let position = |import: &Import| import.robot.joints[0].limits.position;
    assert_eq!(position(&degrees), (-FRAC_PI_2, FRAC_PI_2));
    let radians = read(&bare.replace("-90 90", "-1.5 1.5"));
    assert_eq!(position(&radians), (-1.5, 1.5));
    assert_eq!([noted(&degrees), noted(&radians)], [false, true]);
    let named = read(&MJCF.replace("-90 90", "-1.5 1.5"));
    assert_eq!(
        position(&named),
        (-1.5_f64.to_radians(), 1.5_f64.to_radians())
    );
    assert!(!noted(&named));
}

#[test]
fn parts_of_an_mjcf_that_change_the_dynamics_are_refused_by_name() {
    for (good, bad, named) in [
        (
            "<worldbody>",
            "<worldbody><replicate count=\"2\"/>",
            "line 7: <replicate> cannot be read",
        ),
        (
            "eulerseq",
            "inertiafromgeom=\"true\" eulerseq",
            "inertiafromgeom=\"true\" cannot be read",
        ),
        ("ref=\"10\"", "axis=\"0 0\"", "axis"),
        ("mass=\"2\"", "mass=\"two\"", "mass=\"two\" is not a number"),
        ("euler=\"90 0 0\"", "euler=\"90 0\"", "'euler'"),
        (
            "<worldbody>",
            "<include file=\"no.xml\"/><worldbody>",
            "file=\"no.xml\"",
        ),
        (
            "name=\"turn\"",
            "name=\"slide\"",
            "the name 'slide' is used twice",
        ),
    ] {
        assert!(MJCF.contains(good), "{good}");
        let error = parse("t", &MJCF.replacen(good, bad, 1), &Selection::default()).unwrap_err();
        assert!(error.to_string().contains(named), "{error}");
        assert_eq!(error.to_string().lines().count(), 1);
    }
}

#[test]
fn a_chain_of_fingers_is_no_arm_and_a_palm_is_a_wrist() {
    let hand = ARM
        .replace(
            r#""left_finger" type="prismatic""#,
            r#""left_finger" type="revolute""#,
        )
        .replace(
            r#"<link name="left"/>"#,
            r#"<link name="left"/><joint name="left_finger_tip" type="revolute">
          <parent link="left"/><child link="left_tip"/></joint><link name="left_tip"/>"#,
        );
    assert_eq!(
        parse("t", &hand, &Selection::default())
            .unwrap()
            .robot
            .joints
            .len(),
        2
    );
    // A wrist that carries a jaw.
    let wrist = ARM.replace(r#""wrist" type="fixed""#, r#""wrist" type="continuous""#);
    let wrist = wrist.replace("\"hand\"", "\"gripper\"").replace(
        r#""left_finger" type="prismatic""#,
        r#""jaw" type="revolute""#,
    );
    let start = wrist.find(r#"<joint name="right_finger""#).unwrap();
    let end = wrist.find("<link name=\"right\"/>").unwrap();
    let wrist = format!("{}{}", &wrist[..start], &wrist[end + 21..]);
    let robot = parse("t", &wrist, &Selection::default()).unwrap().robot;
    assert_eq!((robot.joints.len(), &*robot.joints[2].name), (3, "wrist"));
    let palm = ARM.replace(r#""wrist" type="fixed""#, r#""wrist" type="continuous""#);
    let palm = palm.replace("hand", "gripper");
    let robot = parse("t", &palm, &Selection::default()).unwrap().robot;
    assert_eq!(robot.joints[2].name, "wrist");
    let loose = ARM.replace("<robot ", "<!DOCTYPE robot><robot foo:bar=\"1\" ");
    assert_eq!(parse("t", &loose, &TO_HAND).unwrap().robot.joints.len(), 2);
}

#[test]
fn a_written_arm_is_the_arm_again_with_the_names_of_its_links() {
    let arm = parse("t", ARM, &TO_HAND).unwrap().robot;
    let states = crate::dynamics::random_states::<2>(20);
    let torques = |robot: &Robot| -> Vec<Joints<2>> {
        let model = ReferenceModel::<2>::new(robot).unwrap();
        states
            .iter()
            .map(|state| model.inverse_dynamics(state))
            .collect()
    };
    let mut bare = arm.clone();
    for text in [write(&arm), mjcf(&arm)] {
        let again = parse("t", &text, &Selection::default()).unwrap().robot;
        for (here, there) in torques(&arm).iter().zip(torques(&again)) {
            assert!((here - there).amax() < 1e-12, "{text}");
        }
        for link in ["upper", "fore", "hand"] {
            assert!(text.contains(&format!("name=\"{link}\"")), "{link}: {text}");
        }
        assert_eq!(again.joints[1].friction, arm.joints[1].friction);
        assert!(text.contains("\"0 1 0\""), "the axis of the file: {text}");
    }
    // An armature is where a URDF has no place for it.
    bare.joints[0].drive.rotor_inertia = 0.5;
    let again = parse("t", &mjcf(&bare), &Selection::default())
        .unwrap()
        .robot;
    assert_eq!(again.joints[0].drive.rotor_inertia, 0.5);
    assert!(sdf(&bare).contains("<drake:rotor_inertia>0.5</drake:rotor_inertia>"));
}

/// Torques of the written models by the tools that read them against ours; see `tests/data/written/README.md`.
#[test]
fn mujoco_and_pinocchio_compute_our_torques_from_the_written_models() {
    const TOLERANCE_NM: f64 = 1e-6;
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    for (name, description) in [
        ("ur5", "ur5".to_owned()),
        ("gen3", format!("{root}/host-sim/robots/gen3.toml")),
        (
            "oblique",
            format!("{root}/tests/data/pinocchio/arms/oblique.urdf"),
        ),
        ("eight", format!("{root}/host-sim/robots/eight.toml")),
    ] {
        let robot = Robot::load(&description).unwrap().with_assumed_rotors().0;
        for (ending, text) in [
            ("xml", mjcf(&robot)),
            ("urdf", write(&robot)),
            ("sdf", sdf(&robot)),
        ] {
            let file = format!("{root}/tests/data/written/{name}.{ending}");
            let written = std::fs::read_to_string(&file).unwrap();
            assert!(written == text, "{file} is stale: see the README beside it");
        }
        crate::joints!(robot.joint_count(), N => torques_agree::<N>(name, &robot, TOLERANCE_NM), else panic!("{name}"));
    }
}

fn torques_agree<const N: usize>(name: &str, robot: &Robot, tolerance_nm: f64) {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/written");
    let file = std::fs::File::open(format!("{root}/{name}.csv.gz")).unwrap();
    let mut reader = csv::Reader::from_reader(flate2::read::GzDecoder::new(file));
    let model = ReferenceModel::<N>::new(robot).unwrap();
    let mut bare = robot.clone();
    for joint in &mut bare.joints {
        joint.drive.rotor_inertia = 0.0;
    }
    let bare = ReferenceModel::<N>::new(&bare).unwrap();
    let damping = Joints::<N>::from_fn(|j, _| robot.joints[j].friction.viscous);
    let (mut rows, mut worst) = (0, [0.0_f64; 4]);
    for row in reader.deserialize() {
        let row: Vec<f64> = row.unwrap();
        let [q, qd, qdd, by_mujoco, by_mjcf, by_urdf, by_sdf] =
            std::array::from_fn(|k| Joints::<N>::from_fn(|j, _| row[k * N + j]));
        let state = State { q, qd, qdd };
        let ours = model.inverse_dynamics(&state);
        let errors = [
            ours + damping.component_mul(&qd) - by_mujoco,
            ours - by_mjcf,
            bare.inverse_dynamics(&state) - by_urdf,
            ours - by_sdf,
        ];
        for (worst, error) in worst.iter_mut().zip(errors) {
            assert!(error.amax() <= tolerance_nm, "{name}: {error}");
            *worst = worst.max(error.amax());
        }
        rows += 1;
    }
    println!("{name}: off by {worst:?} N·m (MuJoCo, Pinocchio on MJCF and URDF, Drake on SDF)");
    assert_eq!(rows, 200);
}
