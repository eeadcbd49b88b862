//! Arm modules agree with the generator and with their descriptions.

use crate::arms::{oblique::Oblique, ur5_calibrated::Ur5Calibrated};
use crate::{description, each_arm};
use foretorque::arm::{Arm, LinkInertia, base_parameters, panda::Panda, ur5::Ur5};
use foretorque_workbench::generate::{arm_hash, arm_module};
use std::path::Path;

/// f32 rounding of figures up to some kg·m²: a base parameter is a sum of up to 20 terms.
const BASE_TOLERANCE: f32 = 1e-5;

/// The committed module of a shipped arm.
fn module_is_up_to_date<A: Arm<N, P>, const N: usize, const P: usize>() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/foretorque/src/arm");
    let name = A::NAME;
    let committed = std::fs::read_to_string(folder.join(format!("{name}.rs")));
    assert!(
        arm_module(&description(name)) == committed.expect("a shipped arm"),
        "the module of '{name}' is stale: run `cargo run -p host-sim -- generate --robot DESCRIPTION --out MODULE.rs`"
    );
}

fn identity_is_that_of_its_description<A: Arm<N, P>, const N: usize, const P: usize>() {
    let robot = description(A::NAME);
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
        let near = error <= BASE_TOLERANCE;
        assert!(near, "{}: base parameter {k} off by {error:e}", A::NAME);
    }
}

#[test]
fn shipped_arms_are_as_generated_from_their_descriptions() {
    module_is_up_to_date::<Ur5, 6, 40>();
    module_is_up_to_date::<Panda, 7, 48>();
}

#[test]
fn an_arm_and_its_description_have_the_same_identity() {
    each_arm!(identity_is_that_of_its_description);
    identity_is_that_of_its_description::<Oblique, 4, 27>();
    identity_is_that_of_its_description::<Ur5Calibrated, 6, 41>();
}

#[test]
fn data_sheet_figures_give_the_nominal_base_parameters() {
    each_arm!(data_sheet_gives_nominal);
    data_sheet_gives_nominal::<Oblique, 4, 27>();
}
