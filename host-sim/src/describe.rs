//! Descriptions of arms as files, and as modules of the firmware.

use super::arm::{ArmOptions, joint_count};
use super::terminal::show;
use super::{Failure, not_over};
use clap::{Args, ValueEnum};
use foretorque_workbench::dynamics::RigidBodies;
use foretorque_workbench::generate::write_arm_module;
use foretorque_workbench::report::page::figure;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::urdf;
use std::path::{Path, PathBuf};

/// Print the description of an arm, with what was assumed for it: a start for a file with all that a URDF does not have
#[derive(Debug, Args)]
pub(super) struct Describe {
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

impl Describe {
    pub(super) fn run(&self) -> Result<(), Failure> {
        let (robot, mut notes) = self.arm.import(&self.robot)?;
        let (_, unknown) = robot.with_assumed_rotors();
        if !unknown.is_empty() {
            notes.push(format!(
                "rotor inertia of joints {unknown:?} not known: 0 in the firmware, torque limit / 200 rad/s² in a simulated arm"
            ));
        }
        let weights = RigidBodies::new(&robot).largest_gravity_torques();
        for (joint, weight) in robot.joints.iter().zip(weights.iter()) {
            let (name, limit) = (&joint.name, joint.limits.torque);
            if *weight > limit {
                notes.push(format!(
                    "joint '{name}': its torque limit of {limit} N·m is below the {} N·m of the arm's own weight in some poses: correct it (--torque-limits)",
                    figure(*weight, 0)
                ));
            }
        }
        let toml = |text: String| {
            notes.iter().try_for_each(|note| show!("# {note}"))?;
            show!("{}", text.trim_end())
        };
        let write = match self.format {
            Format::Toml => return toml(robot.to_toml()?),
            Format::Overlay => {
                let name = Path::new(&self.robot).file_name().unwrap_or_default();
                return toml(robot.to_overlay(&name.to_string_lossy(), &self.arm.selection())?);
            }
            Format::Urdf => urdf::write,
            Format::Mjcf => urdf::mjcf,
            Format::Sdf => urdf::sdf,
        };
        if robot.coupling.is_some() {
            notes.push("without the coupling of the drives, for which this format has no element: --format toml or overlay keep it".to_owned());
        }
        show!("{}", write(&robot).trim_end())?;
        // Nothing may stand before the declaration of an XML.
        for note in &notes {
            show!("<!-- {} -->", note.replace("--", "- -"))?;
        }
        Ok(())
    }
}

/// Write the constants of an arm as a module of the firmware
#[derive(Debug, Args)]
pub(super) struct Generate {
    /// Robot: a built-in name or a description file
    #[arg(long, alias = "urdf")]
    robot: String,
    #[command(flatten)]
    arm: ArmOptions,
    /// Module to write, called like the arm; the mod.rs beside it, if there is one, gets its declaration
    #[arg(long, value_name = "FILE.rs")]
    out: PathBuf,
}

impl Generate {
    pub(super) fn run(&self) -> Result<(), Failure> {
        let robot = self.arm.load(&self.robot)?;
        not_over(Robot::files(Path::new(&self.robot)), [self.out.clone()])?;
        let joints: Vec<&str> = robot.joints.iter().map(|j| j.name.as_str()).collect();
        write_arm_module(&robot, &self.out)?;
        let (out, name, count) = (self.out.display(), &robot.name, joints.len());
        show!(
            "{out}: arm '{name}' of {}: {}",
            joint_count(count),
            joints.join(", ")
        )
    }
}
