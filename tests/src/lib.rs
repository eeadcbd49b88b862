//! Acceptance tests across the crates of foretorque.

pub mod arms;
pub mod table;
