//! The elements of an MJCF that matter to dynamics, as links and joints of a URDF.
//!
//! A body is a link. Each of its joints carries a link without mass at the joint's anchor; the body is bolted to the last
//! one. Default classes, frames, included files and the angle unit are resolved. Geoms are not read: a body without
//! `<inertial>` has no inertial data.

mod attributes;

use super::document::{
    Document, EARTH, JointElement, LimitElement, LinkElement, RIGHT_ANGLE_TOLERANCE, body, child,
    children, list, no_robot, number, optional, parse_number, parsed, problem, required, squared,
    vector,
};
use crate::robot::{Link, Placement};
use attributes::{numbers, ranges_are_radians};
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
fn with_included(file: &Path, text: String) -> Result<String, String> {
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
    Err(no_robot(&format!(
        "more than {MOST_INCLUDES} files include each other"
    )))
}

/// Reads all bodies and joints under `<mujoco>`.
///
/// * `file` path of the text; included files lie beside it
pub(super) fn read(file: &Path, text: String) -> Result<Document, String> {
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
    let inside = |name| children(root, name).flat_map(|n| n.children().filter(Node::is_element));
    for actuator in inside("actuator") {
        reader.actuator(actuator)?;
    }
    for equality in inside("equality") {
        reader.equality(equality)?;
    }
    reader.document.unique()
}

/// The problem of a `part` of an element that MuJoCo alone can apply.
fn unreadable(node: Node<'_, '_>, part: &str) -> String {
    let way = "save the compiled model with MuJoCo (mj_saveLastXML)";
    problem(node, &format!("{part}cannot be read: {way}"))
}

struct Reader<'a, 'input> {
    root: Node<'a, 'input>,
    degrees: bool,
    euler: String,
    autolimits: bool,
    document: Document,
}

