//! Descriptions of arms: their files, their rigid-body model in f64, and their constants for the firmware.

pub mod described;
pub mod dynamics;
pub mod files;
pub mod generate;
pub mod robot;
pub mod urdf;
