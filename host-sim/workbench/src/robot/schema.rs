//! The description file as TOML: what is read and what is written, units in the names of the fields.

use super::{Drive, Friction, Limits, LogColumns, Workspace};
use serde::{Deserialize, Serialize};

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RobotFile {
    pub(super) name: String,
    #[serde(default = "earth")]
    pub(super) gravity_m_s2: [f64; 3],
    pub(super) joints: Vec<JointFile>,
    pub(super) flange: Option<FrameFile>,
    #[serde(skip_serializing)]
    pub(super) tool: Option<ToolFile>,
    pub(super) log_columns: Option<LogColumns>,
    #[serde(default)]
    pub(super) workspace: Workspace,
}

/// Ends and radius in the frame of the link's mass distribution.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CapsuleFile {
    pub(super) from_m: [f64; 3],
    pub(super) to_m: [f64; 3],
    pub(super) radius_m: f64,
}

/// Tool bolted to the flange, in the flange's frame. Becomes part of the last link.
#[derive(Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ToolFile {
    pub(super) mass_kg: f64,
    pub(super) com_m: [f64; 3],
    pub(super) inertia_kg_m2: InertiaFile,
    #[serde(default)]
    pub(super) capsules: Vec<CapsuleFile>,
}

fn earth() -> [f64; 3] {
    [0.0, 0.0, -9.81]
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JointFile {
    pub(super) name: String,
    pub(super) dh: Option<DhFile>,
    pub(super) frame: Option<FrameFile>,
    pub(super) link: LinkFile,
    pub(super) drive: Drive,
    pub(super) friction: Friction,
    pub(super) limits: Limits,
    #[serde(default)]
    pub(super) capsules: Vec<CapsuleFile>,
}

/// A standard Denavit–Hartenberg row, `T = Rz(q) Tz(d) Tx(a) Rx(alpha)`.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DhFile {
    pub(super) d_m: f64,
    pub(super) a_m: f64,
    pub(super) alpha_rad: f64,
}

/// Joint frame in the frame before it, roll–pitch–yaw about fixed axes: `R = Rz(yaw) Ry(pitch) Rx(roll)`.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameFile {
    pub(super) xyz_m: [f64; 3],
    pub(super) rpy_rad: [f64; 3],
}

/// Mass distribution in the DH frame of the link, or in the joint frame where the joint is given by a `frame`.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LinkFile {
    pub(super) mass_kg: f64,
    pub(super) com_m: [f64; 3],
    pub(super) inertia_kg_m2: InertiaFile,
}

#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InertiaFile {
    pub(super) xx: f64,
    pub(super) yy: f64,
    pub(super) zz: f64,
    #[serde(default)]
    pub(super) xy: f64,
    #[serde(default)]
    pub(super) xz: f64,
    #[serde(default)]
    pub(super) yz: f64,
}
