//! Shared by the images that only tests load. On the host this library is empty.
#![no_std]
#![cfg(target_os = "none")]

pub mod semihost;
