//! Gives the linker the memory map of the chip.

fn main() {
    println!(
        "cargo::rustc-link-search={}/../../../..",
        env!("CARGO_MANIFEST_DIR")
    );
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
}
