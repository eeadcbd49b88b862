//! Arms to test the dynamics on: random geometry of 1 to 7 joints, a URDF with everything untidy, a calibrated UR5.
//!
//! The build generates their modules from `tests/data`. Tests on the host and test images of the board share them.
#![no_std]

include!(concat!(env!("OUT_DIR"), "/arms.rs"));
