//! Writes an arm module: `cargo run -p host-sim --example write_arm -- ROBOT FILE.rs`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(robot), Some(file)) = (arguments.next(), arguments.next()) else {
        return Err("usage: write_arm ROBOT FILE.rs".into());
    };
    let robot = foretorque_workbench::robot::Robot::load(&robot)?;
    foretorque_workbench::generate::write_arm_module(&robot, file.as_ref())?;
    Ok(())
}
