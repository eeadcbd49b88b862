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
    let board = setup::run(forced)?.board;
    shell::run(&mut board.board_cargo("build --bin joint --bin bulk"))?;
    let host_sim = host_sim()?;
    println!("demo: built after {:.1} s", start.elapsed().as_secs_f64());
    let demo = format!("{host_sim} experiment demo --out target/foretorque/demo");
    shell::run(&mut command(&demo))?;
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
    shell::run(&mut setup::run(forced)?.board.board_cargo("build --bins"))?;
    let mut faults = command(&format!(
        "{} faults --out target/foretorque/faults.json --snapshot tests/snapshots/faults.txt",
        host_sim()?
    ));
    shell::run(faults.args(accept.then_some("--accept")))
}

/// Sets up, builds, measures and compares with docs/budget.md; `accept` writes that page anew.
pub(crate) fn bench(forced: Option<Way>, accept: bool) -> Result<()> {
    let board = setup::run(forced)?.board;
    let arms = larger(board, host_sim()?, &["bench", "joint"])?;
    let images = "--bin bench --bin joint --bin joint-drive --bin joint-can";
    shell::run(&mut board.board_cargo(&format!("build {images}")))?;
    let version = capture(&mut board.tool("rustc --version"));
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
    let arm = (urdf.as_path(), name, selection);
    let out = build(board, host_sim()?, arm, &["joint", "bulk"])?;
    let joint = out.join("joint");
    println!("ELF:  {}", shell::shown(&joint));
    flash::write_images(&shell::read(&joint)?, &joint)?;
    println!(
        "host-sim run --robot {} --board qemu … runs it",
        shell::shown(&out.join(name).with_extension("toml"))
    );
    Ok(())
}

/// The optimised command line, built if it is not, from the workspace's root.
fn host_sim() -> Result<&'static str> {
    shell::run(&mut command("cargo build --release -p host-sim"))?;
    Ok("target/release/host-sim")
}

/// Builds `images` for the arms of seven and eight joints; returns these numbers and the directories.
pub(crate) fn larger(
    board: Toolchain,
    host_sim: &str,
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
    host_sim: &str,
    (file, name, selection): (&Path, &str, &[String]),
    images: &[&str],
) -> Result<PathBuf> {
    let out = shell::root().join(OUT).join(name);
    let [toml, module] = ["toml", "rs"].map(|kind| out.join(name).with_extension(kind));
    let mut describe = command(&format!("{host_sim} describe"));
    describe.arg(file).args(selection).args(["--name", name]);
    let Some(text) = capture(&mut describe) else {
        // Once more, for its refusal to be seen.
        shell::run(&mut describe)?;
        anyhow::bail!("`host-sim describe` failed once");
    };
    shell::write(&toml, text)?;
    let mut generate = command(&format!("{host_sim} generate --robot"));
    shell::run(generate.arg(&toml).arg("--out").arg(&module))?;
    let target = shell::root().join(BUILD);
    let mut build = board.board_cargo(&format!("build --bin {}", images.join(" --bin ")));
    build
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
