//! The description file: TOML, units in the names of the fields.

use super::body::{Coupling, CouplingFile};
use super::{
    Capsule, Drive, Friction, Joint, Limits, Link, LogColumns, MAX_JOINTS, Placement, Robot,
    Workspace, angle_problem,
};
use crate::Refusal;
use crate::files::toml_problem;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use toml::Spanned;
use toml::de::{DeTable, Deserializer};

/// Beyond the gravity of every planet, m/s²: more is in another unit.
const MOST_GRAVITY_M_S2: f64 = 30.0;

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RobotFile {
    pub(super) name: String,
    #[serde(default = "earth")]
    pub(super) gravity_m_s2: [f64; 3],
    /// Links at both ends, for files of other formats.
    pub(super) link_names: Option<(String, String)>,
    pub(super) joints: Vec<JointFile>,
    pub(super) flange: Option<FrameFile>,
    #[serde(skip_serializing)]
    pub(super) tool: Option<ToolFile>,
    pub(super) coupling: Option<CouplingFile>,
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

/// Tool at the flange, in the flange's frame. Becomes part of the last link.
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
    pub(super) link_name: Option<String>,
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

/// Fields of an overlay alone.
pub(super) const OF_OVERLAY: [&str; 6] = ["from", "base", "tip", "weld", "repair", "link_mass_kg"];

/// The tables of a description, with their places in `text`.
pub(super) fn tables<'a>(file: &str, text: &'a str) -> Result<Spanned<DeTable<'a>>, Refusal> {
    DeTable::parse(text).map_err(|error| Refusal::of(file, toml_problem(text, &error)))
}

