//! Arm modules are what the generator writes today, and what their descriptions say.

use acceptance::arms;
use foretorque::arm::{Arm, LinkInertia, base_parameters, panda::Panda, ur5::Ur5};
use host_sim::generate::{arm_hash, arm_module};
use host_sim::robot::Robot;

/// f32 rounding of figures up to some tens of kg·m²: the map is B·x with up to 20 terms an entry.
const BASE_TOLERANCE: f32 = 1e-5;

fn description(file: &str) -> Robot {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/data/pinocchio/arms");
    let robot = if file.contains('.') {
        Robot::load(&format!("{folder}/{file}"))
    } else {
        Robot::load(file)
    };
    robot.unwrap_or_else(|error| panic!("{error}"))
}

/// The committed module, the identity of the arm, and the base parameters of the board's own conversion.
fn arm_is_its_description<A: Arm<N, P>, const N: usize, const P: usize>(file: &str, module: &str) {
    let robot = description(file);
    assert!(
        arm_module(&robot) == module,
        "the module of '{file}' is stale: run `cargo run -p host-sim --example write_arm -- DESCRIPTION MODULE.rs`"
    );
    assert_eq!(A::NAME, robot.name);
    assert_eq!(A::HASH, arm_hash(&robot), "{file}");
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
        assert!(
            error <= BASE_TOLERANCE,
            "{file}: base parameter {k} off by {error:e}"
        );
    }
}

#[test]
fn firmware_arms_are_what_their_descriptions_generate() {
    arm_is_its_description::<Ur5, 6, 40>("ur5", include_str!("../../firmware/src/arm/ur5.rs"));
    arm_is_its_description::<Panda, 7, 48>(
        "panda",
        include_str!("../../firmware/src/arm/panda.rs"),
    );
}

/// Checks each `module Type, joints, base parameters, description` of the test arms.
macro_rules! test_arms {
    ($($module:ident $arm:ident, $joints:literal, $parameters:literal, $file:literal;)*) => {
        $(arm_is_its_description::<arms::$module::$arm, $joints, $parameters>(
            $file,
            include_str!(concat!("../src/arms/", stringify!($module), ".rs")),
        );)*
    };
}

#[test]
fn test_arms_are_what_their_descriptions_generate() {
    test_arms! {
        oblique Oblique, 4, 27, "oblique.urdf";
        random_1_a Random1A, 1, 3, "random_1_a.toml";
        random_1_b Random1B, 1, 3, "random_1_b.toml";
        random_2_a Random2A, 2, 11, "random_2_a.toml";
        random_2_b Random2B, 2, 11, "random_2_b.toml";
        random_4_a Random4A, 4, 27, "random_4_a.toml";
        random_4_b Random4B, 4, 27, "random_4_b.toml";
        random_6_a Random6A, 6, 43, "random_6_a.toml";
        random_6_b Random6B, 6, 43, "random_6_b.toml";
        random_7_a Random7A, 7, 51, "random_7_a.toml";
        random_7_b Random7B, 7, 51, "random_7_b.toml";
    }
}
