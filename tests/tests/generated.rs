//! Arm modules are what the generator writes today, and what their descriptions say.

use acceptance::arms::{description, oblique::Oblique};
use acceptance::each_arm;
use foretorque::arm::{Arm, LinkInertia, base_parameters};
use foretorque_workbench::generate::{arm_hash, arm_module};
use std::path::Path;

/// f32 rounding of figures up to some kg·m²: a base parameter is a sum of up to 20 terms.
const BASE_TOLERANCE: f32 = 1e-5;

/// The committed module of an arm: the firmware's own, or one of this package.
fn committed_module(name: &str) -> String {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = match name {
        "ur5" | "panda" => package.join("../firmware/foretorque/src/arm"),
        _ => package.join("src/arms"),
    };
    let file = folder.join(format!("{name}.rs"));
    std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

fn module_is_up_to_date<A: Arm<N, P>, const N: usize, const P: usize>() {
    let robot = description(A::NAME);
    assert!(
        arm_module(&robot) == committed_module(A::NAME),
        "the module of '{}' is stale: run `cargo run -p host-sim --example write_arm -- DESCRIPTION MODULE.rs`",
        A::NAME
    );
    assert_eq!(A::NAME, robot.name);
    assert_eq!(A::HASH, arm_hash(&robot), "{}", A::NAME);
}

fn data_sheet_gives_nominal<A: Arm<N, P>, const N: usize, const P: usize>() {
    let robot = description(A::NAME);
    let links: [LinkInertia; N] = std::array::from_fn(|joint| {
        let link = &robot.joints[joint].link;
        LinkInertia {
            mass: link.mass as f32,
            com: link.com.map(|x| x as f32),
            inertia_com: link.inertia_com.map(|x| x as f32),
        }
    });
    let rotors: [f32; N] =
        std::array::from_fn(|joint| robot.joints[joint].drive.rotor_inertia as f32);
    let beta = base_parameters::<A, N, P>(&links, &rotors);
    for (k, (value, nominal)) in beta.iter().zip(&A::NOMINAL).enumerate() {
        let error = (value - nominal).abs();
        let name = A::NAME;
        assert!(
            error <= BASE_TOLERANCE,
            "{name}: base parameter {k} off by {error:e}"
        );
    }
}

#[test]
fn committed_arms_are_what_their_descriptions_generate() {
    each_arm!(module_is_up_to_date);
    module_is_up_to_date::<Oblique, 4, 27>();
}

#[test]
fn board_turns_data_sheet_figures_into_the_nominal_base_parameters() {
    each_arm!(data_sheet_gives_nominal);
    data_sheet_gives_nominal::<Oblique, 4, 27>();
}
