//! The elements of a URDF or MJCF that matter to dynamics, as they are written.

use crate::robot::{Link, Placement, TURN, fits_board};
use nalgebra::{Matrix3, Vector3};
use roxmltree::Node;
use std::f64::consts::FRAC_PI_2;

/// Angles this close to a multiple of π/2 are that multiple. URDF files write right angles as 1.5708 or 1.57079632679;
/// taken literally, such an arm has nearly dependent inertial parameters, which neither a torque sensor nor f32
/// resolves, and its zero entries cost multiplications.
pub(super) const RIGHT_ANGLE_TOLERANCE: f64 = 1e-5;

/// Gravity of a file that states none, m/s².
pub(super) const EARTH: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// Mend of a file with macros or their variables.
const EXPAND: &str = ": expand the file first (xacro FILE)";

#[derive(Default)]
pub(super) struct Document {
    pub(super) name: String,
    /// Acceleration of gravity in the frame of the root, m/s².
    pub(super) gravity: Vector3<f64>,
    /// One sentence for each part that is not read.
    pub(super) notes: Vec<String>,
    pub(super) links: Vec<LinkElement>,
    pub(super) joints: Vec<JointElement>,
}

pub(super) struct LinkElement {
    pub(super) name: String,
    /// Mass distribution in the link frame, unchecked.
    pub(super) inertial: Option<Link>,
}

#[derive(Default)]
pub(super) struct JointElement {
    pub(super) name: String,
    pub(super) kind: String,
    pub(super) parent: String,
    pub(super) child: String,
    /// Joint frame in the frame of the parent link.
    pub(super) origin: Placement,
    /// The origin as written has angles that were taken for right ones.
    pub(super) squared: bool,
    pub(super) axis: Vector3<f64>,
    pub(super) mimic: bool,
    pub(super) limit: LimitElement,
    /// Viscous (N·m·s/rad) and Coulomb (N·m) friction.
    pub(super) friction: (f64, f64),
    /// Rotor inertia reflected to the link side, kg·m²; 0 where the file gives none.
    pub(super) rotor: f64,
}

#[derive(Default)]
pub(super) struct LimitElement {
    pub(super) lower: Option<f64>,
    pub(super) upper: Option<f64>,
    pub(super) velocity: Option<f64>,
    pub(super) effort: Option<f64>,
    pub(super) acceleration: Option<f64>,
}

/// Prefixes without a declaration that are declared for a file; there is no sense in more.
const MOST_PREFIXES: usize = 16;

/// The text with its undeclared namespace prefixes declared, as common URDF parsers accept them undeclared.
pub(super) fn with_prefixes(text: &str) -> String {
    let mut text = text.to_owned();
    for _ in 0..MOST_PREFIXES {
        let Err(roxmltree::Error::UnknownNamespace(prefix, _)) = xml(&text) else {
            break;
        };
        let roots = ["<robot", "<mujoco"].into_iter();
        let Some(place) = roots.filter_map(|root| text.find(root)).min() else {
            break;
        };
        let end = text[place..].find([' ', '>', '\n', '\t', '\r']);
        let declaration = format!(" xmlns:{prefix}=\"{prefix}\"");
        text.insert_str(place + end.unwrap_or(0), &declaration);
    }
    text
}

fn xml(text: &str) -> Result<roxmltree::Document<'_>, roxmltree::Error> {
    let options = roxmltree::ParsingOptions {
        allow_dtd: true,
        ..Default::default()
    };
    roxmltree::Document::parse_with_options(text, options)
}

/// The XML of a file; a document type is allowed.
pub(super) fn parsed(text: &str) -> Result<roxmltree::Document<'_>, String> {
    let xml = xml(text).map_err(|error| no_robot(&error.to_string()))?;
    let is_deep = |node: Node<'_, '_>| node.ancestors().nth(DEEPEST).is_some();
    match xml.descendants().any(is_deep) {
        true => Err(no_robot(&format!(
            "more than {DEEPEST} elements in each other"
        ))),
        false => Ok(xml),
    }
}

/// Elements in each other: what reads them calls itself for each.
const DEEPEST: usize = 500;

