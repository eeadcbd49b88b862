//! The path from base to tip, brought into Craig's link frames.

use super::document::{Document, JointElement};
use super::{Import, JointProblem, Selection, UrdfProblem};
use crate::robot::{Drive, Friction, Joint, Limits, Link, MAX_JOINTS, Placement, Robot};
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use std::f64::consts::TAU;

/// What a URDF does not say.
const ENCODER_BITS: u32 = 17;
const ACCELERATION: f64 = 10.0;
const CONTINUOUS_RANGE: (f64, f64) = (-TAU, TAU);

/// Builds the arm that the selection picks from the tree.
pub(super) fn arm(document: &Document, selection: &Selection<'_>) -> Result<Import, UrdfProblem> {
    let tree = Tree::of(document)?;
    let base = tree.base(selection)?;
    let path = match selection.tip {
        Some(name) => tree.path_to(base, tree.link(name, "--tip")?)?,
        None => tree.only_path(base)?,
    };
    let tip = path.last().map_or(base, |&joint| tree.child[joint]);
    let end = selection.tip.map(|_| tip);
    let moving = path.iter().filter(|&&joint| !tree.is_fixed(joint)).count();
    if !(1..=MAX_JOINTS).contains(&moving) {
        return Err(UrdfProblem::JointCount(moving));
    }
    let mut notes = tree.left_out(base, &path, end);
    let mut joints: Vec<Joint> = Vec::with_capacity(moving);
    // Frame of the current link in the frame of the joint that moves it (in the base frame at first).
    let mut link_frame = Placement::identity();
    for &index in &path {
        let element = &document.joints[index];
        if element.squared {
            notes.push(format!(
                "joint '{}': angles near right angles are taken as right angles",
                element.name
            ));
        }
        let joint_frame = link_frame.then(&element.origin);
        if tree.is_fixed(index) {
            link_frame = joint_frame;
            continue;
        }
        let turn = usable(element).and_then(z_onto_axis);
        let turn = turn.map_err(|problem| UrdfProblem::Joint {
            joint: element.name.clone(),
            problem,
        })?;
        // T(q) = P rot(axis, q) = P A Rz(q) Aᵀ with A z = axis: the joint frame is P A, the link frame Aᵀ in it.
        link_frame = turn.inverse();
        let link = tree.lumped(index, &link_frame, end)?;
        joints.push(Joint {
            name: element.name.clone(),
            placement: joint_frame.then(&turn).snapped(),
            link,
            drive: Drive {
                rotor_inertia: 0.0,
                gain: 1.0,
                encoder_bits: ENCODER_BITS,
            },
            friction: friction(element),
            limits: limits(element, &mut notes).map_err(|problem| UrdfProblem::Joint {
                joint: element.name.clone(),
                problem: JointProblem::Limit(problem),
            })?,
        });
    }
    notes.push(format!(
        "drives are not described: rotor inertias 0, gains 1 N·m/A, {ENCODER_BITS}-bit encoders"
    ));
    let robot = Robot {
        name: plain_name(&document.name),
        gravity: Vector3::new(0.0, 0.0, -9.81),
        joints,
        flange: link_frame.snapped(),
        log_columns: None,
    };
    Ok(Import { robot, notes })
}

/// Links and joints by index; every joint knows its links, every link the joints it carries.
struct Tree<'a> {
    document: &'a Document,
    parent: Vec<usize>,
    child: Vec<usize>,
    carried: Vec<Vec<usize>>,
    carrier: Vec<Option<usize>>,
}

impl<'a> Tree<'a> {
    fn of(document: &'a Document) -> Result<Self, UrdfProblem> {
        let count = document.links.len();
        let mut tree = Self {
            document,
            parent: Vec::new(),
            child: Vec::new(),
            carried: vec![Vec::new(); count],
            carrier: vec![None; count],
        };
        for (index, joint) in document.joints.iter().enumerate() {
            let named_by = format!("joint '{}'", joint.name);
            let parent = tree.link(&joint.parent, &named_by)?;
            let child = tree.link(&joint.child, &named_by)?;
            tree.parent.push(parent);
            tree.child.push(child);
            tree.carried[parent].push(index);
            if tree.carrier[child].replace(index).is_some() {
                return Err(UrdfProblem::NotATree(joint.child.clone()));
            }
        }
        // One parent each: whoever has more ancestors than there are links stands on a loop.
        for start in 0..count {
            let ancestors = std::iter::successors(Some(start), |&link| tree.below(link));
            if ancestors.take(count + 1).count() > count {
                return Err(UrdfProblem::NotATree(document.links[start].name.clone()));
            }
        }
        Ok(tree)
    }

