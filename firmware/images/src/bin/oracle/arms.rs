//! The arms of the acceptance tests.

#[path = "../../../../../tests/src/arms/random_1_a.rs"]
pub(crate) mod random_1_a;
#[path = "../../../../../tests/src/arms/random_1_b.rs"]
pub(crate) mod random_1_b;
#[path = "../../../../../tests/src/arms/random_2_a.rs"]
pub(crate) mod random_2_a;
#[path = "../../../../../tests/src/arms/random_2_b.rs"]
pub(crate) mod random_2_b;
#[path = "../../../../../tests/src/arms/random_4_a.rs"]
pub(crate) mod random_4_a;
#[path = "../../../../../tests/src/arms/random_4_b.rs"]
pub(crate) mod random_4_b;
#[path = "../../../../../tests/src/arms/random_6_a.rs"]
pub(crate) mod random_6_a;
#[path = "../../../../../tests/src/arms/random_6_b.rs"]
pub(crate) mod random_6_b;
#[path = "../../../../../tests/src/arms/random_7_a.rs"]
pub(crate) mod random_7_a;
#[path = "../../../../../tests/src/arms/random_7_b.rs"]
pub(crate) mod random_7_b;
