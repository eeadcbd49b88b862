//! The flashable firmware of a joint controller: one STM32F405, one serial link, one tick.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod app;
#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod clock;
#[cfg(target_os = "none")]
mod counter;
#[cfg(target_os = "none")]
mod drive;
#[cfg(target_os = "none")]
mod fault;
#[cfg(target_os = "none")]
mod link;
#[cfg(target_os = "none")]
mod log;
#[cfg(target_os = "none")]
mod pace;
#[cfg(target_os = "none")]
mod rooms;
#[cfg(target_os = "none")]
mod secret;
#[cfg(target_os = "none")]
mod store_flash;
#[cfg(target_os = "none")]
mod watchdog;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("joint is firmware: build it with `cargo firmware`");
    std::process::exit(2);
}