pub(super) fn read(text: &str) -> Result<Document, String> {
    let xml = parsed(text)?;
    let root = xml.root_element();
    let found = root.tag_name().name();
    if found != "robot" {
        let reason = format!("<{found}> instead of <robot> or <mujoco>");
        return Err(no_robot(&reason));
    }
    let is_used = |text: &str| text.contains("${") || text.contains("$(");
    let uses = |node: Node<'_, '_>| {
        let mut attributes = node.attributes().map(|attribute| attribute.value());
        attributes.any(is_used) || node.is_text() && node.text().is_some_and(is_used)
    };
    let uses_values = root.descendants().any(uses);
    let is_macro = |node: Node<'_, '_>| {
        let namespace = node.tag_name().namespace();
        // Values that nothing uses are none.
        let is_value = matches!(node.tag_name().name(), "property" | "arg");
        namespace.is_some_and(|n| n.ends_with("xacro")) && (uses_values || !is_value)
    };
    if root.descendants().any(is_macro) {
        return Err(format!("contains xacro macros{EXPAND}"));
    }
    let document = Document {
        name: root.attribute("name").unwrap_or_default().to_owned(),
        gravity: EARTH,
        notes: Vec::new(),
        links: children(root, "link").map(link).collect::<Result<_, _>>()?,
        // Transmissions have <joint> elements too, but not directly under <robot>.
        joints: children(root, "joint")
            .map(joint)
            .collect::<Result<_, _>>()?,
    };
    document.unique()
}

impl Document {
    /// This document, if no name is used twice.
    pub(super) fn unique(self) -> Result<Self, String> {
        unique(self.links.iter().map(|link| link.name.as_str()))?;
        unique(self.joints.iter().map(|joint| joint.name.as_str()))?;
        Ok(self)
    }
}

fn unique<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), String> {
    let mut seen = std::collections::HashSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(format!("the name '{name}' is used twice"));
        }
    }
    Ok(())
}

fn link(node: Node<'_, '_>) -> Result<LinkElement, String> {
    let inertial = child(node, "inertial").map(inertia);
    Ok(LinkElement {
        inertial: inertial.transpose()?.flatten(),
        name: required(node, "name")?.to_owned(),
    })
}

/// Mass distribution of an `<inertial>`, in the link frame.
fn inertia(node: Node<'_, '_>) -> Result<Option<Link>, String> {
    let mass = number(required_child(node, "mass")?, "value")?;
    let tensor = required_child(node, "inertia")?;
    let entry = |name| number(tensor, name);
    let (xx, yy, zz) = (entry("ixx")?, entry("iyy")?, entry("izz")?);
    let (xy, xz, yz) = (entry("ixy")?, entry("ixz")?, entry("iyz")?);
    let written = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    body(mass, &written, || Ok(origin(node)?.0))
}

/// The body with a mass and a tensor written in the frame of its centre of mass; `None` when both are zero.
pub(super) fn body(
    mass: f64,
    written: &Matrix3<f64>,
    frame: impl FnOnce() -> Result<Placement, String>,
) -> Result<Option<Link>, String> {
    if mass == 0.0 && *written == Matrix3::zeros() {
        return Ok(None);
    }
    let frame = frame()?;
    let rot = frame.rot_parent_child;
    Ok(Some(Link {
        mass,
        com: frame.origin,
        inertia_com: rot * written * rot.transpose(),
    }))
}

fn joint(node: Node<'_, '_>) -> Result<JointElement, String> {
    let (origin, squared) = origin(node)?;
    let kind = required(node, "type")?.to_owned();
    // A fixed joint turns about nothing, and tools write anything there.
    let axis = match child(node, "axis").filter(|_| kind != "fixed") {
        Some(axis) => vector(axis, "xyz")?.unwrap_or(Vector3::x()),
        // The default of the format.
        None => Vector3::x(),
    };
    let of = |element: &str, name: &str| match child(node, element) {
        Some(element) => optional(element, name),
        None => Ok(None),
    };
    // An infinite limit is none.
    let bounded = |name: &str| match child(node, "limit").and_then(|own| own.attribute(name)) {
        Some(text) if text.trim().parse().is_ok_and(f64::is_infinite) => Ok(None),
        _ => of("limit", name),
    };
    let limit = LimitElement {
        lower: bounded("lower")?,
        upper: bounded("upper")?,
        velocity: bounded("velocity")?,
        effort: bounded("effort")?,
        acceleration: of("limit", "acceleration")?,
    };
    let damping = of("dynamics", "damping")?.unwrap_or(0.0);
    let friction = (damping, of("dynamics", "friction")?.unwrap_or(0.0));
    Ok(JointElement {
        name: required(node, "name")?.to_owned(),
        kind,
        parent: required(required_child(node, "parent")?, "link")?.to_owned(),
        child: required(required_child(node, "child")?, "link")?.to_owned(),
        origin,
        squared,
        axis,
        mimic: child(node, "mimic").is_some(),
        limit,
        friction,
        rotor: 0.0,
    })
}

