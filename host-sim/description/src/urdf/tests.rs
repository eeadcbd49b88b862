use super::*;
use crate::dynamics::{Joints, ReferenceModel, State};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::FRAC_PI_2;

/// A shoulder and an elbow about y, a hand with two fingers bolted to the forearm, and a camera on the upper arm.
pub(super) const ARM: &str = include_str!("tests/two_link.urdf");

/// Default classes, degrees, a turned and shifted joint, an actuator's limit, a gripper whose fingers are coupled.
pub(super) const MJCF: &str = include_str!("tests/two.xml");

const TENSOR: &str = r#"ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001""#;
const NO_TENSOR: &str = r#"ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0""#;

const WHOLE: Selection<'static> = between(None, None);
const TO_HAND: Selection<'static> = between(None, Some("hand"));

const fn between<'a>(base: Option<&'a str>, tip: Option<&'a str>) -> Selection<'a> {
    Selection {
        base,
        tip,
        weld: false,
        repair: false,
        link_mass: None,
    }
}

/// The arm of a file that needs no selection, and the notes.
pub(super) fn imported(text: &str) -> Import {
    parse("t", text, &WHOLE).unwrap()
}

pub(super) fn whole(text: &str) -> Robot {
    imported(text).robot
}

pub(super) fn to_hand(text: &str) -> Robot {
    parse("t", text, &TO_HAND).unwrap().robot
}

fn refusal(text: &str, selection: &Selection<'_>) -> String {
    parse("t", text, selection).unwrap_err().to_string()
}

/// A link with a mass, kg, and [`TENSOR`].
fn body(name: &str, mass: f64) -> String {
    format!(
        r#"<link name="{name}"><inertial><mass value="{mass}"/><inertia {TENSOR}/></inertial></link>"#
    )
}

/// [`ARM`] with another text from `start` up to `end`.
fn with(text: &str, start: &str, end: &str) -> String {
    let [start, end] = [start, end].map(|part| ARM.find(part).unwrap());
    format!("{}{text}{}", &ARM[..start], &ARM[end..])
}

impl Import {
    fn has(&self, note: &str) -> bool {
        self.notes().iter().any(|known| known == note)
    }

    /// A note begins with this.
    pub(super) fn begins(&self, start: &str) -> bool {
        self.notes().iter().any(|note| note.starts_with(start))
    }
}

fn gravity_torques(robot: &Robot) -> Joints<2> {
    let model = ReferenceModel::<2>::new(robot).unwrap();
    model.gravity_torques(&Joints::zeros())
}

#[test]
fn bolted_links_become_part_of_the_link_that_moves_them() {
    let robot = &parse("t", ARM, &TO_HAND).unwrap().robot;
    assert_eq!(robot.name, "two_link");
    let upper = &robot.joints[0].link;
    assert_eq!(upper.mass, 3.0);
    // About y only the two masses 2/3 kg·(0.2² + 0.1²) m² apart and their own tensors count; y is the joint's z.
    let expected = 0.03 + 0.001 + 2.0 / 3.0 * (0.2 * 0.2 + 0.1 * 0.1);
    let error = upper.inertia_com.m33 - expected;
    assert!(error.abs() < 1e-15, "{upper:?}");
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
    let along = [Vector3::x(), Vector3::y(), Vector3::z()];
    let oblique = [Vector3::new(1.0, -2.0, 0.5)];
    for axis in [&along[..], &along.map(|axis| -axis), &oblique].concat() {
        let text = format!(
            r#"<robot name="door"><link name="wall"/>
            <joint name="hinge" type="revolute"><parent link="wall"/><child link="leaf"/>
              <axis xyz="{} {} {}"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
            <link name="leaf"><inertial><origin xyz="0.3 0.2 -0.1"/><mass value="2"/>
              <inertia ixx="0.1" iyy="0.12" izz="0.14" ixy="0.01" ixz="0.02" iyz="-0.03"/></inertial></link>
            </robot>"#,
            axis.x, axis.y, axis.z
        );
        let robot = whole(&text);
        let model = ReferenceModel::<1>::new(&robot).unwrap();
        let unit = axis.normalize();
        let (com, mass) = (Vector3::new(0.3, 0.2, -0.1), 2.0);
        let tensor = Matrix3::new(0.1, 0.01, 0.02, 0.01, 0.12, -0.03, 0.02, -0.03, 0.14);
        let inertia = unit.dot(&(tensor * unit)) + mass * unit.cross(&com).norm_squared();
        for q in [0.0, 0.7, -2.0] {
            let turn = nalgebra::Rotation3::new(unit * q);
            let weight = Vector3::new(0.0, 0.0, mass * 9.81);
            let lift = unit.cross(&(turn * com)).dot(&weight);
            let [q, qd, qdd] = [q, 1.5, 2.0].map(Joints::<1>::new);
            let state = State { q, qd, qdd };
            let tau = model.inverse_dynamics(&state)[0];
            assert!((tau - (2.0 * inertia + lift)).abs() < 1e-12, "{axis} {q}");
        }
        let rot = &robot.joints[0].placement.rot_parent_child;
        let exact = rot.iter().all(|x| x.fract() == 0.0);
        assert_eq!(exact, axis.amax() == axis.norm(), "{axis}");
    }
}

