use super::Failure;
use crate::files::write_whole;
use crate::generate::arm_module;
use crate::robot::Robot;
use clap::Args;
use std::path::PathBuf;

/// Write the constants of an arm as a module of the firmware
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file
    #[arg(long)]
    robot: String,
    /// Module to write
    #[arg(long, value_name = "FILE.rs")]
    out: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let robot = Robot::load(&arguments.robot)?;
    write_whole(&arguments.out, arm_module(&robot).as_bytes())?;
    Ok(())
}
