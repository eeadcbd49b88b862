//! Workbench of foretorque: robots, plant, excitation, boards, identification and reports. No study is part of it.

pub mod board;
pub mod bus;
pub mod closed_loop;
pub mod excitation;
pub mod identification;
pub mod kinematics;
pub mod metrics;
pub mod parallel;
pub mod plant;
pub mod report;
pub mod snapshot;
pub mod table;
pub mod telemetry;
pub mod training;
pub mod trajectory;

pub use foretorque_description::{Refusal, arms, dynamics, files, generate, joints, robot, urdf};
