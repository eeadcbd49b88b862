//! The constants of an arm as a module of the firmware.

use crate::files::{at, write_whole};
use crate::robot::{LINK_PARAMETERS, Limits, Robot};
use foretorque::arm::{LinkColumns, Placement, identity};
use std::path::Path;

/// Source text of the firmware module for a robot: geometry, base-parameter map, limits, nominal parameters.
///
/// The text is data; nobody has to read it. It is left unformatted on purpose (`rustfmt::skip`), a row a line.
pub fn arm_module(robot: &Robot) -> String {
    let map = robot.base_map();
    let (name, type_name) = (&robot.name, camel_case(&robot.name));
    let rows = |items: &mut dyn Iterator<Item = String>| -> String {
        items.map(|item| format!("        {item},\n")).collect()
    };
    let (learner, set) = (
        format!("{type_name}, JOINTS, PARAMETERS"),
        "JOINTS, PARAMETERS",
    );
    let aliases = [
        ("Feed-forward", "feedforward::FeedForward", learner.as_str()),
        ("Learner", "learning::Learner", &learner),
        ("Learner configuration", "learning::LearnerConfig", set),
        ("Parameter set", "learning::ParameterSet", set),
        (
            "Exchange between feed-forward and learner",
            "learning::Exchange",
            set,
        ),
    ];
    let aliases = aliases.map(|(quantity, path, parameters)| {
        let alias = path.rsplit("::").next().unwrap_or(path);
        format!(
            "/// {quantity} of this arm.\npub type {alias} = foretorque::{path}<{parameters}>;\n"
        )
    });
    let cogging: Vec<f32> = robot
        .joints
        .iter()
        .map(|joint| joint.friction.cogging_cycles_rev as f32)
        .collect();
    let cogging = match cogging.iter().any(|cycles| *cycles != 0.0) {
        true => format!("    const COGGING_CYCLES: [f32; JOINTS] = {cogging:?};\n"),
        false => String::new(),
    };
    let rotors = robot.joints.iter().map(|joint| joint.drive.rotor_inertia);
    let rotors: Vec<f32> = rotors.map(|inertia| inertia as f32).collect();
    let joints = || robot.joints.iter();
    format!(
        "//! Constants of `{name}`, written by `host-sim generate` from its description. Change that, not this.\n\n\
         use foretorque::arm::{{Arm, BaseTerm, JointLimits, LinkColumns, Placement}};\n\n\
         /// Number of joints.\n\
         pub const JOINTS: usize = {};\n\
         /// Number of base parameters: inertial ones, then rotor inertias.\n\
         pub const PARAMETERS: usize = {};\n\n\
         /// The arm `{name}`.\n\
         #[derive(Clone, Copy, Debug, PartialEq, Eq)]\n\
         pub struct {type_name};\n\n\
         {}\n\
         #[rustfmt::skip]\n\
         impl Arm<JOINTS, PARAMETERS> for {type_name} {{\n    \
             const NAME: &'static str = {name:?};\n    \
             const GRAVITY: [f32; 3] = {:?};\n    \
             const PLACEMENTS: [Placement; JOINTS] = [\n{}    ];\n    \
             const COLUMNS: [LinkColumns; JOINTS] = [\n{}    ];\n    \
             const BASE_MAP: &'static [BaseTerm] = &[\n{}    ];\n    \
             const LIMITS: [JointLimits; JOINTS] = [\n{}    ];\n{cogging}    \
             const NOMINAL: [f32; PARAMETERS] = [\n{}    ];\n    \
             const LINKS: [[f32; {LINK_PARAMETERS}]; JOINTS] = [\n{}    ];\n    \
             const ROTORS: [f32; JOINTS] = {rotors:?};\n}}\n",
        robot.joint_count(),
        map.rank(),
        aliases.concat(),
        gravity(robot),
        rows(&mut placements(robot).iter().map(|frame| format!("{frame:?}"))),
        rows(
            &mut link_columns(robot, &map.columns)
                .iter()
                .map(|link| format!("{link:?}"))
        ),
        rows(&mut map.terms.iter().map(|term| {
            let weight = term.weight as f32;
            format!(
                "BaseTerm::new({}, {}, {weight:?})",
                term.base, term.standard
            )
        })),
        rows(&mut joints().map(|joint| joint_limits(&joint.limits))),
        rows(
            &mut map
                .base_parameters(robot)
                .iter()
                .map(|value| format!("{:?}", *value as f32))
        ),
        // As of the placements: −0 is 0.
        rows(&mut joints().map(|joint| {
            let link = joint.link.standard_parameters();
            format!("{:?}", link.map(|value| value as f32 + 0.0))
        })),
    )
}

fn joint_limits(limits: &Limits) -> String {
    let (lower, upper) = limits.position;
    format!(
        "JointLimits {{ position: ({}, {}), velocity: {}, torque: {} }}",
        number(lower),
        number(upper),
        number(limits.velocity),
        number(limits.torque)
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

/// Identity of a robot's arm, as the firmware built from [`arm_module`] has it.
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
    let known = [
        E, FRAC_1_PI, FRAC_1_SQRT_2, FRAC_2_PI, FRAC_2_SQRT_PI, FRAC_PI_2, FRAC_PI_3, FRAC_PI_4, FRAC_PI_6, FRAC_PI_8,
        LN_2, LN_10, LOG2_10, LOG2_E, LOG10_2, LOG10_E, PI, SQRT_2, TAU,
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
