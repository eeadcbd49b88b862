//! Arms of MuJoCo.

use super::*;

/// Default classes, degrees, a turned and shifted joint, an actuator's limit, a gripper whose fingers are coupled.
pub(super) const MJCF: &str = include_str!("two.xml");

#[test]
fn an_mjcf_is_read_with_its_classes_units_and_anchors() {
    let import = imported(MJCF);
    let [shoulder, elbow] = &import.robot.joints[..] else {
        panic!("{:?}", import.notes);
    };
    assert_eq!(import.robot.gravity.z, -9.8);
    assert_eq!((&*shoulder.name, &*elbow.name), ("shoulder", "elbow"));
    assert_eq!(shoulder.limits.position, (-FRAC_PI_2, FRAC_PI_2));
    let rotors = [shoulder, elbow].map(|joint| joint.drive.rotor_inertia);
    assert_eq!(rotors, [0.1, 0.02]);
    assert_eq!((elbow.friction.viscous, elbow.friction.coulomb), (1.0, 0.3));
    assert_eq!((shoulder.limits.torque, elbow.limits.torque), (35.0, 15.0));
    // The elbow turns about z of the forearm, y of the upper arm, at (0.3 + 0.1, 0, 0); at q = 10° the forearm is as drawn.
    let q = Joints::<2>::new(0.0, 10.0_f64.to_radians());
    let lever_elbow = 0.1;
    let model = ReferenceModel::<2>::new(&import.robot).unwrap();
    let gravity = model.gravity_torques(&q);
    let expected = -9.8 * (2.0 * 0.2 + 0.5);
    assert!((gravity[0] - expected).abs() < 1e-12, "{gravity}");
    let error = gravity[1].abs() - 9.8 * lever_elbow;
    assert!(error.abs() < 1e-12, "{gravity}");
    assert!(import.begins("the arm ends at link 'fore'"));
}

#[test]
fn an_mjcf_without_a_unit_of_angles_has_that_of_its_ranges() {
    let read = imported;
    let noted = |import: &Import| import.begins("no <compiler angle>: angles are taken as radians");
    let bare = MJCF.replace("angle=\"degree\" ", "");
    // ±90 are degrees, ±1.5 of a part of a file are not, unless it says so.
    let degrees = read(&bare);
    let position = |import: &Import| import.robot.joints[0].limits.position;
    assert_eq!(position(&degrees), (-FRAC_PI_2, FRAC_PI_2));
    let radians = read(&bare.replace("-90 90", "-1.5 1.5"));
    assert_eq!(position(&radians), (-1.5, 1.5));
    assert_eq!([noted(&degrees), noted(&radians)], [false, true]);
    // A rounded turn.
    assert!(noted(&read(&bare.replace("-90 90", "-6.28319 6.28319"))));
    let named = read(&MJCF.replace("-90 90", "-1.5 1.5"));
    let end = 1.5_f64.to_radians();
    assert_eq!(position(&named), (-end, end));
    assert!(!noted(&named));
}

#[test]
fn right_angles_in_a_quaternion_of_decimals_are_right_angles() {
    // About x by a right angle, then about y by 0.5 rad: the axes are at a right angle, although no entry of the rest is 0 or 1.
    let cosine_of_axes = |quat: &str| {
        let body = "<inertial pos=\"0 0 0.1\" mass=\"1\" diaginertia=\"0.01 0.01 0.01\"/>";
        let arm = format!(
            r#"<mujoco><worldbody><body><joint range="-1 1"/>{body}
            <body quat="{quat}"><joint range="-1 1"/>{body}</body></body></worldbody></mujoco>"#
        );
        whole(&arm).joints[1].placement.rot_parent_child.m33
    };
    let rounded = cosine_of_axes("0.685124 0.685126 0.174941 -0.174941");
    assert_eq!(rounded, 0.0);
    let other = cosine_of_axes("0.685124 0.6853 0.174941 -0.174941");
    assert!(other.abs() > 1e-5, "{other}");
}

#[test]
fn parts_of_an_mjcf_that_change_the_dynamics_are_refused_by_name() {
    // Text of the file ; its replacement ; part of the message
    let cases = r#"
        <worldbody> ; <worldbody><replicate count="2"/> ; line 7: <replicate> cannot be read
        eulerseq ; inertiafromgeom="true" eulerseq ; inertiafromgeom="true" cannot be read
        ref="10" ; axis="0 0" ; axis
        mass="2" ; mass="two" ; mass="two" is not a number
        euler="90 0 0" ; euler="90 0" ; 'euler'
        <worldbody> ; <include file="no.xml"/><worldbody> ; file="no.xml"
        name="turn" ; name="slide" ; the name 'slide' is used twice"#;
    for case in cases.trim().lines() {
        let [good, bad, named] = case.split(';').map(str::trim).collect::<Vec<_>>()[..] else {
            panic!("three columns: {case}");
        };
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
    assert_eq!(whole(&hand).joints.len(), 2);
    // A wrist that carries a jaw.
    let wrist = ARM.replace(r#""wrist" type="fixed""#, r#""wrist" type="continuous""#);
    let wrist = wrist.replace("\"hand\"", "\"gripper\"").replace(
        r#""left_finger" type="prismatic""#,
        r#""jaw" type="revolute""#,
    );
    let start = wrist.find(r#"<joint name="right_finger""#).unwrap();
    let end = wrist.find("<link name=\"right\"/>").unwrap();
    let wrist = format!("{}{}", &wrist[..start], &wrist[end + 21..]);
    let robot = whole(&wrist);
    assert_eq!((robot.joints.len(), &*robot.joints[2].name), (3, "wrist"));
    let palm = ARM.replace(r#""wrist" type="fixed""#, r#""wrist" type="continuous""#);
    let palm = palm.replace("hand", "gripper");
    let robot = whole(&palm);
    assert_eq!(robot.joints[2].name, "wrist");
    let loose = ARM.replace("<robot ", "<!DOCTYPE robot><robot foo:bar=\"1\" ");
    assert_eq!(to_hand(&loose).joints.len(), 2);
}
