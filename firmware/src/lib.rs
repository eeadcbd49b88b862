//! Torque feed-forward for robot joints that learns on the microcontroller.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod arm;
pub mod dynamics;
pub mod edge;
pub mod feedforward;
pub mod joint;
pub mod learning;
pub mod limits;
pub mod math;
pub mod network;
