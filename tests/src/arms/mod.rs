//! Arms that exist to test the dynamics on: random geometry of 1 to 7 joints, and a URDF with everything untidy.
//!
//! The modules are written by the generator from `tests/data/pinocchio/arms/`, as those of the library are.

use foretorque_workbench::robot::Robot;

pub mod oblique;
pub mod random_1_a;
pub mod random_1_b;
pub mod random_2_a;
pub mod random_2_b;
pub mod random_4_a;
pub mod random_4_b;
pub mod random_6_a;
pub mod random_6_b;
pub mod random_7_a;
pub mod random_7_b;

/// Calls `check::<Arm, N, P>()`, with arguments if there are any, for the UR5, the Panda and the ten random arms.
#[macro_export]
macro_rules! each_arm {
    ($check:ident $(, $argument:expr)*) => {
        $check::<foretorque::arm::ur5::Ur5, 6, 40>($($argument),*);
        $check::<foretorque::arm::panda::Panda, 7, 48>($($argument),*);
        $check::<$crate::arms::random_1_a::Random1A, 1, 3>($($argument),*);
        $check::<$crate::arms::random_1_b::Random1B, 1, 3>($($argument),*);
        $check::<$crate::arms::random_2_a::Random2A, 2, 11>($($argument),*);
        $check::<$crate::arms::random_2_b::Random2B, 2, 11>($($argument),*);
        $check::<$crate::arms::random_4_a::Random4A, 4, 27>($($argument),*);
        $check::<$crate::arms::random_4_b::Random4B, 4, 27>($($argument),*);
        $check::<$crate::arms::random_6_a::Random6A, 6, 43>($($argument),*);
        $check::<$crate::arms::random_6_b::Random6B, 6, 43>($($argument),*);
        $check::<$crate::arms::random_7_a::Random7A, 7, 51>($($argument),*);
        $check::<$crate::arms::random_7_b::Random7B, 7, 51>($($argument),*);
    };
}

/// The description an arm of [`each_arm`] (or [`oblique`]) was generated from.
///
/// Panics when it cannot be read: without it there is nothing to test.
pub fn description(name: &str) -> Robot {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/data/pinocchio/arms");
    let file = |extension| format!("{folder}/{name}.{extension}");
    let loaded = match name {
        "ur5" | "panda" => Robot::load(name),
        "oblique" => Robot::load(&file("urdf")),
        _ => Robot::load(&file("toml")),
    };
    loaded.unwrap_or_else(|error| panic!("{error}"))
}
