//! From a name or a file to a robot, and back; overlays, TOML files with what a URDF or MJCF does not have.

use super::file::{
    self, CapsuleFile, DhFile, FrameFile, InertiaFile, JointFile, LinkFile, RobotFile,
};
use super::{Joint, Link, Placement, Robot};
use crate::Refusal;
use crate::files::{from_toml, read_text};
use crate::urdf::{self, Import, Selection};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Key that makes a description an overlay.
const FROM: &str = "from";

#[derive(Deserialize, Serialize)]
struct OverlayFile {
    /// File that the overlay completes, as seen from its own directory, or a built-in name.
    from: String,
    base: Option<String>,
    tip: Option<String>,
    #[serde(default)]
    weld: bool,
    #[serde(default)]
    repair: bool,
    link_mass_kg: Option<f64>,
    #[serde(flatten)]
    values: Table,
}

/// Values of a joint that a URDF does not have, or has not for all purposes, after its name.
const OVERLAID: [&str; 4] = ["name", "drive", "friction", "limits"];

/// Descriptions that need no file, by name.
const BUILT_IN: [(&str, &str); 2] = [
    ("ur5", include_str!("../../../robots/ur5.toml")),
    ("panda", include_str!("../../../robots/panda.urdf")),
];

impl Robot {
    /// Names of the robots that need no file.
    pub fn built_in() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// A built-in robot by name, or a description or URDF file by path.
    ///
    /// Errors: a line that names the file and the field.
    ///
    /// ```
    /// let ur5 = foretorque_description::robot::Robot::load("ur5").unwrap();
    /// assert_eq!(ur5.joints.len(), 6);
    /// ```
    pub fn load(name_or_path: &str) -> Result<Self, Refusal> {
        Ok(Self::load_selected(name_or_path, &Selection::default())?.robot)
    }

    /// [`load`](Self::load) with the selection of a URDF's arm, and the notes of its reading.
    ///
    /// Errors: as there.
    pub fn load_selected(name_or_path: &str, selection: &Selection<'_>) -> Result<Import, Refusal> {
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse_selected(name, text, selection);
        }
        let text = read_text(Path::new(name_or_path)).map_err(|error| {
            let known = Self::built_in().collect::<Vec<_>>().join(", ");
            Refusal(format!(
                "unknown robot '{name_or_path}': not one of [{known}], and as a file: {error}"
            ))
        })?;
        Self::parse_selected(name_or_path, &text, selection)
    }

    /// A robot from the text of a description or of a URDF with a single arm; `file` is used in messages, and its directory
    /// for files that the text names.
    ///
    /// Errors: a line that names the file and the field.
    pub fn parse(file: &str, text: &str) -> Result<Self, Refusal> {
        Ok(Self::parse_selected(file, text, &Selection::default())?.robot)
    }

    fn parse_selected(
        file: &str,
        text: &str,
        selection: &Selection<'_>,
    ) -> Result<Import, Refusal> {
        // TOML never begins with '<', XML always does; the ending of its name decides for an empty file.
        let named = Path::new(file).extension();
        let is_xml =
            named.is_some_and(|named| ["urdf", "xml", "xacro"].iter().any(|x| named == *x));
        if is_xml || text.trim_start().starts_with('<') {
            return urdf::parse(file, text, selection);
        }
        if let Some(import) = read(file, text, selection)? {
            return Ok(import);
        }
        if *selection != Selection::default() {
            let problem =
                "--base, --tip, --weld, --repair and --link-mass are for URDF and MJCF files";
            return Err(Refusal::of(file, problem));
        }
        Ok(Import {
            robot: file::parse(file, text)?,
            notes: Vec::new(),
        })
    }

    /// The description file of this robot, which [`Robot::parse`] reads back to rounding. Joints that came with a
    /// Denavit–Hartenberg row keep it, and their links stand in its frame; all others are given by their joint frames.
    ///
    /// Errors: those of the serialiser.
    ///
    /// ```
    /// use foretorque_description::robot::Robot;
    /// let ur5 = Robot::load("ur5").unwrap();
    /// let again = Robot::parse("again", &ur5.to_toml().unwrap()).unwrap();
    /// assert!((again.joints[2].link.com - ur5.joints[2].link.com).amax() < 1e-15);
    /// ```
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(&self.to_file())
    }

    fn to_file(&self) -> RobotFile {
        let mut joints = Vec::with_capacity(self.joints.len());
        let mut link_end = Placement::identity();
        for joint in &self.joints {
            let here = link_end.inverse().then(&joint.placement);
            joints.push(joint_file(joint, &here));
            link_end = joint.dh_frame.unwrap_or_else(Placement::identity);
        }
        let names: Vec<&str> = self.joints.iter().map(|j| j.name.as_str()).collect();
        let flange = link_end.inverse().then(&self.flange).snapped();
        RobotFile {
            name: self.name.clone(),
            gravity_m_s2: self.gravity.into(),
            link_names: self.link_names.clone(),
            joints,
            // Part of the last link by now.
            tool: None,
            flange: (flange != Placement::identity()).then(|| frame_file(&flange)),
            coupling: self.coupling.as_ref().map(|coupling| coupling.file(&names)),
            log_columns: self.log_columns.clone(),
            workspace: self.workspace,
        }
    }

    /// Files of a description: that at `path`, and in turn those that overlays complete, up to one beyond the longest chain.
    pub fn files(path: &Path) -> Vec<PathBuf> {
        let mut files = vec![path.to_owned()];
        while files.len() <= CHAIN {
            let text = files.last().and_then(|path| read_text(path).ok());
            let table = text.and_then(|text| text.parse::<Table>().ok());
            let from = table.as_ref().and_then(|table| table.get(FROM)?.as_str());
            let next = from
                .zip(files.last())
                .map(|(from, path)| path.with_file_name(from));
            let Some(next) = next else { break };
            files.push(next);
        }
        files
    }

    /// An overlay on `from` with every drive, friction and limit of this robot: a start for values of one's own.
    ///
    /// * `selection` by which this robot was read
    ///
    /// Errors: those of the serialiser.
    pub fn to_overlay(
        &self,
        from: &str,
        selection: &Selection<'_>,
    ) -> Result<String, toml::ser::Error> {
        let mut joints = Vec::new();
        for joint in self.to_file().joints {
            let mut values = Table::try_from(joint)?;
            values.retain(|name, _| OVERLAID.contains(&name));
            joints.push(Value::Table(values));
        }
        toml::to_string(&OverlayFile {
            from: from.to_owned(),
            base: selection.base.map(str::to_owned),
            tip: selection.tip.map(str::to_owned),
            weld: selection.weld,
            repair: selection.repair,
            link_mass_kg: selection.link_mass,
            values: Table::from_iter([("joints".to_owned(), Value::Array(joints))]),
        })
    }
}

