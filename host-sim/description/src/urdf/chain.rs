//! The path from base to tip, brought into Craig's link frames.

use super::document::{Document, JointElement};
use super::tree::Tree;
use super::{ACCELERATION, Assumed, ENCODER_BITS, Import, Selection, VELOCITY};
use crate::robot::{Drive, Friction, Joint, Limits, MAX_JOINTS, Placement, Robot, Workspace};
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use std::f64::consts::{PI, TAU};

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
    let mut assumed = Vec::with_capacity(moving);
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
        let written = document.links[tree.child[index]].inertial;
        let mut own = Assumed::of_written(written.as_ref());
        let limits = limits(element, &mut own).map_err(of_joint)?;
        let link = tree.lumped(index, &link_frame, selection, &mut own, &mut notes)?;
        own.fields.extend(["gain_nm_a", "encoder_bits"]);
        if element.rotor == 0.0 {
            own.fields.insert("rotor_inertia_kg_m2");
        }
        assumed.push(own);
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
            limits,
            // Collision shapes of a URDF are meshes as a rule.
            capsules: Vec::new(),
            link_name: Some(document.links[tree.child[index]].name.clone()),
            link_frame,
            dh_frame: None,
        });
    }
    let gravity = tree.root_in(base).rot_parent_child * document.gravity;
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
    let tilted = gravity != document.gravity;
    let mut import = Import {
        robot,
        parts: notes,
        assumed,
        tilted,
    };
    import.derive_limits();
    Ok(import)
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

/// * `own` gets the names of values that the file does not give
fn limits(joint: &JointElement, own: &mut Assumed) -> Result<Limits, String> {
    let limit = &joint.limit;
    for (what, value) in [("velocity", limit.velocity), ("torque", limit.effort)] {
        if let Some(value) = value.filter(|value| *value < 0.0) {
            return Err(format!(
                "has the {what} limit {value}, must not be negative"
            ));
        }
    }
    let [velocity, torque] =
        [limit.velocity, limit.effort].map(|value| value.filter(|value| *value > 0.0));
    let (position, ranged) = match (joint.kind.as_str(), limit.lower, limit.upper) {
        ("continuous", ..) => ((-TAU, TAU), false),
        // As files have it whose converter wants a number.
        (_, Some(lower), Some(upper)) if lower < -ENDLESS && upper > ENDLESS => {
            ((-TAU, TAU), false)
        }
        (_, Some(lower), Some(upper)) if lower < upper => ((lower, upper), true),
        // As files have it that give no range.
        (_, None, None) | (_, Some(0.0), Some(0.0) | None) | (_, None, Some(0.0)) => {
            ((-PI, PI), false)
        }
        _ => {
            let problem = "needs a lower limit below its upper limit (or none: ±π rad is taken)";
            return Err(problem.to_owned());
        }
    };
    let acceleration = limit.acceleration.unwrap_or(ACCELERATION);
    if acceleration <= 0.0 {
        return Err(format!(
            "has the acceleration limit {acceleration}, must be positive"
        ));
    }
    let given = [
        ("position_rad", ranged),
        ("velocity_rad_s", velocity.is_some()),
        ("acceleration_rad_s2", limit.acceleration.is_some()),
        ("torque_nm", torque.is_some()),
    ];
    let missing = given.iter().filter(|(_, given)| !given);
    own.fields.extend(missing.map(|(field, _)| *field));
    let velocity = velocity.unwrap_or(VELOCITY);
    own.velocity = Some(velocity);
    Ok(Limits {
        position,
        velocity,
        acceleration,
        // Where there is none, taken from the weight in the end.
        torque: torque.unwrap_or(0.0),
    })
}

/// Angle beyond which a range is none, rad: no sample may have it.
const ENDLESS: f64 = foretorque::math::LARGEST_ANGLE as f64;

/// A name like `name` that an arm may have.
fn plain_name(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    let plain = name.replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    match Robot::is_name(&plain) {
        true => plain,
        false => format!("arm_{plain}"),
    }
}