    fn link(&self, name: &str, named_by: &str) -> Result<usize, UrdfProblem> {
        let found = self
            .document
            .links
            .iter()
            .position(|link| link.name == name);
        found.ok_or_else(|| UrdfProblem::UnknownLink {
            link: name.to_owned(),
            named_by: named_by.to_owned(),
        })
    }

    fn name(&self, link: usize) -> String {
        self.document.links[link].name.clone()
    }

    /// The link that carries this one.
    fn below(&self, link: usize) -> Option<usize> {
        self.carrier[link].map(|joint| self.parent[joint])
    }

    fn is_fixed(&self, joint: usize) -> bool {
        self.document.joints[joint].kind == "fixed"
    }

    fn base(&self, selection: &Selection<'_>) -> Result<usize, UrdfProblem> {
        if let Some(name) = selection.base {
            return self.link(name, "--base");
        }
        let mut roots = (0..self.carrier.len()).filter(|&link| self.carrier[link].is_none());
        match (roots.next(), roots.next()) {
            (Some(root), None) => Ok(root),
            (Some(first), Some(second)) => Err(UrdfProblem::Roots(
                [first, second]
                    .into_iter()
                    .chain(roots)
                    .map(|link| self.name(link))
                    .collect(),
            )),
            (None, _) => Err(UrdfProblem::Syntax("no links".to_owned())),
        }
    }

    /// Joints from base to tip.
    fn path_to(&self, base: usize, tip: usize) -> Result<Vec<usize>, UrdfProblem> {
        let mut path = Vec::new();
        let mut link = tip;
        while link != base {
            let Some(joint) = self.carrier[link] else {
                return Err(UrdfProblem::NotBelow {
                    base: self.name(base),
                    tip: self.name(tip),
                });
            };
            path.push(joint);
            link = self.parent[joint];
        }
        path.reverse();
        Ok(path)
    }

    /// Joints from base to the end of a tree in which no link carries more than one moving joint, itself or through
    /// what is bolted to it.
    fn only_path(&self, base: usize) -> Result<Vec<usize>, UrdfProblem> {
        let mut end = base;
        loop {
            let body = self.rigid_body(end, Placement::identity(), None);
            let moving: Vec<usize> = self.moving_joints(&body).collect();
            match moving[..] {
                [] => break,
                [joint] => end = self.child[joint],
                _ => {
                    return Err(UrdfProblem::Branch {
                        link: self.name(end),
                        joints: moving
                            .iter()
                            .map(|&joint| self.document.joints[joint].name.clone())
                            .collect(),
                    });
                }
            }
        }
        // A chain of fixed joints at the end leads to the flange; a fork of them does not.
        while let [joint] = self.carried[end][..] {
            end = self.child[joint];
        }
        self.path_to(base, end)
    }

    /// Links that move as one with `link`, which lies at `frame`; nothing beyond the link `end`.
    fn rigid_body(
        &self,
        link: usize,
        frame: Placement,
        end: Option<usize>,
    ) -> Vec<(usize, Placement)> {
        let mut body = vec![(link, frame)];
        let mut next = 0;
        while let Some(&(link, frame)) = body.get(next) {
            next += 1;
            if Some(link) == end {
                continue;
            }
            for &joint in self.carried[link]
                .iter()
                .filter(|&&joint| self.is_fixed(joint))
            {
                let origin = &self.document.joints[joint].origin;
                body.push((self.child[joint], frame.then(origin)));
            }
        }
        body
    }

    fn moving_joints(&self, body: &[(usize, Placement)]) -> impl Iterator<Item = usize> {
        body.iter()
            .flat_map(|&(link, _)| self.carried[link].iter().copied())
            .filter(|&joint| !self.is_fixed(joint))
    }

    /// One link for everything that joint `joint` moves as one body.
    fn lumped(
        &self,
        joint: usize,
        frame: &Placement,
        end: Option<usize>,
    ) -> Result<Link, UrdfProblem> {
        let mut parts = Vec::new();
        for (link, frame) in self.rigid_body(self.child[joint], *frame, end) {
            let element = &self.document.links[link];
            let Some(part) = &element.inertial else {
                continue;
            };
            let reason = if part.mass > 0.0 {
                let problem = Link::inertia_problem(&part.inertia_com);
                problem.map(|problem| format!("inertia {problem}"))
            } else {
                Some(format!("mass is {}, must be positive", part.mass))
            };
            if let Some(reason) = reason {
                return Err(UrdfProblem::NotABody {
                    link: element.name.clone(),
                    reason,
                });
            }
            parts.push(part.placed(&frame));
        }
        Link::lumped(&parts).ok_or_else(|| UrdfProblem::NoInertia {
            link: self.name(self.child[joint]),
            joint: self.document.joints[joint].name.clone(),
        })
    }