/// The `<origin>` of an element, and whether angles in it were taken for right ones.
fn origin(node: Node<'_, '_>) -> Result<(Placement, bool), String> {
    let Some(node) = child(node, "origin") else {
        return Ok((Placement::identity(), false));
    };
    let xyz = vector(node, "xyz")?.unwrap_or_default();
    let written = vector(node, "rpy")?.unwrap_or_default();
    if written.amax() > TURN {
        let what = "has more than a turn in rpy, which is in radians";
        return Err(problem(node, what));
    }
    let rpy = written.map(squared);
    // Up to 1e-9 rad is rounding of an exact number: no note.
    let moved = (rpy - written).amax() > 1e-9;
    Ok((Placement::from_xyz_rpy(xyz, rpy), moved))
}

/// The angle, or the multiple of π/2 it is meant to be: within the tolerance, or written with two decimals or more that are
/// those of the multiple, rounded or cut off, as in 1.571.
pub(super) fn squared(angle: f64) -> f64 {
    let nearest = (angle / FRAC_PI_2).round() * FRAC_PI_2;
    let written = (2..5).any(|decimals| {
        let [given, meant] = [angle, nearest].map(|angle| angle * 10_f64.powi(decimals));
        let near = |whole: f64| (given - whole).abs() < 1e-6;
        near(meant.round()) || near(meant.trunc())
    });
    if written || (angle - nearest).abs() < RIGHT_ANGLE_TOLERANCE {
        nearest
    } else {
        angle
    }
}

pub(super) fn children<'a, 'input>(
    node: Node<'a, 'input>,
    name: &str,
) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |node| node.has_tag_name(name))
}

pub(super) fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    children(node, name).next()
}

/// The problem of a text that is not XML, or of XML that is not a robot.
pub(super) fn no_robot(reason: &str) -> String {
    format!("not a URDF or MJCF: {reason}")
}

/// The problem of an element, with its line.
pub(super) fn problem(node: Node<'_, '_>, what: &str) -> String {
    let line = node.document().text_pos_at(node.range().start).row;
    let element = node.tag_name().name();
    format!("line {line}: <{element}> {what}")
}

pub(super) fn required_child<'a, 'input>(
    node: Node<'a, 'input>,
    name: &str,
) -> Result<Node<'a, 'input>, String> {
    child(node, name).ok_or_else(|| problem(node, &format!("has no <{name}>")))
}

pub(super) fn required<'a>(node: Node<'a, '_>, name: &str) -> Result<&'a str, String> {
    node.attribute(name)
        .ok_or_else(|| problem(node, &format!("has no attribute '{name}'")))
}

pub(super) fn number(node: Node<'_, '_>, name: &str) -> Result<f64, String> {
    let text = required(node, name)?;
    parse_number(text).ok_or_else(|| match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => not(node, name, text, "a number of 32 bits"),
        _ => not(node, name, text, "a number"),
    })
}

/// The problem of an attribute that is not `what`.
fn not(node: Node<'_, '_>, name: &str, text: &str, what: &str) -> String {
    let xacro = if text.contains('$') { EXPAND } else { "" };
    problem(node, &format!("{name}=\"{text}\" is not {what}{xacro}"))
}

pub(super) fn optional(node: Node<'_, '_>, name: &str) -> Result<Option<f64>, String> {
    match node.attribute(name) {
        Some(_) => number(node, name).map(Some),
        None => Ok(None),
    }
}

pub(super) fn vector(node: Node<'_, '_>, name: &str) -> Result<Option<Vector3<f64>>, String> {
    let Some(text) = node.attribute(name) else {
        return Ok(None);
    };
    match list(text).as_deref() {
        Some(&[x, y, z]) => Ok(Some(Vector3::new(x, y, z))),
        _ => Err(not(node, name, text, "three numbers")),
    }
}

/// Numbers between spaces.
pub(super) fn list(text: &str) -> Option<Vec<f64>> {
    text.split_whitespace().map(parse_number).collect()
}

pub(super) fn parse_number(text: &str) -> Option<f64> {
    let value = text.trim().parse().ok();
    value.filter(|&value| fits_board(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn right_angles_are_known_by_their_decimals_and_no_other_angle_is_one() {
        for (written, meant) in [
            ("1.57 1.571 1.5707 1.5708 1.57079632", FRAC_PI_2),
            ("3.14 3.141 3.142 3.1416", PI),
            ("-4.71 -4.712", -3.0 * FRAC_PI_2),
        ] {
            for angle in written.split(' ') {
                assert_eq!(squared(angle.parse().unwrap()), meant, "{angle}");
            }
        }
        for angle in "0 1.6 1.58 1.572 1.5709 1.5702 1.5705963 3.15 0.01 0.001 0.785".split(' ') {
            let angle = angle.parse().unwrap();
            assert_eq!(squared(angle), angle);
        }
    }
}
