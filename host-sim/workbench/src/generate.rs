//! Writes the constants of an arm as a module of the firmware.

use crate::dynamics::BaseMapTerm;
use crate::files::{at, write_whole};
use crate::robot::{Joint, LINK_PARAMETERS, Robot};
use foretorque::arm::{LinkColumns, Placement, identity};
use std::path::Path;

/// Source text of the firmware module for a robot: geometry, base-parameter map, limits, nominal parameters.
///
/// The text is data, left unformatted on purpose (`rustfmt::skip`), a row a line.
pub fn arm_module(robot: &Robot) -> String {
    let map = robot.base_map();
    let (name, arm) = (&robot.name, camel_case(&robot.name));
    let (joints, parameters) = (robot.joint_count(), map.rank());
    let sizes = "JOINTS, PARAMETERS";
    let with_arm = format!("{arm}, {sizes}");
    let aliases = [
        ("Feed-forward", "feedforward", "FeedForward", &*with_arm),
        ("Learner", "learning", "Learner", &with_arm),
        ("Learner configuration", "learning", "LearnerConfig", sizes),
        ("Parameter set", "learning", "ParameterSet", sizes),
        (
            "Exchange between feed-forward and learner",
            "learning",
            "Exchange",
            sizes,
        ),
    ];
    let aliases = aliases.map(|(quantity, module, alias, generics)| {
        format!("/// {quantity} of this arm.\npub type {alias} = foretorque::{module}::{alias}<{generics}>;\n")
    });
    let rows = |rows: Vec<String>| -> String {
        let row = |row| format!("        {row},\n");
        rows.into_iter().map(row).collect()
    };
    let placed = rows(placements(robot).iter().map(|p| format!("{p:?}")).collect());
    let columns = link_columns(robot, &map.columns);
    let columns = rows(columns.iter().map(|c| format!("{c:?}")).collect());
    let term = |t: &BaseMapTerm| {
        format!(
            "BaseTerm::new({}, {}, {:?})",
            t.base, t.standard, t.weight as f32
        )
    };
    let terms = rows(map.terms.iter().map(term).collect());
    let limits = |joint: &Joint| {
        let [lower, upper, velocity, torque] = [
            joint.limits.position.0,
            joint.limits.position.1,
            joint.limits.velocity,
            joint.limits.torque,
        ]
        .map(number);
        format!(
            "JointLimits {{ position: ({lower}, {upper}), velocity: {velocity}, torque: {torque} }}"
        )
    };
    let limits = rows(robot.joints.iter().map(limits).collect());
    let each = |of: fn(&Joint) -> f64| -> Vec<f32> {
        robot.joints.iter().map(|joint| of(joint) as f32).collect()
    };
    let cycles = each(|joint| joint.friction.cogging_cycles_rev);
    let cogging = if cycles.iter().any(|cycles| *cycles != 0.0) {
        format!("    const COGGING_CYCLES: [f32; JOINTS] = {cycles:?};\n")
    } else {
        String::new()
    };
    let base = map.base_parameters(robot).into_iter();
    let nominal = rows(base.map(|value| format!("{:?}", value as f32)).collect());
    // As of the placements: −0 is 0.
    let link = |joint: &Joint| joint.link.standard_parameters().map(|x| x as f32 + 0.0);
    let links = rows(
        robot
            .joints
            .iter()
            .map(|joint| format!("{:?}", link(joint)))
            .collect(),
    );
    let rotors = each(|joint| joint.drive.rotor_inertia);
    format!(
        "\
//! Constants of `{name}`, written by `host-sim generate` from its description. Change that, not this.

use foretorque::arm::{{Arm, BaseTerm, JointLimits, LinkColumns, Placement}};

/// Number of joints.
pub const JOINTS: usize = {joints};
/// Number of base parameters: inertial ones, then rotor inertias.
pub const PARAMETERS: usize = {parameters};

/// The arm `{name}`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct {arm};

{aliases}
#[rustfmt::skip]
impl Arm<JOINTS, PARAMETERS> for {arm} {{
    const NAME: &'static str = {name:?};
    const GRAVITY: [f32; 3] = {gravity:?};
    const PLACEMENTS: [Placement; JOINTS] = [
{placed}    ];
    const COLUMNS: [LinkColumns; JOINTS] = [
{columns}    ];
    const BASE_MAP: &'static [BaseTerm] = &[
{terms}    ];
    const LIMITS: [JointLimits; JOINTS] = [
{limits}    ];
{cogging}    const NOMINAL: [f32; PARAMETERS] = [
{nominal}    ];
    const LINKS: [[f32; {LINK_PARAMETERS}]; JOINTS] = [
{links}    ];
    const ROTORS: [f32; JOINTS] = {rotors:?};
}}
",
        aliases = aliases.concat(),
        gravity = gravity(robot),
    )
}