#[test]
fn a_point_of_mass_may_be_bolted_on_but_not_be_a_link() {
    assert_eq!(ARM.matches(TENSOR).count(), 2);
    let points = ARM.replace(TENSOR, NO_TENSOR);
    assert_eq!(to_hand(&points).joints[1].link.mass, 1.5);
    let ends = r#"<parent link="fore"/><child link="hand"/>"#;
    let moves = r#"<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>"#;
    let only_a_point = points.replacen(ends, &format!("{ends}{moves}"), 1);
    let [fixed, revolute] = [r#""wrist" type="fixed""#, r#""wrist" type="revolute""#];
    let only_a_point = only_a_point.replacen(fixed, revolute, 1);
    let message =
        "t: link 'hand': inertia is not positive definite (--repair takes the nearest of a body)";
    assert_eq!(refusal(&only_a_point, &TO_HAND), message);
}

#[test]
fn a_tip_cuts_off_what_moves_behind_it_with_its_mass_in_a_note() {
    let import = parse("t", ARM, &between(Some("base"), Some("fore"))).unwrap();
    // The hand is bolted on.
    assert_eq!(import.robot.joints[1].link, to_hand(ARM).joints[1].link);
    let behind = "link 'fore' carries 0.500 kg on fixed joints, part of the arm";
    assert!(import.begins(behind), "{:?}", import.notes());
    // The base frame is that of the base link, not of the world it stands in.
    let origin = import.robot.joints[0].placement.origin;
    assert_eq!(origin, Vector3::new(0.0, 0.0, 0.5));
    let heavy = ARM.replace(r#"<link name="left"/>"#, &body("left", 0.1));
    let whole = parse("t", &heavy, &TO_HAND).unwrap();
    assert_eq!(whole.robot.joints[0].placement.origin.z, 1.5);
    assert!(!whole.begins("link 'hand' carries"));
    for (finger, lost) in [("left", ", 0.100 kg (--weld keeps it)"), ("right", "")] {
        let joint = format!("joint '{finger}_finger' and all it carries");
        let note = format!("left out: link '{finger}' on {joint}{lost}");
        assert!(whole.has(&note), "{:?}", whole.notes());
    }
}

#[test]
fn tips_to_choose_from_are_listed_with_the_mass_they_leave_out() {
    let mut hand = String::new();
    for (parent, child, mass) in [
        ("hand", "a", 0.2),
        ("a", "b", 0.1),
        ("hand", "c", 0.25),
        ("c", "d", 0.125),
    ] {
        hand += &format!(
            r#"<joint name="to_{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/></joint>{}"#,
            body(child, mass)
        );
    }
    let forked = ARM.replace("</robot>", &format!("{hand}</robot>"));
    let expected = "t: the tree branches at link 'fore': choose the arm's end with --tip 'b' (leaves out 0.375 kg) or --tip 'd' (leaves out 0.300 kg) or --tip 'fore' (leaves out 0.675 kg); --weld leaves nothing out";
    assert_eq!(refusal(&forked, &WHOLE), expected);
    let mut weld = between(None, Some("fore"));
    weld.weld = true;
    let welded = parse("t", &forked, &weld).unwrap();
    let mass = welded.robot.joints[1].link.mass;
    assert!((mass - 1.5 - 0.675).abs() < 1e-12, "{mass}");
}

#[test]
fn gravity_is_that_of_the_root_whatever_link_the_arm_stands_on() {
    let whole = parse("t", ARM, &TO_HAND).unwrap();
    assert_eq!(whole.robot.gravity.as_slice(), [0.0, 0.0, -9.81]);
    // The base hangs on the world by a wall.
    let (upright, tilted) = (r#"xyz="0 0 1""#, r#"xyz="0 0 1" rpy="0 0.5 0""#);
    assert!(ARM.contains(upright));
    let tilted = ARM.replacen(upright, tilted, 1);
    let import = parse("t", &tilted, &between(Some("base"), Some("hand"))).unwrap();
    let expected = Vector3::new(0.5_f64.sin(), 0.0, -0.5_f64.cos()) * 9.81;
    let gravity = import.robot.gravity;
    assert!((gravity - expected).norm() < 1e-9, "{gravity}");
    let note = "link 'base' is tilted against the root: gravity is (4.703, 0.000, -8.609) m/s² in its frame";
    assert!(import.has(note), "{:?}", import.notes());
}

#[test]
fn assumptions_are_listed_in_the_notes() {
    let import = parse("t", ARM, &TO_HAND).unwrap();
    let elbow = &import.robot.joints[1];
    assert_eq!(elbow.limits.position, (-4.0 * FRAC_PI_2, 4.0 * FRAC_PI_2));
    let friction = (elbow.friction.viscous, elbow.friction.coulomb);
    assert_eq!(friction, (0.5, 0.25));
    assert_eq!(elbow.drive.rotor_inertia, 0.0);
    for note in [
        "joint 'elbow': angles near right angles are taken as right angles",
        "joint 'elbow' is continuous: its range is taken as ±2π rad",
        "no acceleration limit at joints 'shoulder', 'elbow': 10 rad/s² is taken",
        "drives are not described: rotor inertias 0, gains not known, 17-bit encoders",
    ] {
        assert!(import.has(note), "{:?}", import.notes());
    }
    assert_eq!(import.robot.flange.origin, Vector3::new(0.3, 0.0, 0.0));
}

#[test]
fn limits_that_are_none_are_not_taken() {
    // Those of a continuous joint, or a range without end, infinite ones, and a speed in degrees.
    let elbow = r#""elbow" type="continuous">"#;
    for (kind, range) in [
        ("continuous", r#"lower="-0.5" upper="0.5""#),
        ("revolute", r#"lower="-10000" upper="10000""#),
    ] {
        let limits = format!(r#"<limit {range} velocity="inf" effort="Infinity"/>"#);
        let own = format!(r#""elbow" type="{kind}">{limits}"#);
        let text = ARM.replace(elbow, &own);
        let text = text.replacen("velocity=\"3\"", "velocity=\"180\"", 1);
        let import = imported(&text);
        let elbow = import.robot.joints[1].limits;
        assert_eq!(elbow.position, (-4.0 * FRAC_PI_2, 4.0 * FRAC_PI_2));
        for note in [
            "joint 'elbow' is continuous: its range",
            "joint 'elbow': no velocity limit, 2 rad/s",
            "joint 'elbow': no torque limit",
            "joint 'shoulder': its velocity limit is 180 rad/s: are these degrees?",
        ] {
            assert!(import.begins(note), "{note}: {:?}", import.notes());
        }
    }
}

#[test]
fn an_arm_ends_where_only_fingers_follow_and_joints_may_name_base_and_tip() {
    let whole = imported(ARM);
    assert_eq!(whole.robot, to_hand(ARM));
    assert!(whole.has("the arm ends at link 'hand'"));
    // A jaw that turns is a finger by its name; without such a name it is a joint.
    let prismatic = r#""left_finger" type="prismatic""#;
    let jaw = ARM.replace(prismatic, r#""jaw" type="revolute""#);
    let jaw = jaw.replace("<mimic joint=\"left_finger\"/>", "<mimic joint=\"jaw\"/>");
    assert_eq!(imported(&jaw).robot.joint_count(), 2);
    let by_joint = between(Some("elbow"), Some("elbow"));
    let forearm = parse("t", ARM, &by_joint).unwrap().robot;
    let [joint] = &forearm.joints[..] else {
        panic!("{forearm:?}");
    };
    assert_eq!(joint.name, "elbow");
    // Two arms: the tips to choose from, the longer first.
    let torso = ARM.replace("</robot>", r#"
        <joint name="a" type="revolute"><parent link="base"/><child link="b"/></joint><link name="b"/>
        <joint name="c" type="revolute"><parent link="b"/><child link="d"/></joint><link name="d"/>
        <joint name="e" type="revolute"><parent link="d"/><child link="f"/></joint><link name="f"/></robot>"#);
    let expected =
        "t: the tree branches at link 'world': choose the arm's end with --tip 'f' or --tip 'fore'";
    assert_eq!(refusal(&torso, &WHOLE), expected);
    let heavy = torso.replace(r#"<link name="left"/>"#, &body("left", 0.1));
    let error = refusal(&heavy, &WHOLE);
    let expected = "--tip 'f' or --tip 'fore' (leaves out 0.100 kg); --weld leaves nothing out";
    assert!(error.ends_with(expected), "{error}");
    // One branch that branches again.
    let torso = torso.replace("</robot>", r#"
        <joint name="g" type="revolute"><parent link="b"/><child link="h"/></joint><link name="h"/>
        <joint name="i" type="revolute"><parent link="h"/><child link="k"/></joint><link name="k"/></robot>"#);
    let error = refusal(&torso, &WHOLE);
    let expected = "--tip 'f' or --tip 'k' or --tip 'fore'";
    assert!(error.ends_with(expected), "{error}");
}

#[test]
fn numbers_that_look_like_other_units_are_asked_about() {
    for (good, bad, question) in [
        (
            "lower=\"-2\" upper=\"2\"",
            "lower=\"-115\" upper=\"115\"",
            "joint 'shoulder': its range -115 … 115 rad ends beyond a turn: are these degrees?",
        ),
        (
            "iyy=\"0.02\" iyz=\"0\" izz=\"0.02\"",
            "iyy=\"20\" iyz=\"0\" izz=\"20\"",
            "link 'fore': the inertia is that of a body of 3.65 m radius of gyration, the link is about 0.40 m long",
        ),
        (
            "velocity=\"3\"",
            "velocity=\"180\"",
            "joint 'shoulder': its velocity limit is 180 rad/s: are these degrees?",
        ),
        (
            "xyz=\"0.1 0 0\"",
            "xyz=\"1.4 0 0\"",
            "the centre of mass of link 'fore' lies 1.40 m from its joint, the link is about 0.40 m long: is it given in another frame?",
        ),
    ] {
        assert!(ARM.contains(good), "{good}");
        let asked = |text: &str| imported(text).begins(question);
        assert!(asked(&ARM.replacen(good, bad, 1)), "{question}");
        assert!(!asked(ARM), "{question}");
    }
    // One tensor for every link, as tools write it that know none.
    let own = [
        r#"ixx="0.01" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03""#,
        r#"ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02""#,
    ];
    let one = ARM.replace(own[0], TENSOR);
    let all = one.replace(own[1], TENSOR);
    let note = "links 'upper', 'fore' share one inertia, the same about all axes";
    let noted = [ARM, &one, &all].map(|text| imported(text).begins(note));
    assert_eq!(noted, [false, false, true]);
}

#[test]
fn what_common_parsers_accept_beyond_xml_is_read() {
    let prefixed = ARM.replacen("</robot>", "<gz:plugin/></robot>", 1);
    let values = r#"<xacro:property name="width" value=".2"/><xacro:arg name="a"/><!-- ${width} --></robot>"#;
    for text in [
        ARM.replacen("</robot>", values, 1),
        format!("\n <?xml version=\"1.0\"?>\n{ARM}"),
        format!("\u{feff}{ARM}"),
        prefixed,
    ] {
        assert_eq!(to_hand(&text), to_hand(ARM));
    }
}

#[test]
fn the_axis_of_a_fixed_joint_is_not_read() {
    let axis = "type=\"fixed\"><axis xyz=\"nan nan nan\"/>";
    assert_eq!(whole(&ARM.replace("type=\"fixed\">", axis)), whole(ARM));
}

#[test]
fn values_that_a_file_leaves_out_are_assumed_with_a_note() {
    let bare = ARM
        .replace(" effort=\"40\"", "")
        .replacen("velocity=\"3\"", "velocity=\"0\"", 1);
    let import = imported(&bare);
    let shoulder = import.robot.joints[0].limits;
    // 1.5 of 9.81 (3·0.137 + 1.5·(0.4 + 0.167)) N·m, and 1 N·m.
    assert_eq!((shoulder.velocity, shoulder.torque), (2.0, 20.0));
    for note in [
        "joint 'shoulder': no velocity limit, 2 rad/s",
        "joint 'shoulder': no torque limit, 20 N·m",
    ] {
        assert!(import.begins(note), "{:?}", import.notes());
    }
    let strong = imported(&ARM.replacen("effort=\"40\"", "effort=\"501\"", 1));
    let [shoulder, elbow] = [0, 1].map(|joint| &strong.robot.joints[joint]);
    assert_eq!((shoulder.drive.gain, shoulder.gain()), (None, 10.0));
    assert_eq!((elbow.drive.gain, elbow.gain()), (None, 1.0));
    let broken = ARM.replace("iyy=\"0.03\"", "iyy=\"0.3\"");
    let mut repair = WHOLE;
    repair.repair = true;
    let repaired = parse("t", &broken, &repair).unwrap();
    assert!(repaired.begins("link 'upper': inertia moved"));
    let moments = repaired.robot.joints[0].link.second_moments();
    assert!(moments.symmetric_eigenvalues().min() > 0.0);
    assert_eq!(parse("t", ARM, &repair).unwrap().robot, to_hand(ARM));
    let upper = r#"<link name="upper"/>"#;
    let camera = r#"<joint name="camera_mount""#;
    let hollow = with(upper, r#"<link name="upper">"#, camera);
    // A point of mass alone.
    let point = hollow.replacen(TENSOR, NO_TENSOR, 1);
    assert!(refusal(&point, &WHOLE).contains("--repair takes the nearest"));
    let import = parse("t", &point, &repair).unwrap();
    assert!(import.begins("link 'upper': inertia of all its parts moved"));
    let hollow = hollow.replacen(
        r#"<inertial><mass value="1"/>"#,
        r#"<collision/><inertial><mass value="0"/>"#,
        1,
    );
    let hollow = hollow.replacen(TENSOR, NO_TENSOR, 1);
    assert!(refusal(&hollow, &WHOLE).ends_with("--link-mass"));
    let mut rods = WHOLE;
    rods.link_mass = Some(2.0);
    let robot = parse("t", &hollow, &rods).unwrap().robot;
    assert_eq!(robot.joints[0].link.mass, 2.0);
}

#[test]
fn a_chain_of_fingers_is_no_arm_and_a_palm_is_a_wrist() {
    let prismatic = r#""left_finger" type="prismatic""#;
    let hand = ARM.replace(prismatic, r#""left_finger" type="revolute""#);
    let tip = r#"<link name="left"/><joint name="left_finger_tip" type="revolute">
        <parent link="left"/><child link="left_tip"/></joint><link name="left_tip"/>"#;
    let hand = hand.replace(r#"<link name="left"/>"#, tip);
    assert_eq!(whole(&hand).joints.len(), 2);
    // A wrist that carries a jaw.
    let turning = ARM.replace(r#""wrist" type="fixed""#, r#""wrist" type="continuous""#);
    let wrist = turning.replace("\"hand\"", "\"gripper\"");
    let wrist = wrist.replace(prismatic, r#""jaw" type="revolute""#);
    let start = wrist.find(r#"<joint name="right_finger""#).unwrap();
    let end = wrist.find("<link name=\"right\"/>").unwrap();
    let wrist = format!("{}{}", &wrist[..start], &wrist[end + 21..]);
    let robot = whole(&wrist);
    assert_eq!((robot.joints.len(), &*robot.joints[2].name), (3, "wrist"));
    let palm = turning.replace("hand", "gripper");
    let robot = whole(&palm);
    assert_eq!(robot.joints[2].name, "wrist");
    let loose = ARM.replace("<robot ", "<!DOCTYPE robot><robot foo:bar=\"1\" ");
    assert_eq!(to_hand(&loose).joints.len(), 2);
}

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
        ; hand ; <mass value="2"/> ; <mass value="2e38"/> ; line 8: <mass> value="2e38" is not a number of 32 bits
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
        ; hand ; <link name="base"/> ; <link name="base"/><xacro:property name="h" value="1"/><part height="${h}"/> ; contains xacro macros: expand the file first (xacro FILE)
        ; hand ; xyz="0 0 0.5" ; xyz="${h} 0 0.5" ; line 6: <origin> xyz="${h} 0 0.5" is not three numbers: expand the file first (xacro FILE)
        ; hand ; rpy="1.5708 0 0" ; rpy="90 0 0" ; line 14: <origin> has more than a turn in rpy, which is in radians
        ; hand ; damping="0.5" ; damping="-0.5" ; joint 'elbow' has the viscous friction -0.5, must not be negative
        ; hand ; velocity="3" ; velocity="-3" ; joint 'shoulder' has the velocity limit -3, must not be negative
        ; hand ; effort="40" ; effort="-40" ; joint 'shoulder' has the torque limit -40, must not be negative"##;
    for case in cases.trim_start_matches('\n').lines() {
        let [base, tip, good, bad, message] =
            case.split(';').map(str::trim).collect::<Vec<_>>()[..]
        else {
            panic!("five columns: {case}");
        };
        assert!(ARM.contains(good), "{good}");
        let option = |name| Some(name).filter(|name: &&str| !name.is_empty());
        let (base, tip) = (option(base), option(tip));
        let error = refusal(&ARM.replacen(good, bad, 1), &between(base, tip));
        assert_eq!(error, format!("t: {message}"));
    }
    let to = |tip| between(None, Some(tip));
    let error = refusal("<sdf/>", &to("fore"));
    let message = "t: not a URDF or MJCF: <sdf> instead of <robot> or <mujoco>";
    assert_eq!(error, message);
    assert!(refusal("<robot", &to("fore")).starts_with("t: not a URDF or MJCF: "));
    let fore = r#"<link name="fore"/><link name="hand"/>
        <joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/></joint>"#;
    let weightless = with(
        fore,
        r#"<link name="fore">"#,
        r#"<joint name="left_finger""#,
    );
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
    assert_eq!(refusal(&long, &WHOLE), ends);
    for selection in [between(Some("l2"), None), between(None, Some("l8"))] {
        let cut = parse("t", &long, &selection).unwrap().robot;
        assert_eq!(cut.joint_count(), 8);
    }
    let error = refusal(&chain("prismatic"), &WHOLE);
    assert!(error.ends_with("(--base 'l1' begins behind it)"), "{error}");
}

#[test]
fn an_assumed_torque_limit_moves_friction_and_rotor() {
    let limit = |text: &str| {
        let text = text.replacen(" actuatorfrcrange=\"-40 50\"", "", 1);
        let import = imported(&text.replacen("forcerange=\"-35 35\"", "", 1));
        import.robot.joints[0].limits.torque
    };
    // 9.81 (2·0.2 + 1·(0.4 + 0.1)) N·m, damping 1 at 2 rad/s, rotor 0.1 at 10 rad/s²; then 4 N·m of friction.
    let bare = limit(MJCF);
    for more in ["frictionloss=\"4\"", "armature=\"0.5\""] {
        let changed = MJCF.replacen("name=\"shoulder\"", &format!("name=\"shoulder\" {more}"), 1);
        assert_eq!(limit(&changed) - bare, 6.0, "{more}");
    }
}

#[test]
fn inertia_without_mass_is_left_out_on_demand() {
    let massless = ARM.replacen("<mass value=\"0.5\"/>", "<mass value=\"0\"/>", 1);
    let error = refusal(&massless, &TO_HAND);
    assert!(error.ends_with("(--repair leaves it out)"), "{error}");
    let mut repair = TO_HAND;
    repair.repair = true;
    let import = parse("t", &massless, &repair).unwrap();
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
