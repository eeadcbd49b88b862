//! Writes the constants of an arm as a module of the firmware.

use crate::robot::{LINK_PARAMETERS, Robot};
use foretorque::arm::{LinkColumns, Placement, identity};
use std::fmt::Write;

/// Source text of the firmware module for a robot: geometry, base-parameter map, limits, nominal parameters.
///
/// The text is data; nobody has to read it. It is left unformatted on purpose (`rustfmt::skip`), a row a line.
pub fn arm_module(robot: &Robot) -> String {
    let map = robot.base_map();
    let type_name = camel_case(&robot.name);
    let mut out = String::new();
    // Writing into a String cannot fail.
    let mut line = |text: &str| {
        let _ = writeln!(out, "{text}");
    };
    line(&format!(
        "//! Constants of `{}`, written by `host-sim generate` from its description. Change that, not this.",
        robot.name
    ));
    line("");
    line("use super::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};");
    line("");
    line("/// Number of joints.");
    line(&format!(
        "pub const JOINTS: usize = {};",
        robot.joint_count()
    ));
    line("/// Number of base parameters: inertial ones, then rotor inertias.");
    line(&format!("pub const PARAMETERS: usize = {};", map.rank()));
    line("");
    line(&format!("/// The arm `{}`.", robot.name));
    line("#[derive(Clone, Copy, Debug, PartialEq, Eq)]");
    line(&format!("pub struct {type_name};"));
    line("");
    line("#[rustfmt::skip]");
    line(&format!("impl Arm<JOINTS, PARAMETERS> for {type_name} {{"));
    line(&format!("    const NAME: &'static str = {:?};", robot.name));
    line(&format!(
        "    const GRAVITY: [f32; 3] = {:?};",
        gravity(robot)
    ));
    line("    const PLACEMENTS: [Placement; JOINTS] = [");
    for placement in placements(robot) {
        line(&format!("        {placement:?},"));
    }
    line("    ];");
    line("    const COLUMNS: [LinkColumns; JOINTS] = [");
    for columns in link_columns(robot, &map.columns) {
        line(&format!("        {columns:?},"));
    }
    line("    ];");
    line("    const BASE_MAP: &'static [BaseTerm] = &[");
    for term in &map.terms {
        let weight = term.weight as f32;
        line(&format!(
            "        BaseTerm::new({}, {}, {weight:?}),",
            term.base, term.standard
        ));
    }
    line("    ];");
    line("    const LIMITS: [JointLimits; JOINTS] = [");
    for joint in &robot.joints {
        let (lower, upper) = joint.limits.position;
        line(&format!(
            "        JointLimits {{ position: ({}, {}), velocity: {}, torque: {} }},",
            number(lower),
            number(upper),
            number(joint.limits.velocity),
            number(joint.limits.torque)
        ));
    }
    line("    ];");
    line("    const NOMINAL: [f32; PARAMETERS] = [");
    for value in map.base_parameters(robot) {
        line(&format!("        {:?},", value as f32));
    }
    line("    ];");
    line("}");
    out
}

/// Identity of a robot's arm, as the firmware built from [`arm_module`] will state it.
pub fn arm_hash(robot: &Robot) -> u32 {
    let columns = link_columns(robot, &robot.base_map().columns);
    let placements = placements(robot);
    fn of<const N: usize>(
        gravity: &[f32; 3],
        placements: &[Placement],
        columns: &[LinkColumns],
    ) -> Option<u32> {
        Some(identity::<N>(
            gravity,
            placements.try_into().ok()?,
            columns.try_into().ok()?,
        ))
    }
    let of_size = [
        of::<1>, of::<2>, of::<3>, of::<4>, of::<5>, of::<6>, of::<7>, of::<8>,
    ];
    of_size
        .iter()
        .find_map(|of| of(&gravity(robot), &placements, &columns))
        .expect("a description is refused unless it has 1 to 8 joints")
}

fn gravity(robot: &Robot) -> [f32; 3] {
    robot.gravity.map(|g| g as f32).into()
}

fn placements(robot: &Robot) -> Vec<Placement> {
    let single = |joint: &crate::robot::Joint| {
        let rot = joint.placement.rot_parent_child.map(|entry| entry as f32);
        Placement {
            rot_parent_child: std::array::from_fn(|row| std::array::from_fn(|col| rot[(row, col)])),
            // Products of a right angle's 0 may come out as −0, which is not the 0 that costs nothing.
            origin: joint.placement.origin.map(|x| x as f32 + 0.0).into(),
        }
    };
    robot.joints.iter().map(single).collect()
}

fn link_columns(robot: &Robot, independent: &[usize]) -> Vec<LinkColumns> {
    let rotors = LINK_PARAMETERS * robot.joint_count();
    (0..robot.joint_count())
        .map(|link| LinkColumns {
            inertial: std::array::from_fn(|k| independent.contains(&(LINK_PARAMETERS * link + k))),
            rotor: independent.contains(&(rotors + link)),
        })
        .collect()
}

/// A number as Rust source; fractions of a turn by their names, as the lints want them.
fn number(value: f64) -> String {
    use core::f32::consts::{FRAC_PI_2, PI, TAU};
    let value = value as f32;
    let names = [("FRAC_PI_2", FRAC_PI_2), ("PI", PI), ("TAU", TAU)];
    match names.iter().find(|(_, named)| *named == value.abs()) {
        Some((name, _)) => {
            let sign = if value < 0.0 { "-" } else { "" };
            format!("{sign}core::f32::consts::{name}")
        }
        None => format!("{value:?}"),
    }
}

/// `ur5` becomes `Ur5`, `my_arm` becomes `MyArm`.
fn camel_case(name: &str) -> String {
    name.split('_')
        .flat_map(|word| {
            let mut letters = word.chars();
            let first = letters.next().map(|c| c.to_ascii_uppercase());
            first.into_iter().chain(letters)
        })
        .collect()
}
