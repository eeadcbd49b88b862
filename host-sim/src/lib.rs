//! Simulator and workbench of foretorque.

pub mod dynamics;
pub mod generate;
pub mod robot;
