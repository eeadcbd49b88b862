//! From a name or a file to a robot, and back; overlays, TOML files with what a URDF or MJCF does not have.

use super::file::{
    self, CapsuleFile, DhFile, FrameFile, InertiaFile, JointFile, LinkFile, RobotFile,
};
use super::{Joint, Link, Placement, Robot};
use crate::Refusal;
use crate::files::{from_toml, read_text, toml_problem};
use crate::urdf::{self, Import, Selection};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue, ValueDeserializer};
use toml::{Spanned, Table};

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
    #[serde(skip_deserializing)]
    joints: Vec<Table>,
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
        let tables = file::tables(file, text)?;
        if tables.get_ref().contains_key(FROM) {
            return read(file, text, tables, selection);
        }
        if *selection != Selection::default() {
            let problem =
                "--base, --tip, --weld, --repair and --link-mass are for URDF and MJCF files";
            return Err(Refusal::of(file, problem));
        }
        Ok(Import::described(file::read(file, text, tables)?))
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
            joints.push(values);
        }
        toml::to_string(&OverlayFile {
            from: from.to_owned(),
            base: selection.base.map(str::to_owned),
            tip: selection.tip.map(str::to_owned),
            weld: selection.weld,
            repair: selection.repair,
            link_mass_kg: selection.link_mass,
            joints,
        })
    }
}

/// The arm of the overlay `text`, with its `tables`, in the file `path`.
///
/// The file that it names is read first; values of the overlay take the place of those found there, joint by joint.
///
/// * `selection` wins over that of the overlay
fn read(
    path: &str,
    text: &str,
    mut tables: Spanned<DeTable<'_>>,
    selection: &Selection<'_>,
) -> Result<Import, Refusal> {
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
    let whole = import.robot.to_toml();
    let whole = whole.map_err(|error| field(FROM, error.to_string()))?;
    let mut whole = file::tables(&below, &whole)?;
    let own = tables.get_mut();
    for field in file::OF_OVERLAY {
        own.remove(field);
    }
    let names: Vec<&str> = import.robot.joints.iter().map(|j| &*j.name).collect();
    let joints = match own.remove("joints").map(Spanned::into_inner) {
        None => Vec::new(),
        Some(DeValue::Array(joints)) => joints.into_iter().collect(),
        Some(_) => return Err(field("joints", "must be [[joints]] with names".to_owned())),
    };
    let mut given = vec![None; names.len()];
    for (index, joint) in joints.into_iter().enumerate() {
        let at = format!("joints[{index}].name");
        let joint = joint.into_inner();
        let name = joint.get("name").and_then(|name| name.get_ref().as_str());
        let place = names.iter().position(|known| Some(*known) == name);
        let Some(place) = place else {
            let (name, names) = (name.unwrap_or_default(), names.join(", "));
            return Err(field(&at, format!("'{name}' is not one of {names}")));
        };
        if given[place].replace(values(&joint)).is_some() {
            return Err(field(&at, "comes twice".to_owned()));
        }
        let all = whole.get_mut().get_mut("joints").map(Spanned::get_mut);
        let Some(DeValue::Array(all)) = all else {
            continue;
        };
        let all = &mut all.as_mut()[place];
        if let (DeValue::Table(all), DeValue::Table(joint)) = (all.get_mut(), joint) {
            put(all, joint);
        }
        let read = JointFile::deserialize(ValueDeserializer::from(all.clone()));
        read.map_err(|error| {
            let (name, problem) = (names[place], toml_problem(text, &error));
            Refusal::of(path, format!("joint '{name}', {problem}"))
        })?;
    }
    let own = tables.into_inner();
    let gives_gravity = own.contains_key("gravity_m_s2");
    let gives_coupling = own.contains_key("coupling");
    put(whole.get_mut(), own);
    let mut robot = file::read(path, text, whole)?;
    for (index, (joint, before)) in robot
        .joints
        .iter_mut()
        .zip(&import.robot.joints)
        .enumerate()
    {
        joint.link_frame = before.link_frame;
        let couples = |coupling: &super::Coupling| coupling.couples(index);
        let fields = given[index].as_deref().unwrap_or_default();
        let mut needs = ["position_rad", "velocity_rad_s", "torque_nm"].iter();
        let limited = needs.all(|need| fields.iter().any(|field| field == need));
        // A description that has the coupling already has the limits of its drives.
        if gives_coupling && robot.coupling.as_ref().is_some_and(couples) && !limited {
            let name = &joint.name;
            let problem = format!(
                "joint '{name}' needs limits of its drive: limits = {{ position_rad, velocity_rad_s, torque_nm }}"
            );
            return Err(field("coupling", problem));
        }
    }
    Ok(import.overlaid(robot, &given, gives_gravity))
}

/// Longest chain of overlays.
const CHAIN: usize = 16;

/// Names of the values that a joint of an overlay gives.
fn values(joint: &DeValue<'_>) -> Vec<String> {
    let tables = ["link", "drive", "limits"].iter();
    let tables = tables.filter_map(|table| joint.get(*table)?.get_ref().as_table());
    let names = tables.flat_map(|table| table.keys());
    names.map(|name| name.get_ref().to_string()).collect()
}

/// Puts the values of `overlay` in the place of those of `whole`, table by table.
fn put<'a>(whole: &mut DeTable<'a>, overlay: DeTable<'a>) {
    for (key, value) in overlay {
        let inner = whole.get_mut(key.get_ref().as_ref()).map(Spanned::get_mut);
        match (inner, value.get_ref()) {
            (Some(DeValue::Table(inner)), DeValue::Table(value)) => put(inner, value.clone()),
            _ => {
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
