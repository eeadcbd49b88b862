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

    // A description with coupled drives has their limits.
    let limits = "limits = { position_rad = [-2, 2], velocity_rad_s = 2, torque_nm = 20 }";
    let names = ["panda_joint2", "panda_joint3"];
    let [two, three] = names.map(|name| format!("[[joints]]\nname = '{name}'\n{limits}\n"));
    let coupling =
        "[coupling]\njoints = ['panda_joint2', 'panda_joint3']\nmatrix = [[1, 1], [1, -1]]";
    let coupled = overlay(&format!("{two}{three}{coupling}")).unwrap();
    std::fs::write(here.join("coupled.toml"), coupled.to_toml().unwrap()).unwrap();
    let more = format!("from = 'coupled.toml'\n{joint}drive = {{ rotor_inertia_kg_m2 = 0.7 }}");
    let again = Robot::parse(&file, &more).unwrap();
    assert_eq!(again.joints[1].drive.rotor_inertia, 0.7);
    assert_eq!(again.joints[1].limits, coupled.joints[1].limits);
    assert_eq!(again.coupling, coupled.coupling);

    // Lines after the first, `/` between them, and the message.
    let cases = "
        [[joints]] / name = 'elbow' | joints[0].name: 'elbow' is not one of panda_joint1,
        JOINT / JOINT | joints[1].name: comes twice
        JOINT / drive = { rotor = 1 } | joint 'panda_joint2', line 4: unknown field `rotor`, expected one of
        JOINT / drive = 3 | joint 'panda_joint2', line 4: invalid type: integer `3`
        JOINT / friction.coulomb_nm = 1 / limits = { torque = 80 } | joint 'panda_joint2', line 5: unknown field `torque`, expected one of `position_rad`,
        [[joint]] / name = 'panda_joint2' | ALL
        [tool] / mass = 1 | line 3: unknown field `mass`, expected one of `mass_kg`, `com_m`, `inertia_kg_m2`, `capsules`
        weld = 3 | line 2: invalid type: integer `3`
        link_mass_kg = -1 | link_mass_kg: must be positive
        from = 'arm.urdf' | line 2: duplicate key
        COUPLING / matrix = [[1, 0], [1, 1]] | coupling: joint 'panda_joint2' needs limits
        COUPLING / matrix = [[1, 2], [2, 4]] | coupling: the rows of matrix must be
        COUPLING / matrix = [[1, 2]] | coupling: matrix must have 2 rows of 2 numbers
        [coupling] / joints = ['a'] / matrix = [[1]] | coupling: no joint 'a'";
    let coupling = "[coupling] / joints = ['panda_joint2', 'panda_joint3']";
    let cases = cases.replace("JOINT", "[[joints]] / name = 'panda_joint2'");
    let all = "line 2: unknown field `joint`, expected one of `name`, `gravity_m_s2`, `link_names`, `joints`, `flange`, `tool`, \
        `coupling`, `log_columns`, `workspace`, in an overlay also `from`, `base`, `tip`, `weld`, `repair`, `link_mass_kg`";
    let cases = cases.replace("ALL", all);
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
fn what_an_overlay_gives_is_not_noted_as_assumed_and_what_it_has_in_degrees_is() {
    let here = tempfile::tempdir().unwrap();
    let silent = include_str!("../urdf/tests/two_link.urdf").replace(" effort=\"40\"", "");
    let silent = silent.replacen("velocity=\"3\"", "velocity=\"0\"", 1);
    // 20 N·m allow 1.475 rad/s.
    let silent = silent.replacen("damping=\"0.5\"", "damping=\"10\"", 1);
    let silent = silent.replacen("xyz=\"0.1 0 0\"", "xyz=\"1.4 0 0\"", 1);
    let tilted = silent.replacen("xyz=\"0 0 1\"", "xyz=\"0 0 1\" rpy=\"0 0.5 0\"", 1);
    std::fs::write(here.path().join("arm.urdf"), silent).unwrap();
    std::fs::write(here.path().join("tilted.urdf"), tilted).unwrap();
    let import = |name: &str, text: String| {
        let file = here.path().join(name);
        std::fs::write(&file, text).unwrap();
        let whole = crate::urdf::Selection::default();
        let file = file.display().to_string();
        let import = Robot::load_selected(&file, &whole).unwrap();
        (import.notes().join("\n"), import.robot.joints)
    };
    let overlay = |more: &str| import("over.toml", format!("from = 'arm.urdf'\n{more}"));
    let joint = |name: &str, more: &str| format!("[[joints]]\nname = '{name}'\n{more}\n");
    let starts = [
        "joint 'shoulder': no velocity limit, 2 rad/s is taken",
        "joint 'shoulder': no torque limit, 39 N·m is taken",
        "joint 'elbow' is continuous: its range is taken as",
        "joint 'elbow': friction takes 75 % of the torque limit at 1.475 rad/s",
        "no acceleration limit at joints 'shoulder', 'elbow': 10 rad/s² is taken",
        "drives are not described: rotor inertias 0, gains not known, 17-bit encoders",
        "the centre of mass of link 'fore' lies 1.40 m",
    ];
    let (notes, bare) = overlay("");
    assert!(starts.iter().all(|start| notes.contains(start)), "{notes}");

    let drive = "drive = { rotor_inertia_kg_m2 = 0.6, gain_nm_a = 9, encoder_bits = 19 }\n";
    let limits = "limits = { position_rad = [-2, 2], velocity_rad_s = 3, acceleration_rad_s2 = 5, torque_nm = 80 }";
    let given = format!("{drive}{limits}");
    let full = joint("shoulder", &given) + &joint("elbow", &given) + "link.com_m = [0.1, 0, 0]";
    let (notes, _) = overlay(&full);
    let found = |words: &[&str]| words.iter().any(|word| notes.contains(word));
    let assumed = [
        "is taken",
        "are taken as ±",
        "drives",
        "friction takes",
        "centre",
    ];
    assert!(!found(&assumed), "{notes}");
    for (gravity, noted) in [("", true), ("gravity_m_s2 = [0, 0, 9.81]", false)] {
        let text = format!("from = 'tilted.urdf'\nbase = 'base'\n{gravity}");
        let (notes, _) = import("over.toml", text);
        let is_noted = notes.contains("is tilted against the root");
        assert_eq!(is_noted, noted, "{notes}");
    }

    // Of one joint alone; the torque limit that is assumed still, and the speed that a given one allows, follow.
    let elbow = joint("elbow", "limits.torque_nm = 40\ndrive.gain_nm_a = 9");
    let shoulder = joint("shoulder", "friction.coulomb_nm = 4");
    let (notes, joints) = overlay(&(elbow + &shoulder));
    assert_eq!(joints[0].limits.torque, bare[0].limits.torque + 6.0);
    assert!((joints[1].limits.velocity - 2.975).abs() < 1e-12);
    for note in [
        "no torque limit, 45 N·m is taken",
        "rotor inertias 0, gains not known (joints 'shoulder'), 17-bit encoders",
    ] {
        assert!(notes.contains(note), "{notes}");
    }

    let degrees = "limits = { position_rad = [-166, 166], velocity_rad_s = 180 }";
    let asked = [
        "its range -166 … 166 rad ends beyond a turn: are these degrees?",
        "its velocity limit is 180 rad/s: are these degrees?",
    ];
    let (sound, _) = import("ur5.toml", UR5.to_owned());
    let both = [
        "-6.283185307179586, 6.283185307179586",
        "velocity_rad_s = 3.141592653589793",
    ];
    let ur5 = UR5.replacen(both[0], "-166, 166", 1);
    let ur5 = ur5.replacen(both[1], "velocity_rad_s = 180", 1);
    let (alone, _) = import("ur5.toml", ur5);
    let (over, _) = overlay(&joint("elbow", degrees));
    assert_eq!(sound, "");
    for question in asked {
        assert!(alone.contains(question), "{alone}");
        assert!(
            over.contains(&format!("joint 'elbow': {question}")),
            "{over}"
        );
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
