//! Reads an arm from a URDF or MJCF file.
//!
//! Both are a tree of links; the arm is one path in it, from a base link to a tip link. Joint frames of a URDF are
//! Craig link frames when the joint axis is z; other axes are turned onto z here, without moving the joint's zero.
//! Everything bolted to a moving link by fixed joints becomes part of that link, behind the tip too. What moves beside the
//! path or behind the tip is left out unless it is welded, and listed with its mass in [`Import::notes`].
//! What a file does not give is assumed, and noted unless an overlay or an option gives it.
//!
//! A URDF has no drives, and its friction model is viscous plus Coulomb: rotor inertia is 0, the gain is
//! not known. The base frame is that of the base link, gravity along −z of the root.

mod chain;
mod document;
mod mjcf;
mod tree;
mod write;

pub use write::{mjcf, sdf, write};

use crate::Refusal;
use crate::robot::{Joint, Link, Robot, TURN};
use nalgebra::Matrix3;
use std::collections::{BTreeSet, HashSet};
use std::f64::consts::PI;
use std::path::Path;

/// Default of a property that a URDF does not have.
const ENCODER_BITS: u32 = 17;
const ACCELERATION: f64 = 10.0;
const VELOCITY: f64 = 2.0;
/// Torque limit where the file gives none, in units of the weight at full stretch with friction and rotor at their largest, and
/// added to it, N·m.
const TORQUE: (f64, f64) = (1.5, 1.0);
/// Largest share of a torque limit that friction takes at the velocity limit.
const FRICTION_SHARE: f64 = 0.75;
/// Speed beyond which no drive of an arm turns, rad/s: the fastest without a gear reach 45.
const FAST: f64 = 50.0;
/// Largest radius of gyration without a note, in units of the link's length; those of the Panda have up to two.
const WIDE: f64 = 3.0;
/// Largest distance of a centre of mass from its joint without a note, in units of the link's length.
const FAR: f64 = 2.0;
/// Thickness of a link, m: that of an assumed rod.
const THICKNESS: f64 = 0.1;

/// Which path of the tree is the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Selection<'a> {
    /// Link the arm stands on, or the joint that leaves it; the root of the tree when not given.
    pub base: Option<&'a str>,
    /// Link the arm ends at, or the joint that moves it. Without it the arm ends where only fixed, prismatic or mimic
    /// joints and fingers follow.
    pub tip: Option<&'a str>,
    /// Bodies beyond moving joints beside the path are part of the link that carries them, at their zero.
    pub weld: bool,
    /// Inertias that no body has are moved to the nearest one that a body has.
    pub repair: bool,
    /// Mass of a link without inertial data, kg; such links are refused without it.
    pub link_mass: Option<f64>,
}

/// An arm, and what is assumed for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Import {
    /// The arm.
    pub robot: Robot,
    /// One sentence for each part of the file that is left out or changed.
    parts: Vec<String>,
    /// Assumptions on each joint.
    assumed: Vec<Assumed>,
    /// Gravity of the root is turned into the frame of the base.
    tilted: bool,
}

/// Values of a joint that are assumed, and values of its file to be checked, until an overlay or an option gives them.
#[derive(Clone, Debug, Default, PartialEq)]
struct Assumed {
    /// Values that no source gives, by their names in a description.
    fields: BTreeSet<&'static str>,
    /// Velocity limit before friction lowers it, rad/s.
    velocity: Option<f64>,
    /// Distance of the link's own centre of mass from the joint, m.
    com: Option<f64>,
    /// Inertia of the link itself, kg·m², where it is the same about all axes.
    isotropic: Option<Matrix3<f64>>,
}

impl Assumed {
    /// Nothing assumed, for a link as it is written.
    fn of_written(link: Option<&Link>) -> Self {
        let inertia = link.map(|link| link.inertia_com);
        let is_isotropic = |i: &Matrix3<f64>| near(i, &Matrix3::from_diagonal_element(i.m11));
        Self {
            com: link.map(|link| link.com.norm()),
            isotropic: inertia.filter(is_isotropic),
            ..Self::default()
        }
    }

