//! The path from base to tip, brought into Craig's link frames.

use super::document::{Document, JointElement};
use super::tree::Tree;
use super::{Import, Selection};
use crate::robot::{
    Drive, Friction, Joint, Limits, Link, MAX_JOINTS, Placement, Robot, TURN, Workspace,
};
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use std::f64::consts::{PI, TAU};

/// Default of a property that a URDF does not have.
const ENCODER_BITS: u32 = 17;
const ACCELERATION: f64 = 10.0;
const VELOCITY: f64 = 2.0;
/// Torque limit where the file gives none, in units of the weight at full stretch with friction and rotor at their largest, and
/// added to it, N·m.
const TORQUE: (f64, f64) = (1.5, 1.0);
/// Largest share of a torque limit that friction takes at the velocity limit.
const FRICTION_SHARE: f64 = 0.75;

pub(super) fn arm(document: &Document, selection: &Selection<'_>) -> Result<Import, String> {
    let mut tree = Tree::of(document)?;
    let base = tree.base(selection)?;
    let path = match selection.tip {
        Some(name) => tree.path_to(base, tree.link_or_joint(name, "--tip", false)?)?,
        None => tree.only_path(base)?,
    };
    let tip = path.last().map_or(base, |&joint| tree.child[joint]);
    if selection.weld {
        tree.weld(&path);
    }
    let of_joint = |index: usize, problem: String| {
        format!("joint '{}' {problem}", document.joints[index].name)
    };
    let turn = |index: usize| {
        let turn = usable(&document.joints[index]).and_then(z_onto_axis);
        turn.map_err(|problem| of_joint(index, problem + &without(document, &path)))
    };
    let moved = path.iter().copied().filter(|&j| !tree.is_fixed(j));
    let moved: Vec<usize> = moved.collect();
    // Before the joints are counted: an arm of many joints stands on a lift or a floating base as a rule.
    for &index in &moved {
        turn(index)?;
    }
    let moving = moved.len();
    if moving > MAX_JOINTS {
        let base = &document.joints[moved[moving - MAX_JOINTS]].parent;
        let tip = &document.joints[moved[MAX_JOINTS - 1]].child;
        return Err(format!(
            "{moving} moving joints, an arm has at most {MAX_JOINTS}: choose its ends, such as --base '{base}' or --tip '{tip}'"
        ));
    }
    if moving == 0 {
        return Err("no moving joint between base and tip".to_owned());
    }
    let mut notes = tree.left_out(base, &path);
    notes.extend(selection.tip.and_then(|_| tree.bolted_behind(tip)));
    notes.extend(document.notes.iter().cloned());
    let tip_name = &document.links[tip].name;
    if !notes.is_empty() {
        notes.insert(0, format!("the arm ends at link '{tip_name}'"));
    }
    let mut joints: Vec<Joint> = Vec::with_capacity(moving);
    // Frame of the current link in the frame of the joint that moves it (in the base frame at first).
    let mut link_frame = Placement::identity();
    for &index in &path {
        let element = &document.joints[index];
        if element.squared {
            let name = &element.name;
            notes.push(format!(
                "joint '{name}': angles near right angles are taken as right angles"
            ));
        }
        let joint_frame = link_frame.then(&element.origin);
        if tree.is_fixed(index) {
            link_frame = joint_frame;
            continue;
        }
        let turn = turn(index)?;
        let of_joint = |problem: String| of_joint(index, problem);
        // T(q) = P rot(axis, q) = P A Rz(q) Aᵀ with A z = axis: the joint frame is P A, the link frame Aᵀ in it.
        link_frame = turn.inverse();
        let link = tree.lumped(index, &link_frame, selection, &mut notes)?;
        joints.push(Joint {
            name: element.name.clone(),
            placement: joint_frame.then(&turn).snapped(),
            link,
            drive: Drive {
                rotor_inertia: element.rotor,
                gain: None,
                encoder_bits: ENCODER_BITS,
            },
            friction: friction(element).map_err(of_joint)?,
            limits: limits(element, &mut notes).map_err(of_joint)?,
            // Collision shapes of a URDF are meshes as a rule.
            capsules: Vec::new(),
            link_name: Some(document.links[tree.child[index]].name.clone()),
            link_frame,
            dh_frame: None,
        });
    }
    let elements = moved.iter().map(|&joint| &document.joints[joint]);
    let without = elements.filter(|joint| joint.limit.acceleration.is_none());
    let without: Vec<&str> = without.map(|joint| joint.name.as_str()).collect();
    if !without.is_empty() {
        let names = without.join("', '");
        notes.push(format!(
            "no acceleration limit at joints '{names}': {ACCELERATION} rad/s² is taken"
        ));
    }
    let inertial = |&joint: &usize| document.links[tree.child[joint]].inertial;
    let written: Vec<Option<Link>> = moved.iter().map(inertial).collect();
    placeholders(&joints, &link_frame, &written, &mut notes);
    assume_torques(&mut joints, &mut notes);
    let bare = joints.iter().all(|joint| joint.drive.rotor_inertia == 0.0);
    let rotors = if bare { "rotor inertias 0, " } else { "" };
    notes.push(format!(
        "drives are not described: {rotors}gains not known, {ENCODER_BITS}-bit encoders"
    ));
    lower_speeds(&mut joints, &mut notes);
    let root = tree.root_in(base);
    let gravity = root.rot_parent_child * document.gravity;
    if gravity != document.gravity {
        let [x, y, z] = gravity.into();
        notes.push(format!(
            "link '{}' is tilted against the root: gravity is ({x:.3}, {y:.3}, {z:.3}) m/s² in its frame",
            document.links[base].name
        ));
    }
    let robot = Robot {
        name: plain_name(&document.name),
        gravity,
        joints,
        flange: link_frame.snapped(),
        link_names: Some((document.links[base].name.clone(), tip_name.clone())),
        coupling: None,
        log_columns: None,
        workspace: Workspace::default(),
    };
    Ok(Import { robot, notes })
}