/// The arm of the overlay `text` in the file `path`; `None` where that is a whole description.
///
/// The file that it names is read first; values of the overlay take the place of those found there, joint by joint.
///
/// * `selection` wins over that of the overlay
pub(super) fn read(
    path: &str,
    text: &str,
    selection: &Selection<'_>,
) -> Result<Option<Import>, Refusal> {
    let table = text.parse::<Table>();
    if !table.is_ok_and(|table| table.contains_key(FROM)) {
        return Ok(None);
    }
    let overlay: OverlayFile = from_toml(text).map_err(|problem| Refusal::of(path, problem))?;
    let field = |field: &str, problem: String| Refusal::of(path, format!("{field}: {problem}"));
    let bad_mass = |mass: f64| mass.is_nan() || mass <= 0.0;
    if overlay.link_mass_kg.is_some_and(bad_mass) {
        return Err(field("link_mass_kg", "must be positive".to_owned()));
    }
    let selection = Selection {
        base: selection.base.or(overlay.base.as_deref()),
        tip: selection.tip.or(overlay.tip.as_deref()),
        weld: selection.weld || overlay.weld,
        repair: selection.repair || overlay.repair,
        link_mass: selection.link_mass.or(overlay.link_mass_kg),
    };
    let beside = Path::new(path).with_file_name(&overlay.from);
    if Robot::files(&beside).len() > CHAIN {
        let problem = format!("the files that it names lead to no description in {CHAIN} steps");
        return Err(field(FROM, problem));
    }
    let built_in = Robot::built_in().any(|name| name == overlay.from) && !beside.exists();
    let below = match built_in {
        true => overlay.from,
        false => beside.display().to_string(),
    };
    let import = Robot::load_selected(&below, &selection)?;
    let robot = merged(path, &import.robot, overlay.values, &field)?;
    Ok(Some(Import { robot, ..import }))
}

/// Longest chain of overlays.
const CHAIN: usize = 16;