    /// Takes the value `field` as given.
    fn give(&mut self, field: &str) {
        self.fields.remove(field);
        match field {
            "velocity_rad_s" => self.velocity = None,
            "com_m" => self.com = None,
            "inertia_kg_m2" => self.isotropic = None,
            _ => {}
        }
    }
}

/// Two inertias are the same but for rounding.
fn near(a: &Matrix3<f64>, b: &Matrix3<f64>) -> bool {
    (a - b).amax() <= 1e-9 * a.amax()
}

impl Import {
    /// An arm whose description gives every value.
    pub(crate) fn described(robot: Robot) -> Self {
        Self {
            assumed: vec![Assumed::default(); robot.joint_count()],
            robot,
            parts: Vec::new(),
            tilted: false,
        }
    }

    /// Gives the value `field` of a joint, called as in a description, by `change`: it is no longer assumed, and what was
    /// derived from it follows.
    pub fn give(&mut self, joint: usize, field: &str, change: impl FnOnce(&mut Joint)) {
        self.robot.joints.get_mut(joint).map(change);
        if let Some(assumed) = self.assumed.get_mut(joint) {
            assumed.give(field);
        }
        self.derive_limits();
    }

    /// This import with the values of an overlay.
    ///
    /// * `robot` the arm with all of them
    /// * `given` their names, joint by joint
    /// * `gives_gravity` gravity is one of them
    pub(crate) fn overlaid(
        mut self,
        robot: Robot,
        given: &[Option<Vec<String>>],
        gives_gravity: bool,
    ) -> Self {
        self.robot = robot;
        self.tilted &= !gives_gravity;
        for (assumed, fields) in self.assumed.iter_mut().zip(given) {
            let fields = fields.iter().flatten();
            fields.for_each(|field| assumed.give(field));
        }
        self.derive_limits();
        self
    }

    /// Computes the assumed values that depend on others.
    ///
    /// A torque limit is one and a half of what the arm weighs at full stretch, of friction at the velocity limit and of the
    /// rotor at the acceleration limit, and 1 N·m. A velocity limit is lowered to one that friction leaves torque for.
    fn derive_limits(&mut self) {
        let joints = &mut self.robot.joints;
        for (index, assumed) in self.assumed.iter().enumerate() {
            let wanted = assumed.velocity.unwrap_or(joints[index].limits.velocity);
            joints[index].limits.velocity = wanted;
            let (mut lever, mut weight) = (0.0, 0.0);
            for (place, joint) in joints.iter().enumerate().skip(index) {
                if place > index {
                    lever += joint.placement.origin.norm();
                }
                weight += 9.81 * joint.link.mass * (lever + joint.link.com.norm());
            }
            let Joint {
                drive,
                friction,
                limits,
                ..
            } = &mut joints[index];
            if assumed.fields.contains("torque_nm") {
                let own = friction.coulomb
                    + friction.viscous * limits.velocity
                    + drive.rotor_inertia * limits.acceleration;
                limits.torque = (TORQUE.0 * (weight + own) + TORQUE.1).ceil();
            }
            let reached = (FRICTION_SHARE * limits.torque - friction.coulomb) / friction.viscous;
            if assumed.velocity.is_some() && reached > 0.0 && reached < wanted {
                limits.velocity = reached;
            }
        }
    }

