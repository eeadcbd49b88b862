//! The fault campaign in one command.

use anyhow::Result;

use crate::setup::{self, Way};
use crate::shell::{self, command};

/// Where the counts go, from the workspace's root.
const OUT: &str = "target/foretorque/faults.json";
/// The snapshot that keeps them.
const SNAPSHOT: &str = "tests/snapshots/faults.txt";

/// Sets up, builds the board's ELF files, breaks them, and compares the counts with the snapshot; `accept` writes them there.
pub(crate) fn run(forced: Option<Way>, accept: bool) -> Result<()> {
    let tools = setup::run(forced)?;
    shell::run(tools.board.board_cargo("build").arg("--bins"))?;
    let mut campaign = command("cargo");
    campaign.args([
        "run",
        "--quiet",
        "--release",
        "-p",
        "host-sim",
        "--",
        "faults",
        "--out",
        OUT,
        "--snapshot",
        SNAPSHOT,
    ]);
    if accept {
        campaign.arg("--accept");
    }
    shell::run(&mut campaign)
}
