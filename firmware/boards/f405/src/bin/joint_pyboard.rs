//! The flashable firmware on a pyboard v1.1: everything but the board's own file is that of `joint`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
foretorque_f405::image!(
    foretorque_f405::pyboard::Pyboard,
    foretorque::arm::ur5::Ur5,
    foretorque::arm::ur5::JOINTS,
    foretorque::arm::ur5::PARAMETERS
);

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("joint-pyboard is firmware: build it with `cargo firmware`");
    std::process::exit(2);
}