/// `robot` with the values of `overlay`.
fn merged(
    path: &str,
    robot: &Robot,
    mut overlay: Table,
    field: &dyn Fn(&str, String) -> Refusal,
) -> Result<Robot, Refusal> {
    let unreadable = |reason: String| Refusal::of(path, reason);
    let whole = Table::try_from(robot.to_file());
    let mut whole = whole.map_err(|error| unreadable(error.to_string()))?;
    let joints = match overlay.remove("joints") {
        None => Vec::new(),
        Some(Value::Array(joints)) => joints,
        Some(_) => return Err(field("joints", "must be [[joints]] with names".to_owned())),
    };
    let names: Vec<&str> = robot.joints.iter().map(|j| j.name.as_str()).collect();
    let mut seen = vec![false; names.len()];
    let mut limited = vec![false; names.len()];
    for (index, joint) in joints.into_iter().enumerate() {
        let at = format!("joints[{index}].name");
        let name = joint.get("name").and_then(Value::as_str);
        let place = names.iter().position(|known| Some(*known) == name);
        let Some(place) = place else {
            let (name, names) = (name.unwrap_or_default(), names.join(", "));
            return Err(field(&at, format!("'{name}' is not one of {names}")));
        };
        if std::mem::replace(&mut seen[place], true) {
            return Err(field(&at, "comes twice".to_owned()));
        }
        limited[place] = joint.get("limits").is_some_and(|limits| {
            let there = |key: &str| limits.get(key).is_some();
            there("position_rad") && there("velocity_rad_s") && there("torque_nm")
        });
        let own = whole.get_mut("joints").and_then(|own| own.get_mut(place));
        if let (Some(Value::Table(own)), Value::Table(joint)) = (own, joint) {
            put(own, joint);
        }
    }
    put(&mut whole, overlay);
    let read = Value::Table(whole).try_into();
    let read = read.map_err(|error: toml::de::Error| unreadable(error.message().to_owned()));
    let mut merged = file::read(path, read?)?;
    for (index, (joint, before)) in merged.joints.iter_mut().zip(&robot.joints).enumerate() {
        joint.link_frame = before.link_frame;
        let couples = |coupling: &super::Coupling| coupling.couples(index);
        if merged.coupling.as_ref().is_some_and(couples) && !limited[index] {
            let name = &joint.name;
            let problem = format!(
                "joint '{name}' needs limits of its drive: limits = {{ position_rad, velocity_rad_s, torque_nm }}"
            );
            return Err(field("coupling", problem));
        }
    }
    Ok(merged)
}

/// Puts the values of `overlay` in the place of those of `whole`, table by table.
fn put(whole: &mut Table, overlay: Table) {
    for (key, value) in overlay {
        match (whole.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(value)) => put(inner, value),
            (_, value) => {
                whole.insert(key, value);
            }
        }
    }
}

/// * `here` joint frame in the end frame of the link before
fn joint_file(joint: &Joint, here: &Placement) -> JointFile {
    let end = joint.dh_frame.unwrap_or_else(Placement::identity);
    let in_end = end.inverse();
    let link = joint.link.placed(&in_end);
    let capsule_end = |point: &Vector3<f64>| -> [f64; 3] { in_end.point(point).into() };
    JointFile {
        name: joint.name.clone(),
        link_name: joint.link_name.clone(),
        dh: joint.dh_frame.map(|end| DhFile {
            d_m: here.origin.z,
            a_m: end.origin.x,
            alpha_rad: end.rot_parent_child.m32.atan2(end.rot_parent_child.m22),
        }),
        frame: joint.dh_frame.is_none().then(|| frame_file(here)),
        link: link_file(&link),
        drive: joint.drive,
        friction: joint.friction,
        limits: joint.limits,
        capsules: joint
            .capsules
            .iter()
            .map(|capsule| CapsuleFile {
                from_m: capsule_end(&capsule.ends[0]),
                to_m: capsule_end(&capsule.ends[1]),
                radius_m: capsule.radius,
            })
            .collect(),
    }
}

fn frame_file(frame: &Placement) -> FrameFile {
    FrameFile {
        xyz_m: frame.origin.into(),
        rpy_rad: frame.rpy().into(),
    }
}

fn link_file(link: &Link) -> LinkFile {
    let i = &link.inertia_com;
    LinkFile {
        mass_kg: link.mass,
        com_m: link.com.into(),
        inertia_kg_m2: InertiaFile {
            xx: i.m11,
            yy: i.m22,
            zz: i.m33,
            xy: i.m12,
            xz: i.m13,
            yz: i.m23,
        },
    }
}