    /// One sentence for each part left out, each value that is still assumed, and each that looks like a placeholder or
    /// another unit.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = self.parts.clone();
        for (joint, assumed) in self.robot.joints.iter().zip(&self.assumed) {
            let own = joint_notes(joint, assumed);
            notes.extend(own.map(|note| format!("joint '{}'{note}", joint.name)));
        }
        let without = |field: &str| {
            let pairs = self.robot.joints.iter().zip(&self.assumed);
            let without = pairs.filter(|(_, assumed)| assumed.fields.contains(field));
            let names: Vec<&str> = without.map(|(joint, _)| joint.name.as_str()).collect();
            (!names.is_empty()).then(|| (names.len(), format!("joints '{}'", names.join("', '"))))
        };
        if let Some((_, joints)) = without("acceleration_rad_s2") {
            notes.push(format!(
                "no acceleration limit at {joints}: {ACCELERATION} rad/s² is taken"
            ));
        }
        let encoders = format!("{ENCODER_BITS}-bit encoders");
        let drives = [
            ("rotor_inertia_kg_m2", "rotor inertias 0"),
            ("gain_nm_a", "gains not known"),
            ("encoder_bits", &encoders),
        ];
        let drives = drives.iter().filter_map(|(field, taken)| {
            let (count, joints) = without(field)?;
            let all = count == self.robot.joint_count();
            Some(if all {
                (*taken).to_owned()
            } else {
                format!("{taken} ({joints})")
            })
        });
        let drives: Vec<String> = drives.collect();
        if !drives.is_empty() {
            notes.push(format!("drives are not described: {}", drives.join(", ")));
        }
        self.placeholders(&mut notes);
        if let (true, Some((base, _))) = (self.tilted, &self.robot.link_names) {
            let [x, y, z] = self.robot.gravity.into();
            notes.push(format!(
                "link '{base}' is tilted against the root: gravity is ({x:.3}, {y:.3}, {z:.3}) m/s² in its frame"
            ));
        }
        notes
    }

    /// Notes mass distributions that are assumed, or that placeholders, other units and other frames give: a radius of gyration
    /// of several lengths of the link, a centre of mass far from it, or one inertia for all axes of several links.
    fn placeholders(&self, notes: &mut Vec<String>) {
        let joints = &self.robot.joints;
        let ends = joints.iter().skip(1).map(|joint| &joint.placement);
        let ends = ends.chain([&self.robot.flange]);
        let mut apart = Vec::new();
        let isotropic = || self.assumed.iter().filter_map(|assumed| assumed.isotropic);
        let mut shared = Vec::new();
        for ((joint, end), assumed) in joints.iter().zip(ends).zip(&self.assumed) {
            let link = &joint.link;
            let name = joint.link_name.as_ref().unwrap_or(&joint.name);
            let rod = ["mass_kg", "com_m", "inertia_kg_m2"].into_iter();
            let rod: Vec<&str> = rod.filter(|field| assumed.fields.contains(field)).collect();
            if !rod.is_empty() {
                let (rod, mass) = (rod.join(", "), link.mass);
                notes.push(format!(
                    "link '{name}': no inertial data, {rod} of a rod of {mass} kg are taken"
                ));
            }
            let length = link.com.norm() + (end.origin - link.com).norm() + THICKNESS;
            let radius = (link.inertia_com.trace() / 2.0 / link.mass).sqrt();
            if radius > WIDE * length {
                notes.push(format!(
                    "link '{name}': the inertia is that of a body of {radius:.2} m radius of gyration, the link is about {length:.2} m long: a placeholder, or other units? correct it in the file"
                ));
            }
            // A length without the centre of mass, which would hide its own error.
            let length = end.origin.norm() + THICKNESS;
            if let Some(com) = assumed.com.filter(|com| *com > FAR * length) {
                apart.push(format!(
                    "of link '{name}' lies {com:.2} m from its joint, the link is about {length:.2} m long"
                ));
            }
            let others = |own: Matrix3<f64>| isotropic().filter(|other| near(&own, other)).count();
            if assumed.isotropic.is_some_and(|own| others(own) > 1) {
                shared.push(name.as_str());
            }
        }
        if !apart.is_empty() {
            let apart = apart.join("; ");
            notes.push(format!(
                "the centre of mass {apart}: is it given in another frame? correct it in the file"
            ));
        }
        if !shared.is_empty() {
            notes.push(format!(
                "links '{}' share one inertia, the same about all axes: a placeholder? correct it in the file",
                shared.join("', '")
            ));
        }
    }
}

