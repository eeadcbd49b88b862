//! Firmware for a described arm: description, module, images, sizes. Nothing in the source tree changes.

use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use elf::ElfBytes;
use elf::abi::{PF_W, PT_LOAD};
use elf::endian::LittleEndian;

use crate::setup::{self, Way};
use crate::shell::{self, capture, command};
use crate::toolchain::{PROFILE, TARGET};

/// Where the arms go, from the workspace's root; `host-sim` looks for their images here.
const OUT: &str = "target/foretorque/arms";
/// Build directory of all arms: the images of the UR5 stay where they are.
const BUILD: &str = "target/arms";
/// Package and binary of every image that an arm gets.
const IMAGES: [(&str, &str); 2] = [("foretorque-f405", "joint"), ("foretorque-images", "bulk")];

/// Sets up, writes `NAME.toml` and `NAME.rs`, builds the images for the arm, and prints their sizes.
///
/// * `selection` options of `host-sim` that pick the arm from the file
pub(crate) fn run(forced: Option<Way>, urdf: &str, name: &str, selection: &[String]) -> Result<()> {
    let tools = setup::run(forced)?;
    // Relative paths are the caller's, and host-sim runs in the workspace's root.
    let urdf = fs::canonicalize(urdf).with_context(|| format!("cannot read {urdf}"))?;
    let out = shell::root().join(OUT).join(name);
    fs::create_dir_all(&out).with_context(|| format!("cannot write {}", out.display()))?;
    let (toml, module) = (
        out.join(name).with_extension("toml"),
        out.join(name).with_extension("rs"),
    );
    shell::run(command("cargo").args(["build", "--release", "-p", "host-sim"]))?;
    let host_sim = || {
        command(
            &shell::root()
                .join("target/release/host-sim")
                .to_string_lossy(),
        )
    };
    let mut describe = host_sim();
    describe
        .arg("describe")
        .arg(&urdf)
        .args(selection)
        .args(["--name", name]);
    let Some(text) = capture(&mut describe) else {
        // Once more, for its refusal to be seen.
        return shell::run(&mut describe);
    };
    fs::write(&toml, text).with_context(|| format!("cannot write {}", toml.display()))?;
    shell::run(
        host_sim()
            .arg("generate")
            .arg("--robot")
            .arg(&toml)
            .arg("--out")
            .arg(&module),
    )?;
    for (package, image) in IMAGES {
        let mut build = tools.board.tool("cargo");
        build
            .args(["build", "--profile", PROFILE, "--target", TARGET])
            .args(["-p", package, "--bin", image])
            .env("FORETORQUE_ARM", &module)
            .env("CARGO_TARGET_DIR", shell::root().join(BUILD));
        shell::run(&mut build)?;
        let elf = shell::root()
            .join(BUILD)
            .join(TARGET)
            .join(PROFILE)
            .join(image);
        let bytes = fs::read(&elf).with_context(|| format!("cannot read {}", elf.display()))?;
        let kept = out.join(image);
        fs::write(&kept, &bytes).with_context(|| format!("cannot write {}", kept.display()))?;
        let (flash, ram) = sizes(&bytes)?;
        println!(
            "{image}: {flash} bytes of flash, {ram} bytes of static RAM: {}",
            shown(&kept)
        );
    }
    println!(
        "host-sim run --robot {} --board qemu … runs it",
        shown(&toml)
    );
    Ok(())
}

/// Bytes in flash, and bytes of RAM that variables take.
fn sizes(elf: &[u8]) -> Result<(u64, u64)> {
    let file =
        ElfBytes::<LittleEndian>::minimal_parse(elf).context("the firmware is not an ELF file")?;
    let segments = file.segments().context("the firmware is not linked")?;
    let loaded = segments.iter().filter(|segment| segment.p_type == PT_LOAD);
    let (mut flash, mut ram) = (0, 0);
    for segment in loaded {
        flash += segment.p_filesz;
        ram += if segment.p_flags & PF_W == 0 {
            0
        } else {
            segment.p_memsz
        };
    }
    ensure!(flash > 0, "the firmware has no segments to load");
    Ok((flash, ram))
}

/// The path as one types it in the workspace's root.
fn shown(path: &Path) -> String {
    let root = shell::root();
    path.strip_prefix(root)
        .unwrap_or(path)
        .display()
        .to_string()
}
