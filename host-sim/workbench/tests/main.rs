//! Boards and buses together. One test crate: the workbench is linked once.

mod bus_commission;
mod bus_loop;
mod emulated_board;
mod emulated_bus;
mod emulated_drive;
mod emulated_safety;
mod native_board;
#[path = "../../../tests/python.rs"]
mod python;
mod trial;