/// Notes on the values of one joint, to stand behind its name.
fn joint_notes(joint: &Joint, assumed: &Assumed) -> impl Iterator<Item = String> {
    let limits = &joint.limits;
    let ((lower, upper), torque, reached) = (limits.position, limits.torque, limits.velocity);
    let wanted = assumed.velocity.unwrap_or(reached);
    let takes = |field| assumed.fields.contains(field);
    let range = match takes("position_rad") {
        true if upper > PI => Some(" is continuous: its range is taken as ±2π rad".to_owned()),
        true => Some(": no range, ±π rad is taken".to_owned()),
        false => (lower.abs().max(upper.abs()) > TURN).then(|| {
            format!(": its range {lower} … {upper} rad ends beyond a turn: are these degrees?")
        }),
    };
    let fast = || format!(": its velocity limit is {wanted} rad/s: are these degrees?");
    let weight = || {
        format!(
            ": no torque limit, {torque} N·m is taken, 1.5 of the weight at full stretch, friction and rotor"
        )
    };
    let percent = 100.0 * FRICTION_SHARE;
    let lowered = || {
        format!(
            ": friction takes {percent:.0} % of the torque limit at {reached:.3} rad/s, which is taken as velocity limit in place of {wanted} rad/s"
        )
    };
    let assumed_speed = || format!(": no velocity limit, {VELOCITY} rad/s is taken");
    let notes = [
        takes("velocity_rad_s").then(assumed_speed),
        (wanted > FAST).then(fast),
        range,
        takes("torque_nm").then(weight),
        (reached < wanted).then(lowered),
    ];
    notes.into_iter().flatten()
}

/// Reads an arm from the text of a URDF; `file` is only used in messages.
///
/// Errors: a line that names the file and the element.
///
/// ```
/// use foretorque_description::urdf::{Selection, parse};
/// let pendulum = r#"<robot name="pendulum">
///   <link name="wall"/>
///   <joint name="hinge" type="revolute">
///     <parent link="wall"/> <child link="rod"/> <axis xyz="0 1 0"/>
///     <limit lower="-3" upper="3" velocity="5" effort="10"/>
///   </joint>
///   <link name="rod"><inertial>
///     <origin xyz="0 0 -0.5"/> <mass value="2"/>
///     <inertia ixx="0.1" iyy="0.1" izz="0.001" ixy="0" ixz="0" iyz="0"/>
///   </inertial></link>
/// </robot>"#;
/// let import = parse("pendulum.urdf", pendulum, &Selection::default()).unwrap();
/// assert_eq!(import.robot.joints[0].link.mass, 2.0);
/// ```
pub fn parse(file: &str, text: &str, selection: &Selection<'_>) -> Result<Import, Refusal> {
    let document = read(file, text).map(|mut document| {
        if selection.base.is_some() {
            // A part of a robot hangs on a link of another file.
            let links: HashSet<String> = document.links.iter().map(|l| l.name.clone()).collect();
            let joints = &mut document.joints;
            joints.retain(|joint| links.contains(&joint.parent));
        }
        document
    });
    document
        .and_then(|document| chain::arm(&document, selection))
        .map_err(|problem| Refusal::of(file, problem))
}

fn read(file: &str, text: &str) -> Result<document::Document, String> {
    // Common URDF parsers accept blank lines before the XML declaration.
    let text = document::with_prefixes(text.trim_start());
    let xml = document::parsed(&text)?;
    if xml.root_element().has_tag_name("mujoco") {
        return mjcf::read(Path::new(file), text);
    }
    document::read(&text)
}

#[cfg(test)]
mod tests;