impl<'a, 'input> Reader<'a, 'input> {
    /// The bodies in `node`, which lies at `at` in `link`.
    fn bodies(
        &mut self,
        node: Node<'a, 'input>,
        link: &str,
        at: Placement,
        class: &str,
    ) -> Result<(), String> {
        for inner in node.children().filter(Node::is_element) {
            let class = inner.attribute("childclass").unwrap_or(class);
            match inner.tag_name().name() {
                "body" => self.body(inner, link, at.then(&self.pose(inner)?), class)?,
                "frame" => self.bodies(inner, link, at.then(&self.pose(inner)?), class)?,
                "joint" | "freejoint" if node.has_tag_name("frame") => {
                    return Err(problem(inner, "in a <frame> cannot be read"));
                }
                "replicate" | "attach" | "composite" | "flexcomp" => {
                    return Err(unreadable(inner, ""));
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
    ) -> Result<(), String> {
        let unnamed = || format!("body_{}", self.document.links.len());
        let name = node.attribute("name").map_or_else(unnamed, str::to_owned);
        let inertial = child(node, "inertial").map(|inertial| self.inertia(inertial));
        let gravcomp = node.attribute("gravcomp").and_then(parse_number);
        if gravcomp.is_some_and(|share| share != 0.0) {
            let note = format!("body '{name}': gravcomp is left out");
            self.document.notes.push(note);
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
    fn inertia(&self, node: Node<'a, 'input>) -> Result<Option<Link>, String> {
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
        body(mass, &written, || self.pose(node))
    }

    /// A joint, and what follows it in the frame of the link it moves.
    ///
    /// `T = place · Trans(p) Rot(axis, q − ref) · Trans(−p)`; a slide moves by `(q − ref) axis`
    fn joint(
        &mut self,
        node: Node<'a, 'input>,
        parent: &str,
        place: &Placement,
        class: &str,
    ) -> Result<(JointElement, Placement), String> {
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
        let turn = match kind {
            "prismatic" => 1.0,
            _ => self.angle(1.0),
        };
        let back = -of("ref")?.unwrap_or(0.0) * turn;
        let still = Placement::identity();
        let moved = match Unit::try_new(axis, 1e-9) {
            Some(axis) if kind == "prismatic" => Placement {
                origin: back * axis.into_inner(),
                ..still
            },
            Some(axis) => Placement {
                rot_parent_child: Rotation3::from_axis_angle(&axis, back).into_inner(),
                ..still
            },
            None => still,
        };
        let force = self.range(node, class, ["actuatorfrcrange", "actuatorfrclimited"])?;
        let moving = Placement {
            origin: anchor,
            ..still
        };
        let element = JointElement {
            kind: kind.to_owned(),
            parent: parent.to_owned(),
            child: format!("{name}#moved"),
            origin: place.then(&moving).then(&moved),
            axis,
            limit: LimitElement {
                lower: range.map(|range| range.0 * turn),
                upper: range.map(|range| range.1 * turn),
                effort: force
                    .map(|(low, high)| high.min(-low))
                    .filter(|most| *most > 0.0),
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
    fn actuator(&mut self, node: Node<'a, 'input>) -> Result<(), String> {
        let Some(name) = node.attribute("joint") else {
            return Ok(());
        };
        let gear = self.values(node, "main", "gear")?;
        let gear = gear.first().map_or(1.0, |gear| gear.abs());
        let mut ranges = vec![self.range(node, "main", ["forcerange", "forcelimited"])?];
        if node.has_tag_name("motor") {
            ranges.push(self.range(node, "main", ["ctrlrange", "ctrllimited"])?);
        }
        let ranges = ranges.into_iter().flatten();
        let most = ranges.map(|(low, high)| gear * high.min(-low));
        let most = most.filter(|most| *most > 0.0).reduce(f64::min);
        let mut joints = self.document.joints.iter_mut();
        if let (Some(joint), Some(most)) = (joints.find(|joint| joint.name == name), most) {
            joint.limit.effort = Some(joint.limit.effort.map_or(most, |known| known.min(most)));
        }
        Ok(())
    }

    /// Marks the joints that an equality holds: they do not move on their own.
    fn equality(&mut self, node: Node<'a, 'input>) -> Result<(), String> {
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
                let holds = |joint: &JointElement| held.contains(&joint.child.as_str());
                let bolts = self.document.joints.iter();
                let bolts = bolts.filter(|joint| joint.kind == "fixed" && holds(joint));
                let moved: Vec<String> = bolts.map(|bolt| bolt.parent.clone()).collect();
                for joint in &mut self.document.joints {
                    let held = moved.contains(&joint.child) || holds(joint);
                    if held && joint.kind != "fixed" {
                        joint.kind = "held by an equality constraint".to_owned();
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::dynamics::{Joints, ReferenceModel};
    use crate::urdf::tests::{MJCF, imported, whole};
    use crate::urdf::{Import, Selection, parse};
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn an_mjcf_is_read_with_its_classes_units_and_anchors() {
        let import = imported(MJCF);
        let [shoulder, elbow] = &import.robot.joints[..] else {
            panic!("{:?}", import.notes());
        };
        assert_eq!(import.robot.gravity.z, -9.8);
        assert_eq!((&*shoulder.name, &*elbow.name), ("shoulder", "elbow"));
        assert_eq!(shoulder.limits.position, (-FRAC_PI_2, FRAC_PI_2));
        let rotors = [shoulder, elbow].map(|joint| joint.drive.rotor_inertia);
        assert_eq!(rotors, [0.1, 0.02]);
        assert_eq!((elbow.friction.viscous, elbow.friction.coulomb), (1.0, 0.3));
        assert_eq!((shoulder.limits.torque, elbow.limits.torque), (35.0, 15.0));
        // The elbow turns about z of the forearm, y of the upper arm, at (0.3 + 0.1, 0, 0); at q = 10° the forearm is as drawn.
        let q = Joints::<2>::new(0.0, 10.0_f64.to_radians());
        let lever_elbow = 0.1;
        let model = ReferenceModel::<2>::new(&import.robot).unwrap();
        let gravity = model.gravity_torques(&q);
        let expected = -9.8 * (2.0 * 0.2 + 0.5);
        assert!((gravity[0] - expected).abs() < 1e-12, "{gravity}");
        let error = gravity[1].abs() - 9.8 * lever_elbow;
        assert!(error.abs() < 1e-12, "{gravity}");
        assert!(import.begins("the arm ends at link 'fore'"));
    }

    #[test]
    fn an_mjcf_without_a_unit_of_angles_has_that_of_its_ranges() {
        let read = imported;
        let noted =
            |import: &Import| import.begins("no <compiler angle>: angles are taken as radians");
        let bare = MJCF.replace("angle=\"degree\" ", "");
        // ±90 are degrees, ±1.5 of a part of a file are not, unless it says so.
        let degrees = read(&bare);
        let position = |import: &Import| import.robot.joints[0].limits.position;
        assert_eq!(position(&degrees), (-FRAC_PI_2, FRAC_PI_2));
        let radians = read(&bare.replace("-90 90", "-1.5 1.5"));
        assert_eq!(position(&radians), (-1.5, 1.5));
        assert_eq!([noted(&degrees), noted(&radians)], [false, true]);
        // A rounded turn.
        assert!(noted(&read(&bare.replace("-90 90", "-6.28319 6.28319"))));
        // Motors and positions of a class have the same defaults.
        let geared = MJCF.replace("<motor ctrlrange", "<motor gear=\"0.5\" ctrlrange");
        let geared = geared.replace("<position joint", "<position class=\"arm\" joint");
        assert_eq!(whole(&geared).joints[0].limits.torque, 17.5);
        let named = read(&MJCF.replace("-90 90", "-1.5 1.5"));
        let end = 1.5_f64.to_radians();
        assert_eq!(position(&named), (-end, end));
        assert!(!noted(&named));
    }

    #[test]
    fn a_slide_that_is_welded_stands_at_its_zero() {
        let inertial = "<inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"0.01 0.01 0.01\"/>";
        let arm = format!(
            r#"<mujoco><worldbody><body><joint range="-90 90"/>{inertial}
            <body><joint type="slide" axis="2 0 0" ref="0.5"/>{inertial}</body></body></worldbody></mujoco>"#
        );
        let weld = Selection {
            weld: true,
            ..Selection::default()
        };
        let robot = parse("t", &arm, &weld).unwrap().robot;
        // Half of the mass 0.5 m back.
        assert_eq!(robot.joints[0].link.com.as_slice(), [-0.25, 0.0, 0.0]);
    }

    #[test]
    fn right_angles_in_a_quaternion_of_decimals_are_right_angles() {
        // About x by a right angle, then about y by 0.5 rad: the axes are at a right angle, although no entry of the rest is 0 or 1.
        let cosine_of_axes = |quat: &str| {
            let body = "<inertial pos=\"0 0 0.1\" mass=\"1\" diaginertia=\"0.01 0.01 0.01\"/>";
            let arm = format!(
                r#"<mujoco><worldbody><body><joint range="-1 1"/>{body}
                <body quat="{quat}"><joint range="-1 1"/>{body}</body></body></worldbody></mujoco>"#
            );
            whole(&arm).joints[1].placement.rot_parent_child.m33
        };
        assert_eq!(cosine_of_axes("0.685124 0.685126 0.174941 -0.174941"), 0.0);
        let other = cosine_of_axes("0.685124 0.6853 0.174941 -0.174941");
        assert!(other.abs() > 1e-5, "{other}");
    }

    #[test]
    fn parts_of_an_mjcf_that_change_the_dynamics_are_refused_by_name() {
        // Text of the file ; its replacement ; part of the message
        let cases = r#"
            <worldbody> ; <worldbody><replicate count="2"/> ; line 7: <replicate> cannot be read
            eulerseq ; inertiafromgeom="true" eulerseq ; inertiafromgeom="true" cannot be read
            ref="10" ; axis="0 0" ; axis
            mass="2" ; mass="two" ; mass="two" is not a number
            ref="10" ; ref="10deg" ; ref="10deg" is not a number
            euler="90 0 0" ; euler="90 0" ; 'euler'
            <worldbody> ; <include file="no.xml"/><worldbody> ; file="no.xml"
            name="turn" ; name="slide" ; the name 'slide' is used twice"#;
        for case in cases.trim().lines() {
            let [good, bad, named] = case.split(';').map(str::trim).collect::<Vec<_>>()[..] else {
                panic!("three columns: {case}");
            };
            assert!(MJCF.contains(good), "{good}");
            let error =
                parse("t", &MJCF.replacen(good, bad, 1), &Selection::default()).unwrap_err();
            assert!(error.to_string().contains(named), "{error}");
            assert_eq!(error.to_string().lines().count(), 1);
        }
    }
}
