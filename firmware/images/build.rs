//! Hands the linker the script of the run-time; the memory map comes with the package of the chip.

use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let chip = Path::new(env!("CARGO_MANIFEST_DIR")).join("../boards/f405");
        println!("cargo::rustc-link-search={}", chip.display());
        println!("cargo::rustc-link-arg-bins=-Tlink.x");
    }
}
