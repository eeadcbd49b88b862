use super::*;

const UR5: &str = include_str!("../../../robots/ur5.toml");

#[test]
fn stretched_ur5_reaches_as_its_data_sheet_states() {
    // All joints at zero: x = a2 + a3, y = −d4 − d6, z = d1 − d5 (standard DH table of the UR5).
    let robot = Robot::load("ur5").unwrap();
    let flange = robot
        .joints
        .iter()
        .fold(Placement::identity(), |frame, joint| {
            frame.then(&joint.placement)
        })
        .then(&robot.flange);
    let expected = Vector3::new(-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465);
    assert!((flange.origin - expected).norm() < 1e-12, "{flange:?}");
}

#[test]
fn centres_of_mass_move_from_dh_frames_to_joint_frames() {
    let robot = Robot::load("ur5").unwrap();
    let upper_arm = robot.joints[1].link.com;
    assert!((upper_arm - Vector3::new(0.2125 - 0.425, 0.0, 0.11336)).norm() < 1e-15);
    // alpha_1 = 90°: y of the DH frame is z of the joint frame, z is −y.
    let shoulder = robot.joints[0].link.com;
    assert!((shoulder - Vector3::new(0.0, -0.00193, -0.02561)).norm() < 1e-15);
}

#[test]
fn perturbed_links_stay_bodies_and_repeat_with_their_seed() {
    let robot = Robot::load("ur5").unwrap();
    for seed in 0..200 {
        let plant = robot.perturbed(seed, &Perturbation::PLANT);
        assert_eq!(plant, robot.perturbed(seed, &Perturbation::PLANT));
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
        name = \"ur5\" | name = \"UR 5\" | name: must be lower-case letters, digits and underscores, a letter first
        torque_nm = 150.0 | torque_nm = 0 | joints[0].limits.torque_nm: is 0, must be positive";
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
    let (bare, with) = (
        Robot::parse("t", UR5).unwrap(),
        Robot::parse("t", &format!("{UR5}{tool}")).unwrap(),
    );
    let (own, lumped) = (&bare.joints[5].link, &with.joints[5].link);
    assert!((lumped.mass - 0.9879).abs() < 1e-12);
    let com: Vector3<f64> = (0.1879 * own.com + 0.8 * Vector3::new(0.0, 0.0, 0.05)) / 0.9879;
    assert!((lumped.com - com).amax() < 1e-12);
    assert_eq!(bare.joints[..5], with.joints[..5]);
    assert_eq!(with.joints[5].capsules.len(), 2);
    // The flange of the UR5 is its last joint's frame.
    assert_eq!(
        with.joints[5].capsules[1].ends[1],
        Vector3::new(0.0, 0.0, 0.1)
    );
    for (bad, message) in [
        ("mass_kg = -1", "t: tool.mass_kg: is -1, must be positive"),
        ("mass = 0.8", "unknown field `mass`"),
    ] {
        let text = format!("{UR5}{}", tool.replace("mass_kg = 0.8", bad));
        let error = Robot::parse("t", &text).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}
