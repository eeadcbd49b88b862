//! The test arms beside the shipped ones, and their descriptions.

use foretorque_workbench::robot::Robot;

pub use foretorque_test_arms::*;

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

/// The description of an arm of [`each_arm`], of [`oblique`] or of [`ur5_calibrated`].
///
/// Panics if it cannot be read: without it there is nothing to test.
pub fn description(name: &str) -> Robot {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/data");
    let loaded = match name {
        "ur5" | "panda" => Robot::load(name),
        "ur5_calibrated" => Robot::load(&format!("{data}/{name}.toml")),
        "oblique" => Robot::load(&format!("{data}/pinocchio/arms/{name}.urdf")),
        _ => Robot::load(&format!("{data}/pinocchio/arms/{name}.toml")),
    };
    loaded.unwrap_or_else(|error| panic!("{error}"))
}
