//! Hands the linker the memory map of the chip, wherever cargo was called from: to this package and those that depend on it.
//! Hands the compiler the arm of the images where it is not the UR5.

use std::path::PathBuf;

/// Module that `host-sim generate` wrote for the arm of the images.
const ARM: &str = "FORETORQUE_ARM";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(described_arm)");
    println!("cargo::rerun-if-env-changed={ARM}");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    if let Ok(module) = std::env::var(ARM) {
        println!("cargo::rerun-if-changed={module}");
        let text = std::fs::read_to_string(&module).unwrap_or_default();
        let arm = text
            .lines()
            .find_map(|line| line.strip_prefix("pub struct ")?.strip_suffix(';'));
        let Some(arm) = arm else {
            println!("cargo::error={ARM}={module} is no module that host-sim generate wrote");
            return;
        };
        let chosen = format!(
            "#[path = {module:?}]\npub mod module;\npub use module::{{\n    JOINTS, Learner, PARAMETERS, {arm} as Arm,\n}};\n"
        );
        let out = PathBuf::from(std::env::var("OUT_DIR").unwrap_or_default());
        if let Err(error) = std::fs::write(out.join("described_arm.rs"), chosen) {
            println!("cargo::error={}: {error}", out.display());
        }
        println!("cargo::rustc-cfg=described_arm");
    }
    // link.x of cortex-m-rt includes memory.x.
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let map = root.join("memory.x");
    println!("cargo::rerun-if-changed={}", map.display());
    println!("cargo::rustc-link-search={}", root.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    // The script of the log keeps the table of its messages in a section the board never loads.
    println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    // The level of the log is part of the image, so one ELF serves demo and flash; an environment variable overrides.
    println!("cargo::rerun-if-env-changed=DEFMT_LOG");
    let level = std::env::var("DEFMT_LOG").unwrap_or_else(|_| "info".into());
    println!("cargo::rustc-env=DEFMT_LOG={level}");
}
