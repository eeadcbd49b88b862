use super::*;

const UR5: &str = include_str!("../../../robots/ur5.toml");

#[test]
fn stretched_ur5_reaches_as_its_data_sheet_states() {
    // All joints at zero: x = a2 + a3, y = −d4 − d6, z = d1 − d5 (standard DH table of the UR5).
    let robot = Robot::load("ur5").unwrap();
    let mut flange = Placement::identity();
    for joint in &robot.joints {
        flange = flange.then(&joint.placement);
    }
    let flange = flange.then(&robot.flange);
    let expected = Vector3::new(-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465);
    assert!((flange.origin - expected).norm() < 1e-12, "{flange:?}");
}

#[test]
fn centres_of_mass_move_from_dh_frames_to_joint_frames() {
    let robot = Robot::load("ur5").unwrap();
    assert!((robot.joints[1].link.com - Vector3::new(0.2125 - 0.425, 0.0, 0.11336)).norm() < 1e-15);
    // alpha_1 = 90°: y of the DH frame is z of the joint frame, z is −y.
    assert!((robot.joints[0].link.com - Vector3::new(0.0, -0.00193, -0.02561)).norm() < 1e-15);
}

#[test]
fn perturbed_links_stay_bodies_and_repeat_with_their_seed() {
    let robot = Robot::load("ur5").unwrap();
    for seed in 0..200 {
        let plant = robot.perturbed(seed);
        assert_eq!(plant, robot.perturbed(seed));
        for (joint, original) in plant.joints.iter().zip(&robot.joints) {
            assert!(joint.link.second_moments().symmetric_eigenvalues().min() > 0.0);
            let ratio = joint.link.mass / original.link.mass;
            assert!((0.8..=1.2).contains(&ratio) && ratio != 1.0);
            assert!(joint.link.inertia_com.m12 != 0.0);
        }
    }
}

