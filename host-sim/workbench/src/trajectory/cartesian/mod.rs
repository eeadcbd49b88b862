//! Paths of the tool: a small file of lines, circles and via points, laid out as joint motion by inverse kinematics.
//!
//! `file` (text → moves) → `curve` (pose, twist and its derivative at an instant) → [`plan`] (joint positions, velocities
//! and accelerations tick by tick, every limit checked).

mod curve;
mod file;
mod plan;

pub use file::{CartesianError, Spot};
pub use plan::plan;
