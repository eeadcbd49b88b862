//! What must hold across the crates of foretorque.

pub mod arms;
pub mod table;
