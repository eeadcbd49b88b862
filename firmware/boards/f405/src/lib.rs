//! foretorque on the STM32F405: chip support, and the boards that carry it. On the host only [`can`], [`chip`],
//! [`flash_driver`], [`frame_bound`] and [`image`] are there.
//!
//! | module | contents |
//! |---|---|
//! | `app` | the schedule: `image!` makes the firmware of a board |
//! | `arm`, `board` | the arm, and types that follow from it; properties of a board, its pins and drive |
//! | `odrive_v3`, `pyboard`, `pyboard_drive`, `can_board` | the boards |
//! | `chip`, `clock`, `counter` | constants, clocks and cost counter of the chip |
//! | [`can`] | driver of the two CAN controllers |
//! | `fault` | fault handlers, and what is kept over a reset |
//! | [`frame_bound`], `link` | serial link, its bound and the queues of its bytes |
//! | [`image`] | check of the program in flash |
//! | [`flash_driver`], `key_slot`, `tick_timer`, `watchdog` | flash, write key, timer and watchdog of the chip |
//!
//! Another board is a file beside these, a `pub mod` below and a binary that names it.
#![cfg_attr(not(test), no_std)]

/// The `main` of a firmware on the host: the name of what it is.
#[macro_export]
macro_rules! on_the_host {
    () => {
        #[cfg(not(target_os = "none"))]
        fn main() {
            let name = env!("CARGO_BIN_NAME");
            eprintln!("{name} is firmware: build it with `cargo firmware`");
            std::process::exit(2);
        }
    };
}

pub mod can;
pub mod chip;
pub mod flash_driver;
pub mod frame_bound;
pub mod image;

#[cfg(target_os = "none")]
pub mod app;
#[cfg(target_os = "none")]
pub mod arm;
#[cfg(target_os = "none")]
pub mod board;
#[cfg(target_os = "none")]
pub mod can_board;
#[cfg(target_os = "none")]
pub mod clock;
#[cfg(target_os = "none")]
pub mod counter;
#[cfg(target_os = "none")]
pub mod fault;
#[cfg(target_os = "none")]
mod key_slot;
#[cfg(target_os = "none")]
pub mod link;
#[cfg(target_os = "none")]
mod log;
#[cfg(target_os = "none")]
pub mod odrive_v3;
#[cfg(target_os = "none")]
pub mod pyboard;
#[cfg(target_os = "none")]
pub mod pyboard_drive;
#[cfg(target_os = "none")]
mod tick_timer;
#[cfg(target_os = "none")]
mod watchdog;
