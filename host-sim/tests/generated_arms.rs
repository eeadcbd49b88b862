//! The committed arm modules are what the generator writes today.

use foretorque::arm::{Arm, ur5::Ur5};
use host_sim::generate::{arm_hash, arm_module};
use host_sim::robot::Robot;

#[test]
fn committed_ur5_is_what_its_description_generates() {
    let robot = Robot::load("ur5").unwrap();
    let committed = include_str!("../../firmware/src/arm/ur5.rs");
    assert!(
        arm_module(&robot) == committed,
        "firmware/src/arm/ur5.rs is stale: run `cargo run -p host-sim --example write_arm -- ur5 firmware/src/arm/ur5.rs`"
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
