//! The program as its users call it. One test crate: the program's parts are linked once.

mod bad_input;
mod bags;
mod cli;
mod cli_bus;
mod clients;
mod excitation;
mod identification;
mod logged;
mod orphans;
mod planted;
mod program;
#[path = "../../tests/python.rs"]
mod python;
mod studies;
