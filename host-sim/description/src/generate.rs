//! Writes the constants of an arm as a module of the firmware.

use crate::arms;
use crate::files::{at, write_whole};
use crate::robot::{Joint, LINK_PARAMETERS, Robot};
use foretorque::arm::{ArmModel, BaseIndex, BaseTerm, LinkColumns, Placement};
use foretorque::dynamics::BaseParameters;
use heck::ToUpperCamelCase as _;
use std::path::Path;

/// The constants of a robot's arm, with room for `P` base parameters; `None` when it has not `N` joints or more base
/// parameters.
///
/// Name and base-parameter map live as long as the program.
pub fn arm_model<const N: usize, const P: usize>(robot: &Robot) -> Option<ArmModel<N, P>> {
    let map = robot.base_map();
    let rotors = LINK_PARAMETERS * N;
    let mut links = 0..;
    let columns = robot.each(|_| {
        let link = links.next().unwrap_or(N);
        LinkColumns {
            inertial: std::array::from_fn(|k| map.columns.contains(&(LINK_PARAMETERS * link + k))),
            rotor: map.columns.contains(&(rotors + link)),
        }
    })?;
    let mut nominal = BaseParameters::<P>::zeros();
    for (place, value) in map.base_parameters(robot).into_iter().enumerate() {
        *nominal.get_mut(place)? = value as f32;
    }
    let steps = robot
        .joints
        .iter()
        .map(|joint| joint.drive.encoder_step() as f32);
    let terms = map.terms.iter();
    let terms = terms.map(|term| BaseTerm::new(term.base, term.standard, term.weight as f32));
    Some(ArmModel {
        name: Box::leak(robot.name.clone().into_boxed_str()),
        gravity: robot.gravity.map(|g| g as f32).into(),
        placements: robot.each(placement)?,
        columns,
        index: BaseIndex::of(&columns),
        base_map: terms.collect::<Vec<_>>().leak(),
        limits: robot.each(|joint| joint.limits.of_board())?,
        cogging_cycles: robot.each(|joint| joint.friction.cogging_cycles_rev as f32)?,
        encoder_step: steps.fold(0.0, f32::max),
        nominal,
        // As of the placements: −0 is 0.
        links: robot.each(|joint| joint.link.standard_parameters().map(|x| x as f32 + 0.0))?,
        rotors: robot.each(|joint| joint.drive.rotor_inertia as f32)?,
    })
}

/// Source text of the firmware module for a robot: geometry, base-parameter map, limits, nominal parameters.
///
/// The text is data, left unformatted on purpose (`rustfmt::skip`), a row a line.
pub fn arm_module(robot: &Robot) -> String {
    module_with(robot, &robot.name.to_upper_camel_case())
}

/// The module of a robot with a type called `arm`.
fn module_with(robot: &Robot, arm: &str) -> String {
    let text =
        arms!(robot, N, P => arm_model::<N, P>(robot).map(|model| module(&model, arm)), else None);
    text.expect(READ)
}

/// The module of a robot has another use for the name of its type, or the language has.
fn clashes(robot: &Robot) -> bool {
    let arm = robot.name.to_upper_camel_case();
    let text = module_with(robot, "");
    let code = text.lines().filter(|line| !line.starts_with("//"));
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    // `Self` is the one keyword that begins with a capital.
    let mut words = code.flat_map(|line| line.split(|c| !is_plain(c)));
    arm == "Self" || words.any(|word| word == arm)
}

/// Keywords of Rust, in use and reserved.
const KEYWORDS: &str = "as break const continue crate else enum extern false fn for if impl in let loop match mod move mut pub \
    ref return self static struct super trait true type unsafe use where while async await dyn abstract become box do final gen \
    macro override priv try typeof unsized virtual yield";

/// The reason why a description that was read has a model.
const READ: &str = "a description is refused unless it has 1 to 8 joints";

fn module<const N: usize, const P: usize>(model: &ArmModel<N, P>, arm: &str) -> String {
    let name = model.name;
    let (joints, parameters) = (N, model.index.count);
    let sizes = "JOINTS, PARAMETERS";
    let with_arm = format!("{arm}, {sizes}");
    let between = "Exchange between feed-forward and learner";
    let aliases = [
        ("Feed-forward", "feedforward", "FeedForward", &*with_arm),
        ("Learner", "learning", "Learner", &with_arm),
        ("Learner configuration", "learning", "LearnerConfig", sizes),
        ("Parameter set", "learning", "ParameterSet", sizes),
        (between, "learning", "Exchange", sizes),
    ];
    let aliases = aliases.map(|(quantity, module, alias, generics)| {
        format!("/// {quantity} of this arm.\npub type {alias} = foretorque::{module}::{alias}<{generics}>;\n")
    });
    let placed = rows(&model.placements, |placement| format!("{placement:?}"));
    let columns = rows(&model.columns, |columns| format!("{columns:?}"));
    let terms = filled(model.base_map, |term| {
        let (base, standard, weight) = (term.base, term.standard, term.weight);
        format!("BaseTerm::new({base}, {standard}, {weight:?})")
    });
    let limits = rows(&model.limits, |limits| format!("{limits:?}"));
    let cycles = &model.cogging_cycles;
    let cogging = match cycles.iter().any(|cycles| *cycles != 0.0) {
        true => format!("    const COGGING_CYCLES: [f32; JOINTS] = {cycles:?};\n"),
        false => String::new(),
    };
    let step = model.encoder_step;
    let nominal = &model.nominal.as_slice()[..parameters];
    let nominal = filled(nominal, |value| format!("{value:?}"));
    let links = rows(&model.links, |link| format!("{link:?}"));
    let (rotors, gravity) = (model.rotors, model.gravity);
    format!(
        "\
//! Constants of `{name}`, written by `host-sim generate` from its description. Change that, not this.
#![allow(
    clippy::approx_constant,
    dead_code,
    reason = \"numbers of a description; a program needs some of these names only\"
)]

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
{cogging}    const ENCODER_STEP: f32 = {step:?};
    const NOMINAL: [f32; PARAMETERS] = [
{nominal}    ];
    const LINKS: [[f32; {LINK_PARAMETERS}]; JOINTS] = [
{links}    ];
    const ROTORS: [f32; JOINTS] = {rotors:?};
}}
",
        aliases = aliases.concat(),
    )
}

