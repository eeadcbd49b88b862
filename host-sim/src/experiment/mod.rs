//! The reproducible studies.

pub mod campaign;
pub mod closed_loop;
pub mod demo;
pub mod efficiency;
pub mod excitation;
pub mod learning;
pub mod paper;
pub mod prior;
pub mod real_ur5;
pub mod replay_real;
