//! The committed arm modules are what the generator writes today.

use foretorque::arm::{Arm, ur5::Ur5};
use foretorque_workbench::generate::{arm_hash, arm_module, write_arm_module};
use foretorque_workbench::robot::Robot;

#[test]
fn committed_ur5_is_what_its_description_generates() {
    let robot = Robot::load("ur5").unwrap();
    let committed = include_str!("../../../firmware/foretorque/src/arm/ur5.rs");
    assert!(
        arm_module(&robot) == committed,
        "firmware/foretorque/src/arm/ur5.rs is stale: run `cargo run -p host-sim --example write_arm -- ur5 firmware/foretorque/src/arm/ur5.rs`"
    );
}

#[test]
fn host_and_board_give_the_arm_the_same_identity() {
    let robot = Robot::load("ur5").unwrap();
    assert_eq!(arm_hash(&robot), Ur5::HASH);
    let mut other = robot;
    other.joints[3].placement.origin.x += 1e-4;
    assert_ne!(arm_hash(&other), Ur5::HASH);
}

#[test]
fn new_arm_is_declared_beside_the_others_once() {
    let robot = Robot::load("panda").unwrap();
    let folder = std::env::temp_dir().join(format!("foretorque-arms-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let parent = folder.join("mod.rs");
    std::fs::write(&parent, "//! Arms.\n\nmod identity;\npub mod ur5;\n").unwrap();
    let file = folder.join("my_panda.rs");
    for _ in 0..2 {
        write_arm_module(&robot, &file).unwrap();
        let text = std::fs::read_to_string(&parent).unwrap();
        assert_eq!(
            text,
            "//! Arms.\n\npub mod my_panda;\nmod identity;\npub mod ur5;\n"
        );
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), arm_module(&robot));
    for bad in ["My.rs", "7.rs", "a-b.rs", "arm.txt"] {
        let error = write_arm_module(&robot, &folder.join(bad)).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::InvalidInput, "{bad}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}
