//! Demo, faults, bench and described arms in one command each: set-up, build of both sides, run.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result};

use crate::flash::{self, ELF_COPY};
use crate::setup::{self, Way};
use crate::shell::{self, PROFILE, TARGET, Toolchain, capture, command};

/// Sets up, builds both sides, and runs the demo experiment on the board's ELF files.
pub(crate) fn demo(forced: Option<Way>) -> Result<()> {
    let start = Instant::now();
    let mut firmware = setup::run(forced)?.board.board_cargo("build");
    shell::run(firmware.args(["--bin", "joint", "--bin", "bulk"]))?;
    let mut host_sim = command(&host_sim()?.to_string_lossy());
    println!("demo: built after {:.1} s", start.elapsed().as_secs_f64());
    shell::run(host_sim.args(["experiment", "demo", "--out", "target/foretorque/demo"]))?;
    let elf = shell::elf("joint");
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
    shell::run(setup::run(forced)?.board.board_cargo("build").arg("--bins"))?;
    let mut faults = command(&host_sim()?.to_string_lossy());
    faults.args(["faults", "--out", "target/foretorque/faults.json"]);
    faults.args(["--snapshot", "tests/snapshots/faults.txt"]);
    shell::run(faults.args(accept.then_some("--accept")))
}

/// Sets up, builds, measures and compares with docs/budget.md; `accept` writes that page anew.
pub(crate) fn bench(forced: Option<Way>, accept: bool) -> Result<()> {
    let board = setup::run(forced)?.board;
    let arms = larger(board, &host_sim()?, &["bench", "joint"])?;
    let mut build = board.board_cargo("build");
    let images = ["bench", "joint", "joint-drive", "joint-can"];
    shell::run(build.args(images.iter().flat_map(|image| ["--bin", image])))?;
    let version = capture(board.tool("rustc").arg("--version"));
    let version = version.context("rustc reports no version")?;
    let (elf_dir, root) = (shell::elf_dir(), shell::root());
    foretorque_cost::bench(&elf_dir, &arms, &root, version.trim(), accept)
}

/// Where the arms go, from the workspace's root; `host-sim` looks for their images here.
const OUT: &str = "target/foretorque/arms";
/// Where cargo leaves the images of all arms: those of the UR5 stay where they are.
const BUILD: &str = "target/arms";
/// Joints, descriptions and names of the larger arms whose images the gates boot and the bench measures.
const LARGER: [(usize, &str, &str); 2] = [
    (7, "host-sim/robots/panda.urdf", "panda7"),
    (8, "host-sim/robots/eight.toml", "eight"),
];

/// Sets up, builds `joint` and `bulk` for the arm of a file, writes the images to flash, and prints how to run it.
///
/// * `selection` options of `host-sim` that pick the arm from the file
pub(crate) fn arm(forced: Option<Way>, urdf: &str, name: &str, selection: &[String]) -> Result<()> {
    let board = setup::run(forced)?.board;
    // Relative paths are the caller's, and host-sim runs in the workspace's root.
    let urdf = fs::canonicalize(urdf).with_context(|| format!("cannot read {urdf}"))?;
    let program = host_sim()?;
    let out = build(
        board,
        &program,
        (&urdf, name, selection),
        &["joint", "bulk"],
    )?;
    let joint = out.join("joint");
    println!("ELF:  {}", shell::shown(&joint));
    flash::write_images(&shell::read(&joint)?, &joint)?;
    println!(
        "host-sim run --robot {} --board qemu … runs it",
        shell::shown(&out.join(name).with_extension("toml"))
    );
    Ok(())
}

/// The optimised command line, built if it is not.
fn host_sim() -> Result<PathBuf> {
    shell::run(command("cargo").args(["build", "--release", "-p", "host-sim"]))?;
    Ok(shell::root().join("target/release/host-sim"))
}

/// Builds `images` for the arms of seven and eight joints; returns these numbers and the directories.
pub(crate) fn larger(
    board: Toolchain,
    host_sim: &Path,
    images: &[&str],
) -> Result<Vec<(usize, PathBuf)>> {
    let arms = LARGER.iter().map(|(joints, file, name)| {
        let file = shell::root().join(file);
        Ok((*joints, build(board, host_sim, (&file, name, &[]), images)?))
    });
    arms.collect()
}

/// Writes `NAME.toml` and `NAME.rs`, builds `images` for the arm, prints their sizes and checks `joint`; returns their
/// directory.
fn build(
    board: Toolchain,
    host_sim: &Path,
    (file, name, selection): (&Path, &str, &[String]),
    images: &[&str],
) -> Result<PathBuf> {
    let out = shell::root().join(OUT).join(name);
    let [toml, module] = ["toml", "rs"].map(|kind| out.join(name).with_extension(kind));
    let host_sim = || command(&host_sim.to_string_lossy());
    let mut describe = host_sim();
    describe
        .arg("describe")
        .arg(file)
        .args(selection)
        .args(["--name", name]);
    let Some(text) = capture(&mut describe) else {
        // Once more, for its refusal to be seen.
        shell::run(&mut describe)?;
        anyhow::bail!("`host-sim describe` failed once");
    };
    shell::write(&toml, text)?;
    let mut generate = host_sim();
    generate.args(["generate", "--robot"]).arg(&toml);
    shell::run(generate.arg("--out").arg(&module))?;
    let target = shell::root().join(BUILD);
    let mut build = board.board_cargo("build");
    build
        .args(images.iter().flat_map(|image| ["--bin", image]))
        .env("FORETORQUE_ARM", &module)
        // What does not depend on the arm is not compiled again.
        .env("CARGO_BUILD_BUILD_DIR", shell::root().join("target"))
        .env("CARGO_TARGET_DIR", &target);
    shell::run(&mut build)?;
    for image in images {
        let kept = out.join(image);
        let elf = target.join(TARGET).join(PROFILE).join(image);
        shell::write(&kept, shell::read(&elf)?)?;
        let (flash, ram) = foretorque_cost::sizes(&kept)?;
        println!(
            "{image}: {flash} bytes of flash, {ram} bytes of static RAM: {}",
            shell::shown(&kept)
        );
    }
    foretorque_cost::check_firmware(&out, &[foretorque_cost::JOINT])?;
    Ok(out)
}