#[test]
fn bad_descriptions_are_refused_with_file_and_field() {
    // Text of the UR5's file, its replacement, message.
    let cases = "
        mass_kg = 3.7 | mass_kg = -3.7 | joints[0].link.mass_kg: is -3.7, must be positive
        mass_kg = 3.7 | mass_kg = nan | joints[0].link.mass_kg: is NaN, must be positive
        mass_kg = 3.7 | mass = 3.7 | line 22: unknown field `mass`, expected one of `mass_kg`, `com_m`, `inertia_kg_m2`
        xx = 0.0149 | xx = 0.9 | joints[1].link.inertia_kg_m2: breaks the triangle inequality: no body has these principal moments
        xz = 0.0034 | xz = 0.034 | joints[2].link.inertia_kg_m2: is not positive definite
        encoder_bits = 17 | encoder_bits = 3 | joints[0].drive.encoder_bits: must be 8 to 32
        [-6.283185307179586, | [7.0, | joints[0].limits.position_rad: lower end must be below upper end
        dh = { d_m = 0.089159, a_m = 0.0, alpha_rad = 1.5707963267948966 } | | joints[0].dh: give exactly one of 'dh' and 'frame'
        alpha_rad = 1.5707963267948966 | alpha_rad = 90 | joints[0].dh.alpha_rad: is in radians, and has more than a turn
        name = \"ur5\" | name = \"UR 5\" | name: must be lower-case letters, digits and underscores, a letter first
        torque_nm = 150.0 | torque_nm = 0 | joints[0].limits.torque_nm: is 0, must be positive
        name = \"elbow\" | name = \"shoulder_pan\" | joints[2].name: comes twice
        gravity_m_s2 = [0.0, 0.0, -9.81] | gravity_m_s2 = [0.0, 0.0, -981.0] | gravity_m_s2: is more than any planet's, 30 m/s²";
    for case in cases.trim().lines() {
        let [good, bad, message] = case.split('|').map(str::trim).collect::<Vec<_>>()[..] else {
            panic!("three columns: {case}");
        };
        assert!(UR5.contains(good), "{good}");
        let error = Robot::parse("t", &UR5.replacen(good, bad, 1)).unwrap_err();
        assert_eq!(error.to_string(), format!("t: {message}"));
    }
    let missing = Robot::load("no_such_robot").unwrap_err().to_string();
    assert!(missing.starts_with("unknown robot 'no_such_robot': not one of [ur5, panda]"));
    assert!(Robot::parse("t", "name = 3").is_err());
    let empty = Robot::parse("t.urdf", "").unwrap_err().to_string();
    assert!(empty.starts_with("t.urdf: not a URDF or MJCF"), "{empty}");
    assert!(Robot::parse("t", "name = \"x\"\njoints = []").is_err());
}

#[test]
fn a_tool_becomes_part_of_the_last_link() {
    let tool = "
        [tool]
        mass_kg = 0.8
        com_m = [0.0, 0.0, 0.05]
        inertia_kg_m2 = { xx = 0.001, yy = 0.001, zz = 0.0005 }
        capsules = [{ from_m = [0.0, 0.0, 0.0], to_m = [0.0, 0.0, 0.1], radius_m = 0.04 }]
    ";
    let parsed = |text: &str| Robot::parse("t", text).unwrap();
    let (bare, with) = (parsed(UR5), parsed(&format!("{UR5}{tool}")));
    let (own, lumped) = (&bare.joints[5].link, &with.joints[5].link);
    assert!((lumped.mass - 0.9879).abs() < 1e-12);
    let com: Vector3<f64> = (0.1879 * own.com + 0.8 * Vector3::new(0.0, 0.0, 0.05)) / 0.9879;
    assert!((lumped.com - com).amax() < 1e-12);
    assert_eq!(bare.joints[..5], with.joints[..5]);
    assert_eq!(with.joints[5].capsules.len(), 2);
    // The flange of the UR5 is its last joint's frame.
    let end = with.joints[5].capsules[1].ends[1];
    assert_eq!(end, Vector3::new(0.0, 0.0, 0.1));
    for (bad, message) in [
        ("mass_kg = -1", "t: tool.mass_kg: is -1, must be positive"),
        ("mass = 0.8", "unknown field `mass`"),
    ] {
        let text = format!("{UR5}{}", tool.replace("mass_kg = 0.8", bad));
        let error = Robot::parse("t", &text).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}

#[test]
fn an_overlay_completes_the_file_beside_it() {
    let here = tempfile::tempdir().unwrap();
    let here = here.path();
    let urdf = here.join("arm.urdf");
    std::fs::write(&urdf, include_str!("../../../robots/panda.urdf")).unwrap();
    let file = here.join("arm.toml").display().to_string();
    let below = Robot::load(&urdf.display().to_string()).unwrap();
    let start = "from = 'arm.urdf'\n";
    let overlay = |more: &str| Robot::parse(&file, &format!("{start}{more}"));
    let joint = "[[joints]]\nname = 'panda_joint2'\n";

    let same = overlay("").unwrap();
    assert_eq!(same.joints[6].link_frame, below.joints[6].link_frame);
    let whole = crate::urdf::Selection::default();
    let written = below.to_overlay("arm.urdf", &whole).unwrap();
    let (_, more) = written.split_once('\n').unwrap();
    assert_eq!(overlay(more).unwrap().joints, same.joints);
    let changed = overlay(&format!(
        "tip = 'panda_link5'\nname = 'short'\n{joint}drive = {{ rotor_inertia_kg_m2 = 0.7 }}\nfriction.coulomb_nm = 3"
    ));
    let changed = changed.unwrap();
    assert_eq!((&*changed.name, changed.joint_count()), ("short", 5));
    assert_eq!(changed.joints[1].drive.rotor_inertia, 0.7);
    assert_eq!(changed.joints[1].friction.coulomb, 3.0);
    assert_eq!(changed.joints[0].drive, same.joints[0].drive);
    assert_eq!(changed.joints[1].limits, same.joints[1].limits);

    // Lines after the first, `/` between them, and the message.
    let cases = "
        [[joints]] / name = 'elbow' | joints[0].name: 'elbow' is not one of panda_joint1,
        JOINT / JOINT | joints[1].name: comes twice
        JOINT / drive = { rotor = 1 } | unknown field `rotor`, expected one of
        JOINT / drive = 3 | invalid type: integer `3`
        weld = 3 | line 2: invalid type: integer `3`
        link_mass_kg = -1 | link_mass_kg: must be positive
        from = 'arm.urdf' | line 2: duplicate key
        COUPLING / matrix = [[1, 0], [1, 1]] | coupling: joint 'panda_joint2' needs limits
        COUPLING / matrix = [[1, 2], [2, 4]] | coupling: the rows of matrix must be
        COUPLING / matrix = [[1, 2]] | coupling: matrix must have 2 rows of 2 numbers
        [coupling] / joints = ['a'] / matrix = [[1]] | coupling: no joint 'a'";
    let coupling = "[coupling] / joints = ['panda_joint2', 'panda_joint3']";
    let cases = cases.replace("JOINT", "[[joints]] / name = 'panda_joint2'");
    for case in cases.replace("COUPLING", coupling).trim().lines() {
        let (more, message) = case.split_once('|').unwrap();
        let error = overlay(&more.trim().replace(" / ", "\n")).unwrap_err();
        let error = error.to_string();
        let error = error.strip_prefix(&format!("{file}: ")).unwrap_or(&error);
        assert!(error.starts_with(message.trim()), "{more}: {error}");
    }
    let endless = "from: the files that it names lead to no description in 16 steps";
    for (own, other) in [("arm.toml", "arm.toml"), ("other.toml", "arm.toml")] {
        std::fs::write(&file, format!("from = '{own}'")).unwrap();
        std::fs::write(here.join("other.toml"), format!("from = '{other}'")).unwrap();
        let error = Robot::load(&file).unwrap_err();
        assert!(error.to_string().ends_with(endless), "{error}");
    }
}

#[test]
fn a_description_is_read_back_as_the_robot_it_was_written_from() {
    for name in ["ur5", "panda"] {
        let robot = Robot::load(name).expect("built in").perturbed(3);
        let text = robot.to_toml().expect("serialises");
        let again = Robot::parse("again", &text).expect("reads its own writing");
        let pairs = robot.standard_parameters().into_iter();
        for (a, b) in pairs.zip(again.standard_parameters()) {
            assert!((a - b).abs() < 1e-12, "{name}: {a} {b}");
        }
        assert_eq!(robot.log_columns, again.log_columns);
        for (a, b) in robot.joints.iter().zip(&again.joints) {
            let apart = a.placement.rot_parent_child - b.placement.rot_parent_child;
            assert!(apart.amax() < 1e-12);
            assert!((a.placement.origin - b.placement.origin).amax() < 1e-12);
            assert_eq!((a.friction, a.limits), (b.friction, b.limits));
            assert_eq!(a.dh_frame.is_some(), b.dh_frame.is_some());
            for (a, b) in a.capsules.iter().zip(&b.capsules) {
                assert!((a.ends[1] - b.ends[1]).amax() < 1e-12);
            }
        }
        assert!((robot.flange.origin - again.flange.origin).amax() < 1e-12);
    }
}
