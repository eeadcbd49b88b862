use super::Failure;
use super::arm::ArmOptions;
use super::terminal::show;
use clap::{Args, ValueEnum};
use foretorque_workbench::urdf;
use std::path::Path;

/// Print the description of an arm, with what was assumed for it: a start for a file with all that a URDF does not have
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    /// Robot: a built-in name or a description file (TOML, URDF or MJCF)
    robot: String,
    #[command(flatten)]
    arm: ArmOptions,
    /// Format; TOML keeps everything, an overlay is a TOML that completes the file beside it, the others keep what they have
    /// elements for
    #[arg(long, value_enum, default_value_t = Format::Toml)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Toml,
    Overlay,
    Urdf,
    Mjcf,
    Sdf,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let import = arguments.arm.import(&arguments.robot)?;
    let (robot, assumed) = import.robot.with_assumed_rotors();
    let mut notes = import.notes;
    if !assumed.is_empty() {
        notes.push(format!(
            "assumed: rotor inertia of joints {assumed:?}, torque limit / 200 rad/s²"
        ));
    }
    let toml = |text: String| {
        notes.iter().try_for_each(|note| show!("# {note}"))?;
        show!("{}", text.trim_end())
    };
    let write = match arguments.format {
        Format::Toml => return toml(robot.to_toml()?),
        Format::Overlay => {
            let name = Path::new(&arguments.robot).file_name().unwrap_or_default();
            let selection = arguments.arm.selection();
            return toml(robot.to_overlay(&name.to_string_lossy(), &selection)?);
        }
        Format::Urdf => urdf::write,
        Format::Mjcf => urdf::mjcf,
        Format::Sdf => urdf::sdf,
    };
    show!("{}", write(&robot).trim_end())?;
    // Nothing may stand before the declaration of an XML.
    for note in &notes {
        show!("<!-- {} -->", note.replace("--", "- -"))?;
    }
    Ok(())
}
