//! Firmware for a described arm: description, module, images, sizes. Nothing in the source tree changes.

use std::fs;

use anyhow::{Context as _, Result};

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
    let [toml, module] = ["toml", "rs"].map(|kind| out.join(name).with_extension(kind));
    shell::run(command("cargo").args(["build", "--release", "-p", "host-sim"]))?;
    let program = shell::root().join("target/release/host-sim");
    let host_sim = || command(&program.to_string_lossy());
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
    shell::write(&toml, text)?;
    let mut generate = host_sim();
    generate.args(["generate", "--robot"]).arg(&toml);
    shell::run(generate.arg("--out").arg(&module))?;
    for (package, image) in IMAGES {
        let mut build = tools.board.tool("cargo");
        build
            .args(["build", "--profile", PROFILE, "--target", TARGET])
            .args(["-p", package, "--bin", image])
            .env("FORETORQUE_ARM", &module)
            .env("CARGO_TARGET_DIR", shell::root().join(BUILD));
        shell::run(&mut build)?;
        let elves = shell::root().join(BUILD).join(TARGET).join(PROFILE);
        let bytes = shell::read(&elves.join(image))?;
        let kept = out.join(image);
        shell::write(&kept, &bytes)?;
        let (flash, ram) = foretorque_cost::sizes(&kept)?;
        println!(
            "{image}: {flash} bytes of flash, {ram} bytes of static RAM: {}",
            shell::shown(&kept)
        );
    }
    foretorque_cost::check_firmware(&out, &[foretorque_cost::JOINT])?;
    println!(
        "host-sim run --robot {} --board qemu … runs it",
        shell::shown(&toml)
    );
    Ok(())
}
