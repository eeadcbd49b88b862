//! Hands the linker the memory map of the chip, wherever cargo was called from: to this package and those that depend on it.

use std::path::PathBuf;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
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
