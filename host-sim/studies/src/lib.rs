//! The reproducible studies of foretorque, and its fault campaign.

pub mod campaign;
pub mod demo;
pub mod efficiency;
pub mod excitation;
pub mod faults;
pub mod learning;
pub mod paper;
pub mod prior;
pub mod real_ur5;
pub mod replay_real;
