//! Demo, faults and bench in one command each: set-up, build of both sides, run.

use std::fs;
use std::time::Instant;

use anyhow::{Context as _, Result};

use crate::arm;
use crate::setup::{self, Way};
use crate::shell::{self, capture, command};
use crate::toolchain;

/// The flashable ELF that the demo emulated, kept beside its report for comparison with the one that is flashed.
pub(crate) const ELF_COPY: &str = "target/foretorque/demo/joint.elf";

/// Runs the optimised command line, built if it is not.
fn host_sim(arguments: &str) -> Result<()> {
    let mut program = command("cargo");
    program.args(["run", "--quiet", "--release", "-p", "host-sim", "--"]);
    shell::run(program.args(arguments.split(' ')))
}

/// Sets up, builds both sides, and runs the demo experiment on the board's ELF files.
pub(crate) fn demo(forced: Option<Way>) -> Result<()> {
    let start = Instant::now();
    let tools = setup::run(forced)?;
    let mut firmware = tools.board.board_cargo("build");
    shell::run(firmware.args(["--bin", "joint", "--bin", "bulk"]))?;
    arm::host_sim()?;
    println!("demo: built after {:.1} s", start.elapsed().as_secs_f64());
    host_sim("experiment demo --out target/foretorque/demo")?;
    let elf = toolchain::elf("joint");
    let copied = fs::copy(&elf, shell::root().join(ELF_COPY))
        .with_context(|| format!("cannot copy {}", elf.display()))?;
    println!(
        "demo: emulated {} ({copied} bytes); `cargo xtask flash` flashes this file",
        elf.display()
    );
    println!("demo: {:.1} s in all", start.elapsed().as_secs_f64());
    Ok(())
}

/// Sets up, builds the board's ELF files, breaks them, and compares the counts with the snapshot; `accept` writes them there.
pub(crate) fn faults(forced: Option<Way>, accept: bool) -> Result<()> {
    let tools = setup::run(forced)?;
    shell::run(tools.board.board_cargo("build").arg("--bins"))?;
    let accept = if accept { " --accept" } else { "" };
    host_sim(&format!(
        "faults --out target/foretorque/faults.json --snapshot tests/snapshots/faults.txt{accept}"
    ))
}

/// Sets up, builds, measures and compares with docs/budget.md; `accept` writes that page anew.
pub(crate) fn bench(forced: Option<Way>, accept: bool) -> Result<()> {
    let board = setup::run(forced)?.board;
    let arms = arm::larger(board, &arm::host_sim()?, &["bench", "joint"])?;
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
    let (elves, root) = (toolchain::elves(), shell::root());
    foretorque_cost::bench(&elves, &arms, &root, version.trim(), accept)
}
