//! Arms that exist to test the dynamics on: random geometry of 1 to 7 joints, and a URDF with everything untidy.
//!
//! The modules are written by the generator from `tests/data/pinocchio/arms/`, as those of the firmware are; they use
//! the constants of an arm from here as those use them from `foretorque::arm`.

use foretorque::arm::{Arm, BaseTerm, JointLimits, LinkColumns, Placement};

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
