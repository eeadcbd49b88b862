//! The cost of the firmware in one command.

use anyhow::{Context as _, Result};

use crate::setup::{self, Way};
use crate::shell::{self, capture};
use crate::toolchain;

/// Sets up, builds, measures and compares with docs/budget.md; `accept` writes that page anew.
pub(crate) fn run(forced: Option<Way>, accept: bool) -> Result<()> {
    let board = setup::run(forced)?.board;
    let mut build = board.board_cargo("build");
    shell::run(build.args([
        "--bin",
        "bench",
        "--bin",
        "joint",
        "--bin",
        "joint-drive",
        "--bin",
        "joint-can",
    ]))?;
    let version = capture(board.tool("rustc").arg("--version"));
    let version = version.context("rustc reports no version")?;
    foretorque_cost::bench(&toolchain::elves(), &shell::root(), version.trim(), accept)
}