/// Writes the module of a robot to `file` and declares it in the `mod.rs` beside it, if there is one.
///
/// After that the firmware has the arm: `firmware/foretorque/src/arm/NAME.rs` needs no other edit. The module is called like the
/// file.
///
/// Errors: of the file system; a file name that no module can have is [`std::io::ErrorKind::InvalidInput`].
pub fn write_arm_module(robot: &Robot, file: &Path) -> std::io::Result<()> {
    let module = file
        .file_stem()
        .and_then(|stem| stem.to_str())
        .unwrap_or_default();
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let starts_with_letter = module.starts_with(|c: char| c.is_ascii_lowercase());
    let is_rust = file.extension().is_some_and(|extension| extension == "rs");
    if !(module.chars().all(plain) && starts_with_letter && is_rust) {
        let error = std::io::Error::new(
            std::io::ErrorKind::InvalidInput,
            "must be called like a Rust module: lower-case letters, digits and underscores, then .rs",
        );
        return Err(at(file, error));
    }
    write_whole(file, arm_module(robot).as_bytes())?;
    let parent = file.with_file_name("mod.rs");
    let Ok(text) = std::fs::read_to_string(&parent) else {
        return Ok(());
    };
    let declaration = format!("pub mod {module};");
    if text.lines().any(|line| line == declaration) {
        return Ok(());
    }
    // Before the first module, or where that would be: after the inner docs.
    let at = text.lines().position(|line| line.contains("mod "));
    let at = at.or_else(|| text.lines().position(|line| !line.starts_with("//!")));
    let mut lines: Vec<&str> = text.lines().collect();
    lines.insert(at.unwrap_or(lines.len()), &declaration);
    write_whole(&parent, (lines.join("\n") + "\n").as_bytes())
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
    let single = |joint: &Joint| {
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

/// A number as Rust source. Fractions of a turn go by their names; near misses, such as a limit of 3.14, by their bits,
/// because the lints take them for misspelt constants.
fn number(value: f64) -> String {
    use core::f32::consts::*;
    let value = value as f32;
    let names = [("FRAC_PI_2", FRAC_PI_2), ("PI", PI), ("TAU", TAU)];
    if let Some((name, _)) = names.iter().find(|(_, named)| *named == value.abs()) {
        let sign = if value < 0.0 { "-" } else { "" };
        return format!("{sign}core::f32::consts::{name}");
    }
    #[rustfmt::skip]
    let known: [f32; 19] = [
        E, FRAC_1_PI, FRAC_1_SQRT_2, FRAC_2_PI, FRAC_2_SQRT_PI, FRAC_PI_2, FRAC_PI_3, FRAC_PI_4, FRAC_PI_6,
        FRAC_PI_8, LN_2, LN_10, LOG2_10, LOG2_E, LOG10_2, LOG10_E, PI, SQRT_2, TAU,
    ];
    if known.iter().any(|named| (named - value.abs()).abs() < 5e-3) {
        format!("f32::from_bits({:#010x} /* {value} */)", value.to_bits())
    } else {
        format!("{value:?}")
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
