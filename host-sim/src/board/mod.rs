//! Boards.
mod child;
pub mod qemu;
