//! The elements of an MJCF that matter to dynamics, as links and joints of a URDF.
//!
//! A body is a link. Each of its joints carries a link without mass at the joint's anchor; the body is bolted to the last
//! one. Default classes, frames, included files and the angle unit are resolved. Geoms are not read: a body without
//! `<inertial>` has no inertial data.

use super::UrdfProblem;
use super::document::{
    Document, EARTH, JointElement, LimitElement, LinkElement, RIGHT_ANGLE_TOLERANCE, child,
    children, number, optional, parse_number, parsed, problem, required, unique, vector,
};
use crate::robot::{Link, Placement};
use nalgebra::{Matrix3, Quaternion, Rotation3, Unit, UnitQuaternion, Vector3};
use roxmltree::Node;
use std::path::Path;

/// Files that may include each other in a row.
const MOST_INCLUDES: usize = 8;

/// Default classes that may lie inside each other.
const MOST_CLASSES: usize = 64;

/// The text with every `<include>` replaced by what the file in it has under its root.
///
/// * `file` path of the text; included files lie beside it
fn with_included(file: &Path, text: String) -> Result<String, UrdfProblem> {
    let mut text = text;
    for _ in 0..MOST_INCLUDES {
        let xml = parsed(&text)?;
        let mut places = Vec::new();
        for node in xml.descendants().filter(|n| n.has_tag_name("include")) {
            let name = required(node, "file")?;
            let read = std::fs::read_to_string(file.with_file_name(name));
            let inner =
                read.map_err(|error| problem(node, &format!("file=\"{name}\": {error}")))?;
            let inside = parsed(&inner)?;
            let ends = inside.root_element();
            let ends = ends.first_child().zip(ends.last_child());
            let range = ends.map(|(first, last)| first.range().start..last.range().end);
            let content = range.map_or(String::new(), |range| inner[range].to_owned());
            places.push((node.range(), content));
        }
        if places.is_empty() {
            return Ok(text);
        }
        let mut whole = text.clone();
        for (range, content) in places.into_iter().rev() {
            whole.replace_range(range, &content);
        }
        text = whole;
    }
    Err(UrdfProblem::Syntax(format!(
        "more than {MOST_INCLUDES} files include each other"
    )))
}

/// Reads all bodies and joints under `<mujoco>`.
///
/// * `file` path of the text; included files lie beside it
pub(super) fn read(file: &Path, text: String) -> Result<Document, UrdfProblem> {
    let text = with_included(file, text)?;
    let xml = parsed(&text)?;
    let root = xml.root_element();
    let mut reader = Reader {
        root,
        degrees: true,
        euler: "xyz".to_owned(),
        autolimits: true,
        document: Document {
            name: root.attribute("model").unwrap_or("mujoco").to_owned(),
            gravity: EARTH,
            ..Document::default()
        },
    };
    for compiler in children(root, "compiler") {
        reader.compiler(compiler)?;
    }
    let named = |compiler: Node<'_, '_>| compiler.has_attribute("angle");
    if !children(root, "compiler").any(named) && ranges_are_radians(root) {
        reader.degrees = false;
        let note =
            "no <compiler angle>: angles are taken as radians, as no range is wider than a turn";
        reader.document.notes.push(note.to_owned());
    }
    for option in children(root, "option") {
        if let Some(gravity) = vector(option, "gravity")? {
            reader.document.gravity = gravity;
        }
    }
    reader.document.links.push(LinkElement {
        name: "world".to_owned(),
        inertial: None,
    });
    for world in children(root, "worldbody") {
        reader.bodies(world, "world", Placement::identity(), "main")?;
    }
    for actuators in children(root, "actuator") {
        for actuator in actuators.children().filter(Node::is_element) {
            reader.actuator(actuator)?;
        }
    }
    for equalities in children(root, "equality") {
        for equality in equalities.children().filter(Node::is_element) {
            reader.equality(equality)?;
        }
    }
    unique(reader.document.links.iter().map(|link| link.name.as_str()))?;
    unique(
        reader
            .document
            .joints
            .iter()
            .map(|joint| joint.name.as_str()),
    )?;
    Ok(reader.document)
}

struct Reader<'a, 'input> {
    root: Node<'a, 'input>,
    degrees: bool,
    euler: String,
    autolimits: bool,
    document: Document,
}

