//! A robot from its description file, in the frames of the firmware.
//!
//! Everything here is in Craig's link frames (Craig 2005, section 3.4): z of frame i runs along joint axis i, and frame i
//! is a constant [`Placement`] in frame i−1 followed by `Rz(q_i)`. Standard Denavit–Hartenberg rows are converted once,
//! when the file is read.

mod body;
mod file;
mod geometry;
mod log_columns;
mod overlay;

pub use body::Coupling;
pub(crate) use file::fits_board;
pub use foretorque::arm::LINK_PARAMETERS;
pub use foretorque::dynamics::MAX_JOINTS;
pub use geometry::{Capsule, Placement, TURN, Workspace, angle_problem, segment_distance};
pub use log_columns::{ColumnNames, EffortKind, LOG_SOURCES, LogColumns, Units};

use foretorque::arm::JointLimits;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Mass distribution of one link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass, expressed in and measured from the link frame, m.
    pub com: Vector3<f64>,
    /// Inertia tensor about the centre of mass, expressed in the link frame, kg·m².
    pub inertia_com: Matrix3<f64>,
}

/// The drive of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// Rotor inertia reflected to the link side, kg·m².
    #[serde(rename = "rotor_inertia_kg_m2", default)]
    pub rotor_inertia: f64,
    /// Joint torque a motor current makes, N·m/A; `None` where it is not known.
    #[serde(rename = "gain_nm_a", skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// Resolution of the joint encoder, bits a revolution.
    pub encoder_bits: u32,
}

impl Drive {
    /// Step of the joint encoder, rad.
    pub fn encoder_step(&self) -> f64 {
        TAU / f64::from(self.encoder_bits).exp2()
    }
}

/// True friction of one joint, as the simulated plant has it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Friction {
    /// Viscous coefficient, N·m·s/rad.
    #[serde(rename = "viscous_nm_s_rad")]
    pub viscous: f64,
    /// Coulomb torque, N·m.
    #[serde(rename = "coulomb_nm")]
    pub coulomb: f64,
    /// Stribeck peak above Coulomb, as a share of it.
    #[serde(default)]
    pub stribeck_ratio: f64,
    /// Velocity at which the Stribeck peak has decayed to 1/e, rad/s.
    #[serde(rename = "stribeck_velocity_rad_s", default = "one")]
    pub stribeck_velocity: f64,
    /// Amplitude of the cogging torque, N·m.
    #[serde(rename = "cogging_nm", default)]
    pub cogging: f64,
    /// Cogging periods in one turn of the joint.
    #[serde(default)]
    pub cogging_cycles_rev: f64,
}

impl Friction {
    /// Viscous and Coulomb friction at `qd` rad/s, N·m, with the smooth sign of the board.
    pub fn sliding(&self, qd: f64) -> f64 {
        let sign = (qd / f64::from(foretorque::dynamics::SIGN_WIDTH)).tanh();
        self.viscous * qd + self.coulomb * sign
    }
}

/// Limits of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Lower and upper end of the range, rad.
    #[serde(rename = "position_rad")]
    pub position: (f64, f64),
    /// Largest speed, rad/s.
    #[serde(rename = "velocity_rad_s")]
    pub velocity: f64,
    /// Largest acceleration of trajectories, rad/s².
    #[serde(rename = "acceleration_rad_s2")]
    pub acceleration: f64,
    /// Largest torque, N·m.
    #[serde(rename = "torque_nm")]
    pub torque: f64,
}

impl Limits {
    /// Those of the board, in its precision.
    pub fn of_board(&self) -> JointLimits {
        JointLimits {
            position: (self.position.0 as f32, self.position.1 as f32),
            velocity: self.velocity as f32,
            torque: self.torque as f32,
        }
    }
}

/// One revolute joint and the link it carries.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name from the description.
    pub name: String,
    /// Placement of the joint frame in the frame of the joint before (base frame for the first).
    pub placement: Placement,
    /// The moved link.
    pub link: Link,
    /// The drive.
    pub drive: Drive,
    /// True friction.
    pub friction: Friction,
    /// Limits.
    pub limits: Limits,
    /// Volume of the link, in the joint frame.
    pub capsules: Vec<Capsule>,
    /// Name of the moved link, where the description gives one.
    pub link_name: Option<String>,
    /// Frame of that link in the file it was read from, in the joint frame.
    pub link_frame: Placement,
    /// The standard DH frame of the link, at its far end, in the joint frame; `None` where the description gives no DH row.
    pub dh_frame: Option<Placement>,
}

/// Largest motor current at the torque limit with an assumed gain, A: a board's sample carries up to 512 A.
const CURRENT: f64 = 500.0;

impl Joint {
    /// Drive gain, N·m/A; where it is not known the least power of ten, from 1 N·m/A on, with which a simulated drive stays
    /// within 500 A.
    pub fn gain(&self) -> f64 {
        let least = (self.limits.torque / CURRENT).max(1.0);
        let assumed = || 10.0_f64.powi(least.log10().ceil() as i32);
        self.drive.gain.unwrap_or_else(assumed)
    }
}

/// A serial arm of revolute joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Name, as the firmware's arm carries it.
    pub name: String,
    /// Acceleration of gravity, expressed in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Joints, base to tool.
    pub joints: Vec<Joint>,
    /// Placement of the flange in the last link frame.
    pub flange: Placement,
    /// Names of the link that the arm stands on and of the one that it ends at, where the description gives them.
    pub link_names: Option<(String, String)>,
    /// Drives that turn several joints: positions, velocities, torques, drives, friction and limits of this robot are then those
    /// of its drives, one in the place of each joint.
    pub coupling: Option<Coupling>,
    /// Column names of foreign logs, if the description gives any.
    pub log_columns: Option<LogColumns>,
    /// Obstacles of the arm.
    pub workspace: Workspace,
}

fn one() -> f64 {
    1.0
}

impl Robot {
    /// Form of a name, as refusals give it.
    pub const NAME_FORM: &str =
        "must be lower-case letters, digits and underscores, a letter first";

    /// Whether an arm may be called so: like a Rust module.
    pub fn is_name(name: &str) -> bool {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        name.chars().all(plain) && name.starts_with(|c: char| c.is_ascii_lowercase())
    }

    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// One value for each joint; `None` when the robot has not `N` joints.
    pub fn each<T, const N: usize>(&self, of: impl FnMut(&Joint) -> T) -> Option<[T; N]> {
        let values: Vec<T> = self.joints.iter().map(of).collect();
        values.try_into().ok()
    }

    /// Standard parameters of every link, then the rotor inertia of every joint: 10 N + N values, SI.
    pub fn standard_parameters(&self) -> Vec<f64> {
        let joints = self.joints.iter();
        let links = joints.flat_map(|joint| joint.link.standard_parameters());
        let rotors = self.joints.iter().map(|joint| joint.drive.rotor_inertia);
        links.chain(rotors).collect()
    }
}

#[cfg(test)]
mod tests;