/// One line of Rust source for each item.
fn rows<T>(items: &[T], text: impl Fn(&T) -> String) -> String {
    let row = |item| format!("        {},\n", text(item));
    items.iter().map(row).collect()
}

/// Lines of Rust source of at most 120 columns, filled with items.
fn filled<T>(items: &[T], text: impl Fn(&T) -> String) -> String {
    let mut lines: Vec<String> = Vec::new();
    for item in items.iter().map(text) {
        match lines.last_mut() {
            Some(line) if line.len() + item.len() < 110 => *line += &format!(", {item}"),
            _ => lines.push(item),
        }
    }
    rows(&lines, String::clone)
}

/// Writes the module of a robot to `file` and declares it in the `mod.rs` beside it, if there is one.
///
/// After that the firmware has the arm: `firmware/foretorque/src/arm/NAME.rs` needs no other edit. The module is called like the
/// file.
///
/// Errors: of the file system; a file that no module, or a robot that no type can be called like, is
/// [`std::io::ErrorKind::InvalidInput`].
pub fn write_arm_module(robot: &Robot, file: &Path) -> std::io::Result<()> {
    let module = file.file_stem().and_then(|stem| stem.to_str());
    let module = module.unwrap_or_default();
    let is_rust = file.extension().is_some_and(|extension| extension == "rs");
    let refused = |reason: &str| {
        let error = std::io::Error::new(std::io::ErrorKind::InvalidInput, reason);
        Err(at(file, error))
    };
    if !(Robot::is_name(module) && is_rust) || KEYWORDS.split_whitespace().any(|k| k == module) {
        return refused(
            "must be called like a Rust module: lower-case letters, digits and underscores, no keyword, then .rs",
        );
    }
    if clashes(robot) {
        let (name, arm) = (&robot.name, robot.name.to_upper_camel_case());
        return refused(&format!(
            "the type {arm} of arm '{name}' clashes with a name of Rust or of the module: give another one by --name"
        ));
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
    arms!(robot, N, P => arm_model::<N, P>(robot).map(|arm| arm.hash()), else None).expect(READ)
}

fn placement(joint: &Joint) -> Placement {
    let rot = joint.placement.rot_parent_child.map(|entry| entry as f32);
    Placement {
        rot_parent_child: std::array::from_fn(|row| std::array::from_fn(|col| rot[(row, col)])),
        // Products of a right angle's 0 may come out as −0, which is not the 0 that costs nothing.
        origin: joint.placement.origin.map(|x| x as f32 + 0.0).into(),
    }
}

/// A module in a crate that uses one name of it.
#[cfg(test)]
#[deny(dead_code)]
#[expect(unreachable_pub, reason = "nothing is public in a program")]
#[path = "../../../firmware/foretorque/src/arm/ur5.rs"]
mod used_in_part;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_module_of_which_little_is_used_compiles_without_warnings() {
        let robot = Robot::load("ur5").expect("built in");
        assert_eq!(used_in_part::JOINTS, robot.joint_count());
    }

    #[test]
    fn an_arm_cannot_be_called_like_what_its_module_uses() {
        let mut robot = Robot::load("ur5").expect("built in");
        let nowhere = Path::new("/nowhere");
        for name in "arm base_term joint_limits link_columns placement feed_forward learner learner_config parameter_set \
            exchange clone copy debug partial_eq eq self"
            .split(' ')
        {
            robot.name = name.to_owned();
            let error = write_arm_module(&robot, &nowhere.join("own.rs")).expect_err(name);
            let (error, arm) = (error.to_string(), name.to_upper_camel_case());
            assert!(error.contains("--name") && error.contains(&arm), "{error}");
        }
        for sound in ["arm2", "my_arm", "type", "constants"] {
            robot.name = sound.to_owned();
            assert!(!clashes(&robot), "{sound}");
        }
        for keyword in ["self.rs", "type.rs", "mod.rs"] {
            let error = write_arm_module(&robot, &nowhere.join(keyword)).expect_err(keyword);
            assert_eq!(error.kind(), std::io::ErrorKind::InvalidInput);
        }
    }
}