    /// What is not part of the arm, in words.
    fn left_out(&self, base: usize, path: &[usize], end: Option<usize>) -> Vec<String> {
        let moved = path
            .iter()
            .filter(|&&joint| !self.is_fixed(joint))
            .map(|&joint| self.child[joint]);
        let mut notes = Vec::new();
        for link in std::iter::once(base).chain(moved) {
            let body = self.rigid_body(link, Placement::identity(), end);
            let beside = self
                .moving_joints(&body)
                .filter(|joint| !path.contains(joint));
            let on_end = body.iter().filter(|(link, _)| Some(*link) == end);
            let on_end = on_end.flat_map(|&(link, _)| self.carried[link].iter().copied());
            let on_end = on_end.filter(|&joint| self.is_fixed(joint));
            notes.extend(beside.chain(on_end).map(|joint| {
                let joint = &self.document.joints[joint];
                format!(
                    "left out: link '{}' on joint '{}' and all it carries",
                    joint.child, joint.name
                )
            }));
        }
        notes
    }
}

fn usable(joint: &JointElement) -> Result<&JointElement, JointProblem> {
    if !matches!(joint.kind.as_str(), "revolute" | "continuous") {
        Err(JointProblem::Type(joint.kind.clone()))
    } else if joint.mimic {
        Err(JointProblem::Mimic)
    } else {
        Ok(joint)
    }
}

/// The smallest rotation A with A z = axis; it permutes axes when the axis is one of ±x, ±y, ±z.
fn z_onto_axis(joint: &JointElement) -> Result<Placement, JointProblem> {
    let axis = Unit::try_new(joint.axis, 1e-9).ok_or(JointProblem::Axis)?;
    let half_turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let rot = Rotation3::rotation_between(&Vector3::z(), &axis);
    let turn = Placement {
        // No smallest rotation onto −z: about x by convention.
        rot_parent_child: rot.map_or(half_turn, Rotation3::into_inner),
        origin: Vector3::zeros(),
    };
    Ok(turn.snapped())
}

fn friction(joint: &JointElement) -> Friction {
    let (viscous, coulomb) = joint.friction;
    Friction {
        viscous,
        coulomb,
        stribeck_ratio: 0.0,
        stribeck_velocity: 1.0,
        cogging: 0.0,
        cogging_cycles_rev: 0.0,
    }
}

fn limits(joint: &JointElement, notes: &mut Vec<String>) -> Result<Limits, String> {
    let limit = &joint.limit;
    let positive = |name: &str, value: Option<f64>| match value {
        Some(value) if value > 0.0 => Ok(value),
        Some(value) => Err(format!("has the {name} limit {value}, must be positive")),
        None => Err(format!("has no {name} limit")),
    };
    let position = match (joint.kind.as_str(), limit.lower, limit.upper) {
        (_, Some(lower), Some(upper)) if lower < upper => (lower, upper),
        ("continuous", ..) => {
            notes.push(format!(
                "joint '{}' is continuous: its range is taken as ±2π rad",
                joint.name
            ));
            CONTINUOUS_RANGE
        }
        _ => return Err("needs a lower limit below its upper limit".to_owned()),
    };
    let acceleration = match limit.acceleration {
        Some(_) => positive("acceleration", limit.acceleration)?,
        None => {
            notes.push(format!(
                "joint '{}' has no acceleration limit: {ACCELERATION} rad/s² is taken",
                joint.name
            ));
            ACCELERATION
        }
    };
    Ok(Limits {
        position,
        velocity: positive("velocity", limit.velocity)?,
        acceleration,
        torque: positive("effort", limit.effort)?,
    })
}

/// Lower-case letters, digits and underscores, a letter first: what the name of a Rust module allows.
fn plain_name(name: &str) -> String {
    let plain: String = name
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() {
                c.to_ascii_lowercase()
            } else {
                '_'
            }
        })
        .collect();
    if plain.starts_with(|c: char| c.is_ascii_lowercase()) {
        plain
    } else {
        format!("arm_{plain}")
    }
}
