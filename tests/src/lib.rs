//! Requirements that hold across the crates of foretorque.

pub mod arms;
pub mod table;
