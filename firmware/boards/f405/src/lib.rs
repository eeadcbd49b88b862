//! foretorque on the STM32F405: chip support, and the boards that carry it. On the host this library is empty.
//!
//! | module | contents |
//! |---|---|
//! | `app` | the schedule: `image!` makes the firmware of a board |
//! | `board` | what a board has of its own |
//! | `odrive_v3`, `pyboard`, `pyboard_drive` | the boards |
//! | `chip`, `clock`, `counter`, `pin` | constants, clocks, cost counter and pins of the chip |
//! | `fault` | fault handlers, and what is kept over a reset |
//! | `rooms` | session and learner in static memory |
//!
//! Another board is a file beside these and a binary that names it.
#![no_std]
#![cfg(target_os = "none")]

pub mod app;
pub mod board;
pub mod chip;
pub mod clock;
pub mod counter;
pub mod drive;
pub mod fault;
pub mod link;
mod log;
pub mod odrive_v3;
mod pace;
pub mod pin;
pub mod pyboard;
pub mod pyboard_drive;
pub mod rooms;
mod secret;
mod store_flash;
mod watchdog;