impl<'a, 'input> Reader<'a, 'input> {
    fn compiler(&mut self, node: Node<'a, 'input>) -> Result<(), UrdfProblem> {
        if let Some(angle) = node.attribute("angle") {
            self.degrees = angle != "radian";
        }
        if let Some(order) = node.attribute("eulerseq") {
            self.euler = order.to_owned();
        }
        if let Some(auto) = node.attribute("autolimits") {
            self.autolimits = auto == "true";
        }
        let written = |name: &str| node.attribute(name).unwrap_or_default().trim().to_owned();
        let not_zero = |name: &str| parse_number(&written(name)).is_some_and(|value| value > 0.0);
        for (name, changes) in [
            ("inertiafromgeom", written("inertiafromgeom") == "true"),
            ("coordinate", written("coordinate") == "global"),
            ("settotalmass", not_zero("settotalmass")),
            ("boundmass", not_zero("boundmass")),
            ("boundinertia", not_zero("boundinertia")),
        ] {
            if changes {
                let value = written(name);
                return Err(problem(
                    node,
                    &format!(
                        "{name}=\"{value}\" cannot be read: save the compiled model with MuJoCo (mj_saveLastXML)"
                    ),
                ));
            }
        }
        Ok(())
    }

    /// Attribute of an element, or of its default class, the nearest first.
    ///
    /// * `class` default class of the elements around
    fn attribute(
        &self,
        node: Node<'a, 'input>,
        class: &str,
        name: &str,
    ) -> Option<Node<'a, 'input>> {
        if node.has_attribute(name) {
            return Some(node);
        }
        let tag = node.tag_name().name();
        let mut class = node.attribute("class").unwrap_or(class);
        for _ in 0..MOST_CLASSES {
            let of_class = |default: &Node<'_, '_>| class_of(*default) == class;
            let defaults = self
                .root
                .descendants()
                .filter(|n| n.has_tag_name("default"));
            let mut outer = None;
            for default in defaults.filter(of_class) {
                outer = default
                    .parent()
                    .filter(|parent| parent.has_tag_name("default"));
                // An actuator's defaults may stand under its own name and under that of all actuators.
                let found = [tag, "general"]
                    .into_iter()
                    .take(1 + usize::from(is_actuator(tag)));
                let found = found.filter_map(|tag| child(default, tag));
                if let Some(found) = found.into_iter().find(|n| n.has_attribute(name)) {
                    return Some(found);
                }
            }
            match (outer, class) {
                (Some(parent), _) => class = class_of(parent),
                (None, "main") => return None,
                (None, _) => class = "main",
            }
        }
        None
    }

    fn value(
        &self,
        node: Node<'a, 'input>,
        class: &str,
        name: &str,
    ) -> Result<Option<f64>, UrdfProblem> {
        let found = self.attribute(node, class, name);
        found.map_or(Ok(None), |found| optional(found, name))
    }

    /// Numbers of an attribute; none where it is not given.
    fn values(
        &self,
        node: Node<'a, 'input>,
        class: &str,
        name: &str,
    ) -> Result<Vec<f64>, UrdfProblem> {
        let found = self.attribute(node, class, name);
        found.map_or(Ok(Vec::new()), |found| numbers(found, name))
    }

    /// The two ends of `name`, if `limited` does not switch them off.
    fn range(
        &self,
        node: Node<'a, 'input>,
        class: &str,
        [name, limited]: [&str; 2],
    ) -> Result<Option<(f64, f64)>, UrdfProblem> {
        let on = self.attribute(node, class, limited);
        let on = on.and_then(|on| on.attribute(limited)).unwrap_or("auto");
        let on = on == "true" || (on == "auto" && self.autolimits);
        match self.values(node, class, name)?[..] {
            [low, high] if on && low < high => Ok(Some((low, high))),
            [] | [_, _] => Ok(None),
            _ => Err(problem(node, &format!("{name} is not two numbers"))),
        }
    }