/// Checks and converts a description.
///
/// * `tables` those of the `text`, or of an overlay with all that it completes
pub(super) fn read(file: &str, text: &str, tables: Spanned<DeTable<'_>>) -> Result<Robot, Refusal> {
    let raw = RobotFile::deserialize(Deserializer::from(tables)).map_err(|error| {
        let own = DeTable::parse(text).map(Spanned::into_inner);
        let own = own.unwrap_or_default();
        let is_unknown = own.keys().any(|key| Some(key.span()) == error.span());
        let more = match is_unknown {
            true => format!(", in an overlay also `{}`", OF_OVERLAY.join("`, `")),
            false => String::new(),
        };
        Refusal::of(file, toml_problem(text, &error) + &more)
    })?;
    let check = Check {
        file,
        place: String::new(),
    };
    check.that(Robot::is_name(&raw.name), "name", Robot::NAME_FORM)?;
    check.finite("gravity_m_s2", &raw.gravity_m_s2)?;
    let gravity = Vector3::from(raw.gravity_m_s2);
    let wrong = format!("is more than any planet's, {MOST_GRAVITY_M_S2} m/s²");
    check.that(gravity.norm() <= MOST_GRAVITY_M_S2, "gravity_m_s2", &wrong)?;
    let count = raw.joints.len();
    let wrong = format!("{count} joints, must be 1 to {MAX_JOINTS}");
    check.that((1..=MAX_JOINTS).contains(&count), "joints", &wrong)?;
    let flange = raw.flange.as_ref();
    let flange = flange.map(|frame| placement_of_frame(frame, &check, "flange"));
    let flange = flange.transpose()?;
    let mut joints = Vec::with_capacity(raw.joints.len());
    // The part of the previous link's DH row that precedes this joint's rotation.
    let mut link_end = Placement::identity();
    for (index, joint) in raw.joints.iter().enumerate() {
        let check = check.inside(&format!("joints[{index}]."));
        let mut before = raw.joints.iter().take(index);
        let is_new = before.all(|other| other.name != joint.name);
        check.that(is_new, "name", "comes twice")?;
        let (placement, end) = match (&joint.dh, &joint.frame) {
            (Some(dh), None) => {
                check.finite("dh", &[dh.d_m, dh.a_m])?;
                check.angles("dh.alpha_rad", &[dh.alpha_rad])?;
                let placement = Placement {
                    origin: link_end.point(&Vector3::new(0.0, 0.0, dh.d_m)),
                    ..link_end
                };
                // `Tx(a) Rx(alpha)`, from Craig's frame to the DH frame, belongs to the link.
                let along_x = |x| Vector3::new(x, 0.0, 0.0);
                let end = Placement::from_xyz_rpy(along_x(dh.a_m), along_x(dh.alpha_rad));
                (placement, end)
            }
            (None, Some(frame)) => {
                let here = placement_of_frame(frame, &check, "frame")?;
                (link_end.then(&here), Placement::identity())
            }
            _ => return Err(check.error("dh", "give exactly one of 'dh' and 'frame'")),
        };
        let link = &joint.link;
        let link = (link.mass_kg, link.com_m, link.inertia_kg_m2);
        let link = link_in_craig_frame(link, &end, &check.inside("link."))?;
        check_numbers(joint, &check)?;
        joints.push(Joint {
            name: joint.name.clone(),
            placement,
            link,
            drive: joint.drive,
            friction: joint.friction,
            limits: joint.limits,
            capsules: capsules(&joint.capsules, &end, &check)?,
            link_name: joint.link_name.clone(),
            link_frame: Placement::identity(),
            dh_frame: joint.dh.is_some().then_some(end),
        });
        link_end = end;
    }
    let flange = flange.map_or(link_end, |flange| link_end.then(&flange));
    if let (Some(tool), Some(last)) = (&raw.tool, joints.last_mut()) {
        let check = check.inside("tool.");
        let body = (tool.mass_kg, tool.com_m, tool.inertia_kg_m2);
        let body = link_in_craig_frame(body, &flange, &check)?;
        last.link = Link::lumped(&[last.link, body]).unwrap_or(last.link);
        last.capsules
            .extend(capsules(&tool.capsules, &flange, &check)?);
    }
    let table = raw.workspace.table_height.unwrap_or_default();
    check.finite("workspace.table_height_m", &[table])?;
    check.sign("workspace.clearance_m", raw.workspace.clearance, false)?;
    let names: Vec<&str> = joints.iter().map(|joint| joint.name.as_str()).collect();
    let coupling = raw.coupling.as_ref();
    let coupling = coupling.map(|file| Coupling::new(file, &names)).transpose();
    let coupling = coupling.map_err(|problem| check.error("coupling", &problem))?;
    Ok(Robot {
        coupling,
        workspace: raw.workspace,
        name: raw.name,
        gravity,
        joints,
        flange,
        link_names: raw.link_names,
        log_columns: raw.log_columns,
    })
}

fn placement_of_frame(
    frame: &FrameFile,
    check: &Check<'_>,
    field: &str,
) -> Result<Placement, Refusal> {
    check.finite(field, &frame.xyz_m)?;
    check.angles(&format!("{field}.rpy_rad"), &frame.rpy_rad)?;
    let (xyz, rpy) = (frame.xyz_m.into(), frame.rpy_rad.into());
    Ok(Placement::from_xyz_rpy(xyz, rpy))
}

/// * `i` tensor about the centre of mass
fn link_in_craig_frame(
    (mass, com, i): (f64, [f64; 3], InertiaFile),
    end: &Placement,
    check: &Check<'_>,
) -> Result<Link, Refusal> {
    check.sign("mass_kg", mass, true)?;
    check.finite("com_m", &com)?;
    check.finite("inertia_kg_m2", &[i.xx, i.yy, i.zz, i.xy, i.xz, i.yz])?;
    let inertia = Matrix3::new(i.xx, i.xy, i.xz, i.xy, i.yy, i.yz, i.xz, i.yz, i.zz);
    if let Some(problem) = Link::inertia_problem(&inertia) {
        return Err(check.error("inertia_kg_m2", problem));
    }
    let in_dh_frame = Link {
        mass,
        com: com.into(),
        inertia_com: inertia,
    };
    Ok(in_dh_frame.placed(end))
}

