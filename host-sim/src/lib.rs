//! Simulator and workbench of foretorque.

pub mod board;
pub mod dynamics;
pub mod generate;
pub mod robot;