/// The options that keep the longest part of the path without unusable joints, in brackets; the last of equal ones.
fn without(document: &Document, path: &[usize]) -> String {
    let is_fixed = |joint: usize| document.joints[joint].kind == "fixed";
    let turn = |joint: usize| usable(&document.joints[joint]).and_then(z_onto_axis);
    let stops = |joint: &usize| !is_fixed(*joint) && turn(*joint).is_err();
    let parts = path.split(stops).enumerate();
    let turning = |part: &[usize]| part.iter().filter(|&&joint| !is_fixed(joint)).count();
    let longest = parts.max_by_key(|(_, part)| turning(part));
    let Some((number, _)) = longest.filter(|(_, part)| turning(part) > 0) else {
        return String::new();
    };
    let stops: Vec<usize> = path.iter().copied().filter(stops).collect();
    let base = number.checked_sub(1).map(|before| stops[before]);
    let base = base.map(|joint| &document.joints[joint].child);
    let tip = stops.get(number);
    let tip = tip.map(|&joint| &document.joints[joint].parent);
    match (base, tip) {
        (Some(base), Some(tip)) => format!(" (--base '{base}' --tip '{tip}' leave it out)"),
        (Some(base), None) => format!(" (--base '{base}' begins behind it)"),
        (None, Some(tip)) => format!(" (--tip '{tip}' ends before it)"),
        (None, None) => String::new(),
    }
}

fn usable(joint: &JointElement) -> Result<&JointElement, String> {
    match joint.kind.as_str() {
        "revolute" | "continuous" if joint.mimic => {
            Err("mimics another joint: an arm's joints move on their own".to_owned())
        }
        "revolute" | "continuous" => Ok(joint),
        kind => Err(format!(
            "is {kind}: only revolute, continuous and fixed joints are supported"
        )),
    }
}

/// The smallest rotation A with A z = axis; it permutes axes when the axis is one of ±x, ±y, ±z.
fn z_onto_axis(joint: &JointElement) -> Result<Placement, String> {
    let axis = Unit::try_new(joint.axis, 1e-9).ok_or("has an axis of length zero")?;
    let half_turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let rot = Rotation3::rotation_between(&Vector3::z(), &axis);
    let turn = Placement {
        // No smallest rotation onto −z: about x by convention.
        rot_parent_child: rot.map_or(half_turn, Rotation3::into_inner),
        origin: Vector3::zeros(),
    };
    Ok(turn.snapped())
}

