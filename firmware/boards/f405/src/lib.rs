//! foretorque on the STM32F405: chip support, and the boards that carry it. On the host only [`chip`] and [`can`] are there.
//!
//! | module | contents |
//! |---|---|
//! | `app` | the schedule: `image!` makes the firmware of a board |
//! | `board` | what a board has of its own |
//! | `odrive_v3`, `pyboard`, `pyboard_drive` | the boards |
//! | `chip`, `clock`, `counter`, `pin` | constants, clocks, cost counter and pins of the chip |
//! | [`can`] | driver of the two CAN controllers |
//! | `fault` | fault handlers, and what is kept over a reset |
//! | `link`, `ring` | serial link, and the queues of its bytes |
//! | `rooms` | session and learner in static memory |
//!
//! Another board is a file beside these and a binary that names it.
#![no_std]

pub mod can;
pub mod chip;

#[cfg(target_os = "none")]
pub mod app;
#[cfg(target_os = "none")]
pub mod board;
#[cfg(target_os = "none")]
pub mod clock;
#[cfg(target_os = "none")]
pub mod counter;
#[cfg(target_os = "none")]
pub mod drive;
#[cfg(target_os = "none")]
pub mod fault;
#[cfg(target_os = "none")]
pub mod link;
#[cfg(target_os = "none")]
mod log;
#[cfg(target_os = "none")]
pub mod odrive_v3;
#[cfg(target_os = "none")]
mod pace;
#[cfg(target_os = "none")]
pub mod pin;
#[cfg(target_os = "none")]
pub mod pyboard;
#[cfg(target_os = "none")]
pub mod pyboard_drive;
#[cfg(target_os = "none")]
pub mod ring;
#[cfg(target_os = "none")]
pub mod rooms;
#[cfg(target_os = "none")]
mod secret;
#[cfg(target_os = "none")]
mod store_flash;
#[cfg(target_os = "none")]
mod watchdog;
