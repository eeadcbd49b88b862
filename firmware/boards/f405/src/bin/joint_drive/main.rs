//! The flashable firmware on a board that drives its joint: motor stage, fault input and encoder are its own, the rest is
//! that of `joint`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[path = "../joint/app.rs"]
mod app;
#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
#[path = "../joint/clock.rs"]
mod clock;
#[cfg(target_os = "none")]
#[path = "../joint/counter.rs"]
mod counter;
#[cfg(target_os = "none")]
mod drive;
#[cfg(target_os = "none")]
#[path = "../joint/fault.rs"]
mod fault;
#[cfg(target_os = "none")]
#[path = "../joint/link.rs"]
mod link;
#[cfg(target_os = "none")]
#[path = "../joint/log.rs"]
mod log;
#[cfg(target_os = "none")]
#[path = "../joint/pace.rs"]
mod pace;
#[cfg(target_os = "none")]
mod pins;
#[cfg(target_os = "none")]
mod pulse;
#[cfg(target_os = "none")]
#[path = "../joint/rooms.rs"]
mod rooms;
#[cfg(target_os = "none")]
#[path = "../joint/secret.rs"]
mod secret;
#[cfg(target_os = "none")]
mod spi;
#[cfg(target_os = "none")]
#[path = "../joint/store_flash.rs"]
mod store_flash;
#[cfg(target_os = "none")]
#[path = "../joint/watchdog.rs"]
mod watchdog;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("joint-drive is firmware: build it with `cargo firmware`");
    std::process::exit(2);
}
