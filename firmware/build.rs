//! Hands the linker its scripts, wherever cargo was called from.

use std::path::PathBuf;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    // link.x of cortex-m-rt says INCLUDE memory.x; the file lies in the workspace root, beside the crates.
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    println!(
        "cargo::rerun-if-changed={}",
        root.join("memory.x").display()
    );
    println!("cargo::rustc-link-search={}", root.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    // The level of the log is part of the image, so one ELF serves demo and flash; an environment variable overrides.
    println!("cargo::rerun-if-env-changed=DEFMT_LOG");
    let level = std::env::var("DEFMT_LOG").unwrap_or_else(|_| "info".into());
    println!("cargo::rustc-env=DEFMT_LOG={level}");
    // Only these have a logger; the script keeps the table of its messages in a section the board never loads.
    for logs in ["joint", "joint-pyboard", "joint-drive"] {
        println!("cargo::rustc-link-arg-bin={logs}=-Tdefmt.x");
    }
}
