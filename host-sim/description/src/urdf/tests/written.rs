//! Arms that are written again.

use super::*;

#[test]
fn a_written_arm_is_the_arm_again_with_the_names_of_its_links() {
    let arm = to_hand(ARM);
    let motions = crate::dynamics::random_motions(2, 20);
    let torques = |robot: &Robot| -> Vec<Joints<2>> {
        let model = RigidBodies::new(robot);
        let torque = |motion| model.inverse_dynamics(motion).into();
        motions.iter().map(torque).collect()
    };
    let mut bare = arm.clone();
    for text in [write(&arm), mjcf(&arm)] {
        let again = whole(&text);
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
    let again = whole(&mjcf(&bare));
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
