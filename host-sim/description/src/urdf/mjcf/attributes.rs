//! Values of an element, its own or those of its class, and the settings that decide what they mean.

use super::*;
use crate::robot::TURN;
use std::f64::consts::PI;

impl<'a, 'input> Reader<'a, 'input> {
    /// Takes the settings of `<compiler>`.
    ///
    /// Errors: one that changes masses or places, which MuJoCo alone can apply.
    pub(super) fn compiler(&mut self, node: Node<'a, 'input>) -> Result<(), String> {
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
                return Err(unreadable(node, &format!("{name}=\"{value}\" ")));
            }
        }
        Ok(())
    }

    /// Attribute of an element, or of its default class, the nearest first.
    ///
    /// * `class` default class of the elements around
    pub(super) fn attribute(
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
            let is_default = |n: &Node<'_, '_>| n.has_tag_name("default");
            let defaults = self.root.descendants().filter(is_default);
            let mut outer = None;
            for default in defaults.filter(|default| class_of(*default) == class) {
                outer = default.parent().filter(is_default);
                // All actuators of a class have one set of defaults, under whatever name they stand: the last counts.
                let is_own = |n: &Node<'_, '_>| {
                    let other = n.tag_name().name();
                    other == tag || is_actuator(tag) && is_actuator(other)
                };
                let mut own = default.children().filter(is_own);
                if let Some(found) = own.rfind(|n| n.has_attribute(name)) {
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

    pub(super) fn value(
        &self,
        node: Node<'a, 'input>,
        class: &str,
        name: &str,
    ) -> Result<Option<f64>, String> {
        let found = self.attribute(node, class, name);
        found.map_or(Ok(None), |found| optional(found, name))
    }

    /// Numbers of an attribute; none where it is not given.
    pub(super) fn values(
        &self,
        node: Node<'a, 'input>,
        class: &str,
        name: &str,
    ) -> Result<Vec<f64>, String> {
        let found = self.attribute(node, class, name);
        found.map_or(Ok(Vec::new()), |found| numbers(found, name))
    }

    /// The two ends of `name`, if `limited` does not switch them off.
    pub(super) fn range(
        &self,
        node: Node<'a, 'input>,
        class: &str,
        [name, limited]: [&str; 2],
    ) -> Result<Option<(f64, f64)>, String> {
        let on = self.attribute(node, class, limited);
        let on = on.and_then(|on| on.attribute(limited)).unwrap_or("auto");
        let on = on == "true" || (on == "auto" && self.autolimits);
        match self.values(node, class, name)?[..] {
            [low, high] if on && low < high => Ok(Some((low, high))),
            [] | [_, _] => Ok(None),
            _ => Err(problem(node, &format!("{name} is not two numbers"))),
        }
    }

    /// An angle as written, rad.
    pub(super) fn angle(&self, written: f64) -> f64 {
        if self.degrees {
            written.to_radians()
        } else {
            written
        }
    }

    /// Rotation by three Euler angles in the order of the file.
    fn turned(&self, angles: &[f64]) -> Rotation3<f64> {
        let mut rot = Rotation3::identity();
        for (axis, angle) in self.euler.chars().zip(angles) {
            let about = match axis.to_ascii_lowercase() {
                'x' => Vector3::x_axis(),
                'y' => Vector3::y_axis(),
                _ => Vector3::z_axis(),
            };
            let turn = Rotation3::from_axis_angle(&about, squared(self.angle(*angle)));
            // Lower case turns about the axes as they move, upper case about the fixed ones.
            rot = match axis.is_ascii_lowercase() {
                true => rot * turn,
                false => turn * rot,
            };
        }
        rot
    }

    /// Position and orientation of an element in the one around it.
    pub(super) fn pose(&self, node: Node<'a, 'input>) -> Result<Placement, String> {
        let bad = |name: &str| {
            let what = format!("has an attribute '{name}' of another length than its kind has");
            problem(node, &what)
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
                    let axis = unit(Vector3::new(x, y, z))?;
                    Rotation3::from_axis_angle(&axis, squared(self.angle(angle)))
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
                    least.unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), PI))
                }
                ("euler", angles @ &[_, _, _]) => self.turned(angles),
                _ => return Err(bad(name)),
            };
        }
        // As of a URDF: right angles written in decimals are right angles.
        let exact = rot.matrix().map(f64::round);
        let near = (rot.matrix() - exact).amax() < RIGHT_ANGLE_TOLERANCE;
        let (roll, pitch, yaw) = rot.euler_angles();
        let written = Vector3::new(roll, pitch, yaw);
        let rpy = written.map(squared);
        let placed = Placement {
            rot_parent_child: match near {
                true => exact,
                false if rpy == written => rot.into_inner(),
                false => Placement::from_xyz_rpy(Vector3::zeros(), rpy).rot_parent_child,
            },
            origin: vector(node, "pos")?.unwrap_or_default(),
        };
        Ok(placed.snapped())
    }
}

/// Numbers of an attribute; none where it is not given.
pub(super) fn numbers(node: Node<'_, '_>, name: &str) -> Result<Vec<f64>, String> {
    let Some(text) = node.attribute(name) else {
        return Ok(Vec::new());
    };
    list(text).ok_or_else(|| problem(node, &format!("{name}=\"{text}\" is not a list of numbers")))
}

/// Every range of a joint lies within a turn in radians, but for rounding to two decimals. In degrees no arm moves with such
/// ranges: the file is a part of one that names the unit.
pub(super) fn ranges_are_radians(root: Node<'_, '_>) -> bool {
    let joints = root.descendants().filter(|n| n.has_tag_name("joint"));
    let ranges = joints.filter_map(|joint| numbers(joint, "range").ok());
    let ends: Vec<f64> = ranges.flatten().collect();
    !ends.is_empty() && ends.iter().all(|end| end.abs() < TURN)
}

fn class_of<'a>(default: Node<'a, '_>) -> &'a str {
    default.attribute("class").unwrap_or("main")
}

fn is_actuator(tag: &str) -> bool {
    let tags = [
        "general",
        "motor",
        "position",
        "velocity",
        "intvelocity",
        "damper",
    ];
    tags.contains(&tag)
}