fn check_numbers(joint: &JointFile, check: &Check<'_>) -> Result<(), Refusal> {
    let (drive, friction, limits) = (&joint.drive, &joint.friction, &joint.limits);
    let (stribeck_velocity, cycles) = (friction.stribeck_velocity, friction.cogging_cycles_rev);
    for (field, value, positive) in [
        ("drive.rotor_inertia_kg_m2", drive.rotor_inertia, false),
        ("drive.gain_nm_a", drive.gain.unwrap_or(1.0), true),
        ("friction.viscous_nm_s_rad", friction.viscous, false),
        ("friction.coulomb_nm", friction.coulomb, false),
        ("friction.stribeck_ratio", friction.stribeck_ratio, false),
        ("friction.stribeck_velocity_rad_s", stribeck_velocity, true),
        ("friction.cogging_nm", friction.cogging, false),
        ("friction.cogging_cycles_rev", cycles, false),
        ("limits.velocity_rad_s", limits.velocity, true),
        ("limits.acceleration_rad_s2", limits.acceleration, true),
        ("limits.torque_nm", limits.torque, true),
    ] {
        check.sign(field, value, positive)?;
    }
    let bits = (8..=32).contains(&drive.encoder_bits);
    check.that(bits, "drive.encoder_bits", "must be 8 to 32")?;
    let (lower, upper) = limits.position;
    let field = "limits.position_rad";
    check.finite(field, &[lower, upper])?;
    check.that(lower < upper, field, "lower end must be below upper end")
}

fn capsules(
    capsules: &[CapsuleFile],
    end: &Placement,
    check: &Check<'_>,
) -> Result<Vec<Capsule>, Refusal> {
    capsules
        .iter()
        .map(|capsule| {
            check.finite("capsules", &capsule.from_m)?;
            check.finite("capsules", &capsule.to_m)?;
            check.sign("capsules.radius_m", capsule.radius_m, true)?;
            let ends = [capsule.from_m, capsule.to_m];
            Ok(Capsule {
                ends: ends.map(|point| end.point(&point.into())),
                radius: capsule.radius_m,
            })
        })
        .collect()
}

/// Turns a violated condition into an error that names file and field.
struct Check<'a> {
    file: &'a str,
    /// Names of the tables around the field, each with a point behind it.
    place: String,
}

impl Check<'_> {
    /// The check of the fields of `table`.
    fn inside(&self, table: &str) -> Self {
        Self {
            file: self.file,
            place: format!("{}{table}", self.place),
        }
    }

    fn error(&self, field: &str, problem: &str) -> Refusal {
        Refusal::of(self.file, format!("{}{field}: {problem}", self.place))
    }

    fn that(&self, condition: bool, field: &str, problem: &str) -> Result<(), Refusal> {
        if condition {
            Ok(())
        } else {
            Err(self.error(field, problem))
        }
    }

    fn finite(&self, field: &str, values: &[f64]) -> Result<(), Refusal> {
        self.that(
            values.iter().all(|&value| fits_board(value)),
            field,
            "is not a finite number of 32 bits",
        )
    }

    fn angles(&self, field: &str, values: &[f64]) -> Result<(), Refusal> {
        let problem = angle_problem(values);
        problem.map_or(Ok(()), |problem| Err(self.error(field, problem)))
    }

    /// A finite value is `positive`, or at least not negative.
    fn sign(&self, field: &str, value: f64, positive: bool) -> Result<(), Refusal> {
        let (fits, bound) = match positive {
            true => (value > 0.0, "must be positive"),
            false => (value >= 0.0, "must not be negative"),
        };
        self.that(fits, field, &format!("is {value}, {bound}"))?;
        self.finite(field, &[value])
    }
}

/// The board's numbers have 32 bits, and the sum of some torques must fit, too.
pub(crate) fn fits_board(value: f64) -> bool {
    value.abs() < f64::from(f32::MAX / 1e3)
}
