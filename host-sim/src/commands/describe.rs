use super::Failure;
use super::arm::ArmOptions;
use super::terminal::show;
use clap::Args;

/// Print the description of an arm as TOML: a start for a file with all that a URDF does not have
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file (TOML or URDF)
    robot: String,
    #[command(flatten)]
    arm: ArmOptions,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let import = arguments.arm.import(&arguments.robot)?;
    let (robot, assumed) = import.robot.with_assumed_rotors();
    for note in &import.notes {
        show!("# {note}")?;
    }
    if !assumed.is_empty() {
        show!("# assumed: rotor inertia of joints {assumed:?}, torque limit / 200 rad/s²")?;
    }
    show!("{}", robot.to_toml()?.trim_end())?;
    Ok(())
}
