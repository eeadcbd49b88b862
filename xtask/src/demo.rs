//! The main job in one command.

use std::fs;
use std::time::Instant;

use anyhow::{Context as _, Result};

use crate::setup::{self, Way};
use crate::shell::{self, command};
use crate::toolchain;

/// Where the demo's report goes, from the workspace's root.
const OUT: &str = "target/foretorque/demo";
/// The flashable ELF that the demo emulated, kept beside its report for comparison with the one that is flashed.
pub(crate) const ELF_COPY: &str = "target/foretorque/demo/joint.elf";

/// Sets up, builds both sides, and runs the demo experiment on the board's ELF files.
pub(crate) fn run(forced: Option<Way>) -> Result<()> {
    let start = Instant::now();
    let tools = setup::run(forced)?;
    let mut firmware = tools.board.board_cargo("build");
    shell::run(firmware.args(["--bin", "joint", "--bin", "bulk"]))?;
    shell::run(command("cargo").args(["build", "--release", "-p", "host-sim"]))?;
    println!("demo: built after {:.1} s", start.elapsed().as_secs_f64());
    shell::run(command("cargo").args([
        "run",
        "--quiet",
        "--release",
        "-p",
        "host-sim",
        "--",
        "experiment",
        "demo",
        "--out",
        OUT,
    ]))?;
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
