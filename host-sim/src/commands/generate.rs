use super::Failure;
use super::terminal::say;
use clap::Args;
use foretorque_workbench::generate::write_arm_module;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::urdf::{self, Selection};
use std::path::PathBuf;

/// Write the constants of an arm as a module of the firmware
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file
    #[arg(long, required_unless_present = "urdf", conflicts_with = "urdf")]
    robot: Option<String>,
    /// URDF file; one path of links in it is the arm
    #[arg(long, value_name = "FILE")]
    urdf: Option<PathBuf>,
    /// Link of the URDF that the arm stands on; without it the root of the tree
    #[arg(long, value_name = "LINK", conflicts_with = "robot")]
    base: Option<String>,
    /// Link of the URDF that the arm ends at; needed where the tree branches
    #[arg(long, value_name = "LINK", conflicts_with = "robot")]
    tip: Option<String>,
    /// Module to write, called like the arm; the mod.rs beside it, if there is one, gets its declaration
    #[arg(long, value_name = "FILE.rs")]
    out: PathBuf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let robot = match &arguments.urdf {
        Some(file) => {
            let selection = Selection {
                base: arguments.base.as_deref(),
                tip: arguments.tip.as_deref(),
            };
            let import = urdf::load(file, &selection)?;
            for note in &import.notes {
                say(format_args!("note: {note}"))?;
            }
            import.robot
        }
        None => Robot::load(arguments.robot.as_deref().unwrap_or_default())?,
    };
    write_arm_module(&robot, &arguments.out)?;
    say(format_args!(
        "{}: arm '{}' of {} joints",
        arguments.out.display(),
        robot.name,
        robot.joint_count()
    ))?;
    Ok(())
}
