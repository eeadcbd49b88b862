//! Simulator and workbench of foretorque.

pub mod board;
pub mod commands;
pub mod control;
mod description;
pub mod dynamics;
pub mod excitation;
pub mod experiment;
pub mod faults;
pub mod files;
pub mod generate;
pub mod identification;
pub mod kinematics;
pub mod metrics;
pub mod parallel;
pub mod plant;
pub mod report;
pub mod robot;
pub mod table;
pub mod telemetry;
pub mod training;
pub mod trajectory;
pub mod urdf;
pub mod via;
