//! Simulator and workbench of foretorque.

pub mod robot;
