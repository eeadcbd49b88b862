use super::Failure;
use super::arm::ArmOptions;
use super::terminal::show;
use clap::Args;
use foretorque_workbench::generate::write_arm_module;
use std::path::PathBuf;

/// Write the constants of an arm as a module of the firmware
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file
    #[arg(long, alias = "urdf")]
    robot: String,
    #[command(flatten)]
    arm: ArmOptions,
    /// Module to write, called like the arm; the mod.rs beside it, if there is one, gets its declaration
    #[arg(long, value_name = "FILE.rs")]
    out: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let robot = arguments.arm.load(&arguments.robot)?;
    let joints = robot.joints.iter().map(|joint| joint.name.as_str());
    let joints: Vec<&str> = joints.collect();
    write_arm_module(&robot, &arguments.out)?;
    show!(
        "{}: arm '{}' of {} joints: {}",
        arguments.out.display(),
        robot.name,
        robot.joint_count(),
        joints.join(", ")
    )?;
    Ok(())
}
