//! The fault campaign in one command.

use anyhow::Result;

use crate::setup::{self, Way};
use crate::shell::{self, command};

/// Where the counts go, from the workspace's root.
const OUT: &str = "target/foretorque/faults.json";

/// Sets up, builds the board's ELF files, and breaks them.
pub(crate) fn run(forced: Option<Way>) -> Result<()> {
    let tools = setup::run(forced)?;
    shell::run(tools.board.board_cargo("build").arg("--bins"))?;
    shell::run(command("cargo").args([
        "run",
        "--quiet",
        "--release",
        "-p",
        "host-sim",
        "--",
        "faults",
        "--out",
        OUT,
    ]))
}