fn friction(joint: &JointElement) -> Result<Friction, String> {
    let (viscous, coulomb) = joint.friction;
    for (what, value) in [
        ("viscous friction", viscous),
        ("Coulomb friction", coulomb),
        ("rotor inertia", joint.rotor),
    ] {
        if value < 0.0 {
            return Err(format!("has the {what} {value}, must not be negative"));
        }
    }
    Ok(Friction {
        viscous,
        coulomb,
        stribeck_ratio: 0.0,
        stribeck_velocity: 1.0,
        cogging: 0.0,
        cogging_cycles_rev: 0.0,
    })
}

fn limits(joint: &JointElement, notes: &mut Vec<String>) -> Result<Limits, String> {
    let (limit, name) = (&joint.limit, &joint.name);
    for (what, value) in [("velocity", limit.velocity), ("torque", limit.effort)] {
        if let Some(value) = value.filter(|value| *value < 0.0) {
            return Err(format!(
                "has the {what} limit {value}, must not be negative"
            ));
        }
    }
    let velocity = limit.velocity.filter(|value| *value > 0.0);
    if velocity.is_none() {
        notes.push(format!(
            "joint '{name}': no velocity limit, {VELOCITY} rad/s is taken"
        ));
    }
    let fast = velocity.filter(|value| *value > FAST);
    if let Some(velocity) = fast {
        notes.push(format!(
            "joint '{name}': its velocity limit is {velocity} rad/s: are these degrees?"
        ));
    }
    let continuous = |notes: &mut Vec<String>| {
        notes.push(format!(
            "joint '{name}' is continuous: its range is taken as ±2π rad"
        ));
        (-TAU, TAU)
    };
    let position = match (joint.kind.as_str(), limit.lower, limit.upper) {
        // As files have it whose converter wants a number.
        (_, Some(lower), Some(upper)) if lower < -ENDLESS && upper > ENDLESS => continuous(notes),
        ("continuous", ..) => continuous(notes),
        (_, Some(lower), Some(upper)) if lower < upper => (lower, upper),
        // As files have it that give no range.
        (_, None, None) | (_, Some(0.0), Some(0.0) | None) | (_, None, Some(0.0)) => {
            notes.push(format!("joint '{name}': no range, ±π rad is taken"));
            (-PI, PI)
        }
        _ => {
            let problem = "needs a lower limit below its upper limit (or none: ±π rad is taken)";
            return Err(problem.to_owned());
        }
    };
    let (lower, upper) = position;
    if lower.abs().max(upper.abs()) > TURN {
        notes.push(format!(
            "joint '{name}': its range {lower} … {upper} rad ends beyond a turn: are these degrees?"
        ));
    }
    let acceleration = limit.acceleration.unwrap_or(ACCELERATION);
    if acceleration <= 0.0 {
        return Err(format!(
            "has the acceleration limit {acceleration}, must be positive"
        ));
    }
    Ok(Limits {
        position,
        velocity: velocity.unwrap_or(VELOCITY),
        acceleration,
        // Not positive: taken from the weight in the end.
        torque: limit.effort.unwrap_or(0.0),
    })
}

/// Angle beyond which a range is none, rad: no sample may have it.
const ENDLESS: f64 = foretorque::math::LARGEST_ANGLE as f64;

/// Speed beyond which no drive of an arm turns, rad/s: the fastest without a gear reach 45.
const FAST: f64 = 50.0;
/// Largest radius of gyration without a note, in units of the link's length; those of the Panda have up to two.
const WIDE: f64 = 3.0;
/// Thickness of a link, m: that of an assumed rod.
const THICKNESS: f64 = 0.1;

