//! Which arm: the options that every command with a robot takes.

use super::terminal::say;
use super::{Failure, unusable};
use clap::Args;
use foretorque_workbench::robot::{Joint, Robot};
use foretorque_workbench::urdf::{Import, Selection};

/// Arm of a URDF, and values that take the place of the description's.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Arm")]
pub(super) struct ArmOptions {
    /// Name of the arm, in place of that in its file: lower-case letters, digits and underscores, a letter first
    #[arg(long = "name", value_name = "NAME")]
    called: Option<String>,
    /// Link of a URDF or MJCF that the arm stands on, or the joint that leaves it; without it the root
    #[arg(long, value_name = "NAME")]
    base: Option<String>,
    /// Link of a URDF or MJCF that the arm ends at, or its joint; without it the arm ends where only fixed, prismatic and
    /// mimic joints or fingers follow
    #[arg(long, value_name = "NAME")]
    tip: Option<String>,
    /// Make what hangs on the arm beside its path part of the link that carries it, at its zero
    #[arg(long)]
    weld: bool,
    /// Move inertias that no body has to the nearest one that a body has
    #[arg(long)]
    repair: bool,
    /// Mass of links without inertial data
    #[arg(long, value_name = "KG")]
    link_mass: Option<f64>,
    /// Rotor inertias reflected to the link side: one for all joints, or one for each
    #[arg(long, value_name = "KG_M2,...", value_delimiter = ',')]
    rotor_inertia: Vec<f64>,
    /// Torque limits: one for all joints, or one for each
    #[arg(long, value_name = "NM,...", value_delimiter = ',')]
    torque_limits: Vec<f64>,
    /// Velocity limits: one for all joints, or one for each
    #[arg(long, value_name = "RAD_S,...", value_delimiter = ',')]
    velocity_limits: Vec<f64>,
    /// Drive gains: one for all joints, or one for each
    #[arg(long, value_name = "NM_A,...", value_delimiter = ',')]
    drive_gains: Vec<f64>,
    /// Coulomb friction of the simulated arm: one for all joints, or one for each
    #[arg(long, value_name = "NM,...", value_delimiter = ',')]
    friction: Vec<f64>,
}

impl ArmOptions {
    /// The arm called `name`, with its notes.
    ///
    /// Errors: of the description; a list of another length than the joints; a value that is not positive.
    pub(super) fn import(&self, name: &str) -> Result<Import, Failure> {
        let selection = Selection {
            base: self.base.as_deref(),
            tip: self.tip.as_deref(),
            weld: self.weld,
            repair: self.repair,
            link_mass: self.link_mass,
        };
        if self
            .link_mass
            .is_some_and(|mass| !(mass.is_finite() && mass > 0.0))
        {
            return Err(unusable("--link-mass must be positive"));
        }
        let mut import = Robot::load_selected(name, &selection)?;
        if let Some(called) = &self.called {
            if !Robot::is_name(called) {
                return Err(unusable(format!(
                    "--name {called}: must be lower-case letters, digits and underscores, a letter first"
                )));
            }
            import.robot.name.clone_from(called);
        }
        type Place = fn(&mut Joint) -> &mut f64;
        let places: [(&str, &[f64], Place); 5] = [
            ("--rotor-inertia", &self.rotor_inertia, |joint| {
                &mut joint.drive.rotor_inertia
            }),
            ("--torque-limits", &self.torque_limits, |joint| {
                &mut joint.limits.torque
            }),
            ("--velocity-limits", &self.velocity_limits, |joint| {
                &mut joint.limits.velocity
            }),
            ("--drive-gains", &self.drive_gains, |joint| {
                &mut joint.drive.gain
            }),
            ("--friction", &self.friction, |joint| {
                &mut joint.friction.coulomb
            }),
        ];
        let joints = import.robot.joint_count();
        for (option, values, place) in places {
            if values.is_empty() {
                continue;
            }
            if values.len() != 1 && values.len() != joints {
                let found = values.len();
                return Err(unusable(format!(
                    "{option} has {found} values, the arm has {joints} joints"
                )));
            }
            if let Some(bad) = values
                .iter()
                .find(|value| !(value.is_finite() && **value > 0.0))
            {
                return Err(unusable(format!("{option}: {bad} must be positive")));
            }
            for (joint, value) in import.robot.joints.iter_mut().zip(values.iter().cycle()) {
                *place(joint) = *value;
            }
        }
        Ok(import)
    }

    /// The arm called `name`; its notes are printed.
    ///
    /// Errors: as of [`import`](Self::import), and of standard output.
    pub(super) fn load(&self, name: &str) -> Result<Robot, Failure> {
        let import = self.import(name)?;
        for note in &import.notes {
            say(format_args!("note: {note}"))?;
        }
        Ok(import.robot)
    }
}
