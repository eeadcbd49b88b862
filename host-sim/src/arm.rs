//! Options that commands share: the robot, and the arm in its description.

use super::terminal::show;
use super::{Failure, bail, not_negative, positive};
use clap::Args;
use foretorque::learning::RATED_COM_DISTANCE;
use foretorque_workbench::dynamics::RigidBodies;
use foretorque_workbench::robot::{Joint, Link, Robot};
use foretorque_workbench::urdf::Selection;
use std::path::{Path, PathBuf};

/// Arm of a URDF, and values that take the place of the description's.
#[derive(Clone, Debug, Default, PartialEq, Args)]
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
    /// Mass of links without inertial data, kg
    #[arg(long, value_name = "KG", value_parser = positive)]
    link_mass: Option<f64>,
    /// Rotor inertias reflected to the link side, kg·m²: one for all joints, or one for each
    #[arg(long, value_name = "KG_M2,...", value_delimiter = ',', value_parser = not_negative)]
    rotor_inertia: Vec<f64>,
    /// Torque limits, N·m: one for all joints, or one for each
    #[arg(long, value_name = "NM,...", value_delimiter = ',', value_parser = positive)]
    torque_limits: Vec<f64>,
    /// Velocity limits, rad/s: one for all joints, or one for each
    #[arg(long, value_name = "RAD_S,...", value_delimiter = ',', value_parser = positive)]
    velocity_limits: Vec<f64>,
    /// Drive gains, N·m/A: one for all joints, or one for each
    #[arg(long, value_name = "NM_A,...", value_delimiter = ',', value_parser = positive)]
    drive_gains: Vec<f64>,
    /// Coulomb friction of the simulated arm, N·m: one for all joints, or one for each
    #[arg(long, value_name = "NM,...", value_delimiter = ',', value_parser = not_negative)]
    friction: Vec<f64>,
}

/// The robot of a command.
#[derive(Debug, Args)]
pub(super) struct RobotOptions {
    /// Robot: a built-in name, or a TOML, URDF or MJCF file; its log_columns map foreign logs
    #[arg(long)]
    pub(super) robot: String,
    #[command(flatten)]
    pub(super) arm: ArmOptions,
}

impl RobotOptions {
    pub(super) fn files(&self) -> Vec<PathBuf> {
        Robot::files(Path::new(&self.robot))
    }

    pub(super) fn load(&self) -> Result<Robot, Failure> {
        self.arm.load(&self.robot)
    }

    /// The robot, which may have coupled joints; its notes are printed.
    pub(super) fn load_coupled(&self) -> Result<Robot, Failure> {
        self.arm.load_coupled(&self.robot)
    }
}

impl ArmOptions {
    pub(super) fn selection(&self) -> Selection<'_> {
        Selection {
            base: self.base.as_deref(),
            tip: self.tip.as_deref(),
            weld: self.weld,
            repair: self.repair,
            link_mass: self.link_mass,
        }
    }

    /// The arm called `name`, with its notes.
    ///
    /// Errors: of the description; a list of another length than the joints.
    pub(super) fn import(&self, name: &str) -> Result<(Robot, Vec<String>), Failure> {
        let mut import = Robot::load_selected(name, &self.selection())?;
        if let Some(called) = &self.called {
            if !Robot::is_name(called) {
                bail!("--name {called}: {}", Robot::NAME_FORM);
            }
            import.robot.name.clone_from(called);
        }
        // Name of the value in a description, and its place.
        type Place = (&'static str, fn(&mut Joint) -> &mut f64);
        let rotor: Place = ("rotor_inertia_kg_m2", |joint| {
            &mut joint.drive.rotor_inertia
        });
        let torque: Place = ("torque_nm", |joint| &mut joint.limits.torque);
        let velocity: Place = ("velocity_rad_s", |joint| &mut joint.limits.velocity);
        let gain: Place = ("gain_nm_a", |joint| joint.drive.gain.insert(1.0));
        let friction: Place = ("coulomb_nm", |joint| &mut joint.friction.coulomb);
        let places = [
            ("--rotor-inertia", &self.rotor_inertia, rotor),
            ("--torque-limits", &self.torque_limits, torque),
            ("--velocity-limits", &self.velocity_limits, velocity),
            ("--drive-gains", &self.drive_gains, gain),
            ("--friction", &self.friction, friction),
        ];
        let joints = import.robot.joint_count();
        for (option, values, (field, place)) in places {
            let (found, count) = (values.len(), joint_count(joints));
            if ![0, 1, joints].contains(&found) {
                bail!("{option} has {found} values, the arm has {count}");
            }
            for (joint, value) in (0..joints).zip(values.iter().cycle()) {
                import.give(joint, field, |joint| *place(joint) = *value);
            }
        }
        let mut notes = import.notes();
        notes.extend(inflated_limits(&import.robot));
        Ok((import.robot, notes))
    }

    /// The arm called `name`, of which each drive turns one joint; its notes are printed.
    pub(super) fn load(&self, name: &str) -> Result<Robot, Failure> {
        let robot = self.load_coupled(name)?;
        if robot.coupling.is_some() {
            bail!(
                "{name}: coupled joints are for describe, excite, simulate, identify and torque only; take the description without its [coupling]"
            );
        }
        Ok(robot)
    }

    /// The arm called `name`, which may have coupled joints; its notes are printed.
    pub(super) fn load_coupled(&self, name: &str) -> Result<Robot, Failure> {
        let (robot, notes) = self.import(name)?;
        for note in &notes {
            show!("note: {note}")?;
        }
        Ok(robot)
    }
}

/// A number of joints in words.
pub(super) fn joint_count(count: usize) -> String {
    format!("{count} joint{}", if count == 1 { "" } else { "s" })
}

/// Largest torque limit without a note, in units of what moves the links and a payload as heavy as the arm. Arms carry less than
/// they weigh.
const INFLATED: f64 = 10.0;

/// A note for each torque limit that looks like a placeholder.
fn inflated_limits(robot: &Robot) -> Vec<String> {
    let payload = Link {
        mass: robot.joints.iter().map(|joint| joint.link.mass).sum(),
        com: nalgebra::Vector3::new(RATED_COM_DISTANCE.into(), 0.0, 0.0),
        inertia_com: nalgebra::Matrix3::zeros(),
    };
    let needs = RigidBodies::new(robot)
        .with_payload(&payload)
        .largest_torques();
    let joints = robot.joints.iter().zip(needs.iter());
    let inflated = joints.filter(|(joint, need)| joint.limits.torque > INFLATED * **need);
    let notes = inflated.map(|(joint, need)| {
        let (name, limit) = (&joint.name, joint.limits.torque);
        format!("joint '{name}': its torque limit of {limit} N·m is more than {INFLATED} times the {need:.2} N·m that move the arm with its own mass as payload: a placeholder? correct it (--torque-limits)")
    });
    notes.collect()
}

/// `robot` with a rotor at every joint; a note names those that its description has not.
pub(super) fn with_rotors(robot: &Robot) -> Result<Robot, Failure> {
    let (robot, assumed) = robot.with_assumed_rotors();
    if !assumed.is_empty() {
        show!(
            "note: rotor inertias are not described at joints {assumed:?}: torque limit / 200 rad/s² is assumed"
        )?;
    }
    Ok(robot)
}