/// Notes inertias that placeholders and other units give: a radius of gyration of several lengths of the link, or one inertia for
/// all axes of several links.
fn placeholders(
    joints: &[Joint],
    flange: &Placement,
    written: &[Option<Link>],
    notes: &mut Vec<String>,
) {
    let ends = joints.iter().skip(1).map(|joint| &joint.placement);
    for (joint, end) in joints.iter().zip(ends.chain([flange])) {
        let link = &joint.link;
        let length = link.com.norm() + (end.origin - link.com).norm() + THICKNESS;
        let radius = (link.inertia_com.trace() / 2.0 / link.mass).sqrt();
        if radius > WIDE * length {
            notes.push(format!(
                "link '{}': the inertia is that of a body of {radius:.2} m radius of gyration, the link is about {length:.2} m long: a placeholder, or other units? correct it in the file",
                link_name(joint)
            ));
        }
    }
    let near = |a: &Matrix3<f64>, b: &Matrix3<f64>| (a - b).amax() <= 1e-9 * a.amax();
    let ball = |link: &Option<Link>| {
        let inertia = link.as_ref()?.inertia_com;
        near(&inertia, &Matrix3::from_diagonal_element(inertia.m11)).then_some(inertia)
    };
    let balls: Vec<Option<Matrix3<f64>>> = written.iter().map(ball).collect();
    let is_shared = |ball: &Option<Matrix3<f64>>| {
        let Some(ball) = ball else { return false };
        let others = balls.iter().flatten();
        others.filter(|other| near(ball, other)).count() > 1
    };
    let pairs = joints.iter().zip(&balls);
    let shared = pairs.filter(|(_, ball)| is_shared(ball));
    let shared: Vec<&str> = shared.map(|(joint, _)| link_name(joint)).collect();
    if !shared.is_empty() {
        notes.push(format!(
            "links '{}' share one inertia, the same about all axes: a placeholder? correct it in the file",
            shared.join("', '")
        ));
    }
}

fn link_name(joint: &Joint) -> &str {
    joint.link_name.as_deref().unwrap_or_default()
}

/// Gives joints without a torque limit one and a half of what the arm weighs at full stretch, of friction at the velocity limit
/// and of the rotor at the acceleration limit, and 1 N·m.
fn assume_torques(joints: &mut [Joint], notes: &mut Vec<String>) {
    for index in 0..joints.len() {
        if joints[index].limits.torque > 0.0 {
            continue;
        }
        let (mut lever, mut weight) = (0.0, 0.0);
        for (place, joint) in joints.iter().enumerate().skip(index) {
            if place > index {
                lever += joint.placement.origin.norm();
            }
            weight += 9.81 * joint.link.mass * (lever + joint.link.com.norm());
        }
        let joint = &mut joints[index];
        let (friction, limits) = (&joint.friction, &joint.limits);
        let own = friction.coulomb
            + friction.viscous * limits.velocity
            + joint.drive.rotor_inertia * limits.acceleration;
        let torque = (TORQUE.0 * (weight + own) + TORQUE.1).ceil();
        joint.limits.torque = torque;
        notes.push(format!(
            "joint '{}': no torque limit, {torque} N·m is taken, 1.5 of the weight at full stretch, friction and rotor",
            joint.name
        ));
    }
}

/// Lowers velocity limits that a joint does not reach, because friction leaves no torque there.
fn lower_speeds(joints: &mut [Joint], notes: &mut Vec<String>) {
    for joint in joints {
        let (friction, limits) = (&joint.friction, &mut joint.limits);
        let reached = (FRICTION_SHARE * limits.torque - friction.coulomb) / friction.viscous;
        if reached > 0.0 && reached < limits.velocity {
            let percent = 100.0 * FRICTION_SHARE;
            notes.push(format!(
                "joint '{}': friction takes {percent:.0} % of the torque limit at {reached:.3} rad/s, which is taken as velocity limit in place of {} rad/s",
                joint.name, limits.velocity
            ));
            limits.velocity = reached;
        }
    }
}

/// A name like `name` that an arm may have.
fn plain_name(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    let plain = name.replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    match Robot::is_name(&plain) {
        true => plain,
        false => format!("arm_{plain}"),
    }
}
