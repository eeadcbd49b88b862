//! Torque feed-forward for robot joints that learns on the microcontroller.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