    /// The bodies in `node`, which lies at `at` in `link`.
    fn bodies(
        &mut self,
        node: Node<'a, 'input>,
        link: &str,
        at: Placement,
        class: &str,
    ) -> Result<(), UrdfProblem> {
        for inner in node.children().filter(Node::is_element) {
            let class = inner.attribute("childclass").unwrap_or(class);
            match inner.tag_name().name() {
                "body" => self.body(inner, link, at.then(&self.pose(inner)?), class)?,
                "frame" => self.bodies(inner, link, at.then(&self.pose(inner)?), class)?,
                "joint" | "freejoint" if node.has_tag_name("frame") => {
                    return Err(problem(inner, "in a <frame> cannot be read"));
                }
                "replicate" | "attach" | "composite" | "flexcomp" => {
                    return Err(problem(
                        inner,
                        "cannot be read: save the compiled model with MuJoCo (mj_saveLastXML)",
                    ));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn body(
        &mut self,
        node: Node<'a, 'input>,
        parent: &str,
        pose: Placement,
        class: &str,
    ) -> Result<(), UrdfProblem> {
        let unnamed = || format!("body_{}", self.document.links.len());
        let name = node.attribute("name").map_or_else(unnamed, str::to_owned);
        let inertial = child(node, "inertial").map(|inertial| self.inertia(inertial));
        if node
            .attribute("gravcomp")
            .and_then(parse_number)
            .unwrap_or(0.0)
            != 0.0
        {
            self.document
                .notes
                .push(format!("body '{name}': gravcomp is left out"));
        }
        let (mut carrier, mut place) = (parent.to_owned(), pose);
        let is_joint = |n: &Node<'_, '_>| n.has_tag_name("joint") || n.has_tag_name("freejoint");
        let mut joints = node.children().filter(is_joint).peekable();
        while let Some(joint) = joints.next() {
            let (mut element, after) = self.joint(joint, &carrier, &place, class)?;
            place = after;
            if joints.peek().is_none() && place == Placement::identity() {
                element.child.clone_from(&name);
            } else {
                self.document.links.push(LinkElement {
                    name: element.child.clone(),
                    inertial: None,
                });
            }
            carrier.clone_from(&element.child);
            self.document.joints.push(element);
        }
        if carrier != name {
            self.document.joints.push(JointElement {
                name: format!("{name}#"),
                kind: "fixed".to_owned(),
                parent: carrier,
                child: name.clone(),
                origin: place,
                ..JointElement::default()
            });
        }
        self.document.links.push(LinkElement {
            name: name.clone(),
            inertial: inertial.transpose()?.flatten(),
        });
        self.bodies(node, &name, Placement::identity(), class)
    }

    /// Mass distribution in the body's frame; `None` without mass.
    fn inertia(&self, node: Node<'a, 'input>) -> Result<Option<Link>, UrdfProblem> {
        let mass = number(node, "mass")?;
        let written = match (
            &numbers(node, "fullinertia")?[..],
            &numbers(node, "diaginertia")?[..],
        ) {
            (&[xx, yy, zz, xy, xz, yz], _) => Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            ([], &[xx, yy, zz]) => Matrix3::from_diagonal(&Vector3::new(xx, yy, zz)),
            ([], []) => Matrix3::zeros(),
            _ => return Err(problem(node, "needs three diaginertia or six fullinertia")),
        };
        if mass == 0.0 && written == Matrix3::zeros() {
            return Ok(None);
        }
        let frame = self.pose(node)?;
        let rot = frame.rot_parent_child;
        let inertia_com = rot * written * rot.transpose();
        Ok(Some(Link {
            mass,
            com: frame.origin,
            inertia_com,
        }))
    }

    /// A joint, and what follows it in the frame of the link it moves.
    ///
    /// `T = place · Trans(p) Rot(axis, q − ref) · Trans(−p)`
    fn joint(
        &mut self,
        node: Node<'a, 'input>,
        parent: &str,
        place: &Placement,
        class: &str,
    ) -> Result<(JointElement, Placement), UrdfProblem> {
        let unnamed = || format!("joint_{}", self.document.joints.len());
        let name = node.attribute("name").map_or_else(unnamed, str::to_owned);
        let of = |attribute: &str| self.value(node, class, attribute);
        let text = |attribute: &str| {
            let found = self.attribute(node, class, attribute);
            found.and_then(|found| found.attribute(attribute))
        };
        let range = self.range(node, class, ["range", "limited"])?;
        let kind = match text("type").unwrap_or("hinge") {
            _ if node.has_tag_name("freejoint") => "floating",
            "hinge" if range.is_some() => "revolute",
            "hinge" => "continuous",
            "slide" => "prismatic",
            other => other,
        };
        let three = |values: Vec<f64>, default: Vector3<f64>| match values[..] {
            [x, y, z] => Ok(Vector3::new(x, y, z)),
            [] => Ok(default),
            _ => Err(problem(node, "has a vector that is not three numbers")),
        };
        let axis = three(self.values(node, class, "axis")?, Vector3::z())?;
        let anchor = three(self.values(node, class, "pos")?, Vector3::zeros())?;
        let turn = if kind == "prismatic" {
            1.0
        } else {
            self.angle(1.0)
        };
        let back = Unit::try_new(axis, 1e-9).map_or(Matrix3::identity(), |axis| {
            let back = -of("ref").ok().flatten().unwrap_or(0.0) * turn;
            Rotation3::from_axis_angle(&axis, back).into_inner()
        });
        let force = self.range(node, class, ["actuatorfrcrange", "actuatorfrclimited"])?;
        let moving = Placement {
            rot_parent_child: Matrix3::identity(),
            origin: anchor,
        };
        let turned = Placement {
            rot_parent_child: back,
            origin: Vector3::zeros(),
        };
        let element = JointElement {
            kind: kind.to_owned(),
            parent: parent.to_owned(),
            child: format!("{name}#moved"),
            origin: place.then(&moving).then(&turned),
            axis,
            limit: LimitElement {
                lower: range.map(|range| range.0 * turn),
                upper: range.map(|range| range.1 * turn),
                effort: force.map(|(low, high)| high.min(-low)),
                ..LimitElement::default()
            },
            friction: (
                of("damping")?.unwrap_or(0.0),
                of("frictionloss")?.unwrap_or(0.0),
            ),
            rotor: of("armature")?.unwrap_or(0.0),
            name,
            ..JointElement::default()
        };
        if of("stiffness")?.is_some_and(|stiffness| stiffness != 0.0) {
            let note = format!("joint '{}': its spring is left out", element.name);
            self.document.notes.push(note);
        }
        Ok((element, moving.inverse()))
    }

    /// Takes the torque limit of the joint that an actuator drives, if it is the lower one.
    fn actuator(&mut self, node: Node<'a, 'input>) -> Result<(), UrdfProblem> {
        let Some(name) = node.attribute("joint") else {
            return Ok(());
        };
        let gear = self.values(node, "main", "gear")?;
        let gear = gear.first().map_or(1.0, |gear| gear.abs());
        let mut ranges = vec![self.range(node, "main", ["forcerange", "forcelimited"])?];
        if node.has_tag_name("motor") {
            ranges.push(self.range(node, "main", ["ctrlrange", "ctrllimited"])?);
        }
        let most = ranges
            .into_iter()
            .flatten()
            .map(|(low, high)| gear * high.min(-low));
        let most = most.filter(|most| *most > 0.0).reduce(f64::min);
        let driven = self
            .document
            .joints
            .iter_mut()
            .find(|joint| joint.name == name);
        if let (Some(joint), Some(most)) = (driven, most) {
            joint.limit.effort = Some(joint.limit.effort.map_or(most, |known| known.min(most)));
        }
        Ok(())
    }

    /// Marks the joints that an equality holds: they do not move on their own.
    fn equality(&mut self, node: Node<'a, 'input>) -> Result<(), UrdfProblem> {
        if node.attribute("active") == Some("false") {
            return Ok(());
        }
        let named = |name: &str| node.attribute(name).unwrap_or_default();
        match node.tag_name().name() {
            "joint" => {
                let held = named("joint1");
                let joints = self.document.joints.iter_mut();
                for joint in joints.filter(|joint| joint.name == held) {
                    joint.mimic = true;
                }
            }
            "connect" | "weld" => {
                let held = [named("body1"), named("body2")];
                let bolts = self
                    .document
                    .joints
                    .iter()
                    .filter(|joint| joint.kind == "fixed");
                let bolts = bolts.filter(|bolt| held.contains(&bolt.child.as_str()));
                let moved: Vec<String> = bolts.map(|bolt| bolt.parent.clone()).collect();
                for joint in &mut self.document.joints {
                    let holds =
                        moved.contains(&joint.child) || held.contains(&joint.child.as_str());
                    if holds && joint.kind != "fixed" {
                        joint.kind = "held by an equality constraint".to_owned();
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// An angle as written, rad.
    fn angle(&self, written: f64) -> f64 {
        if self.degrees {
            written.to_radians()
        } else {
            written
        }
    }

    /// Position and orientation of an element in the one around it.
    fn pose(&self, node: Node<'a, 'input>) -> Result<Placement, UrdfProblem> {
        let bad = |name: &str| {
            problem(
                node,
                &format!("has an attribute '{name}' of another length than its kind has"),
            )
        };
        let unit = |v: Vector3<f64>| Unit::try_new(v, 1e-9).ok_or_else(|| bad("axis"));
        let mut rot = Rotation3::identity();
        for name in ["quat", "axisangle", "xyaxes", "zaxis", "euler"] {
            rot = match (name, &numbers(node, name)?[..]) {
                (_, []) => continue,
                ("quat", &[w, x, y, z]) => {
                    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
                        .to_rotation_matrix()
                }
                ("axisangle", &[x, y, z, angle]) => {
                    Rotation3::from_axis_angle(&unit(Vector3::new(x, y, z))?, self.angle(angle))
                }
                ("xyaxes", &[a, b, c, d, e, f]) => {
                    let x = unit(Vector3::new(a, b, c))?.into_inner();
                    let y = Vector3::new(d, e, f);
                    let y = unit(y - x * x.dot(&y))?.into_inner();
                    Rotation3::from_basis_unchecked(&[x, y, x.cross(&y)])
                }
                ("zaxis", &[x, y, z]) => {
                    let axis = unit(Vector3::new(x, y, z))?.into_inner();
                    let least = Rotation3::rotation_between(&Vector3::z(), &axis);
                    least.unwrap_or_else(|| {
                        Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
                    })
                }
                ("euler", angles @ &[_, _, _]) => {
                    self.euler.chars().zip(angles).fold(
                        Rotation3::identity(),
                        |rot, (axis, angle)| {
                            let about = match axis.to_ascii_lowercase() {
                                'x' => Vector3::x_axis(),
                                'y' => Vector3::y_axis(),
                                _ => Vector3::z_axis(),
                            };
                            let turn = Rotation3::from_axis_angle(&about, self.angle(*angle));
                            // Lower case turns about the axes as they move, upper case about the fixed ones.
                            if axis.is_ascii_lowercase() {
                                rot * turn
                            } else {
                                turn * rot
                            }
                        },
                    )
                }
                _ => return Err(bad(name)),
            };
        }
        // As of a URDF: right angles written in decimals are right angles.
        let exact = rot.matrix().map(f64::round);
        let near = (rot.matrix() - exact).amax() < RIGHT_ANGLE_TOLERANCE;
        let placed = Placement {
            rot_parent_child: if near { exact } else { rot.into_inner() },
            origin: vector(node, "pos")?.unwrap_or_default(),
        };
        Ok(placed.snapped())
    }
}

/// Every range of a joint lies within a turn in radians. In degrees no arm moves with such ranges: the file is a part of one
/// that names the unit.
fn ranges_are_radians(root: Node<'_, '_>) -> bool {
    let joints = root.descendants().filter(|n| n.has_tag_name("joint"));
    let ends: Vec<f64> = joints
        .filter_map(|joint| numbers(joint, "range").ok())
        .flatten()
        .collect();
    !ends.is_empty() && ends.iter().all(|end| end.abs() <= std::f64::consts::TAU)
}

fn class_of<'a>(default: Node<'a, '_>) -> &'a str {
    default.attribute("class").unwrap_or("main")
}

fn is_actuator(tag: &str) -> bool {
    ["motor", "position", "velocity", "intvelocity", "damper"].contains(&tag)
}

/// Numbers of an attribute; none where it is not given.
fn numbers(node: Node<'_, '_>, name: &str) -> Result<Vec<f64>, UrdfProblem> {
    let Some(text) = node.attribute(name) else {
        return Ok(Vec::new());
    };
    let values: Option<Vec<f64>> = text.split_whitespace().map(parse_number).collect();
    values.ok_or_else(|| problem(node, &format!("{name}=\"{text}\" is not a list of numbers")))
}
