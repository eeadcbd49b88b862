//! The library for C: static library, and the example in C that the tests run in the emulator.

use anyhow::{Context as _, Result};

use crate::setup::{self, Way};
use crate::shell::{self, command};
use crate::toolchain::{self, PROFILE, TARGET, Tools};

/// C's own half of the example, from the workspace's root.
const PLACE: &str = "firmware/capi";
/// The compiler of the example in C.
const COMPILER: &str = "arm-none-eabi-gcc";

/// Installs the compiler, unless it is here.
pub(crate) fn bring_compiler() -> Result<()> {
    setup::bring_program(COMPILER, "gcc-arm-none-eabi")
}

/// Sets up, compiler for C included, and builds both.
pub(crate) fn run(forced: Option<Way>) -> Result<()> {
    let tools = setup::run(forced)?;
    bring_compiler()?;
    build(tools)?;
    println!(
        "library: {}\nheader:  {PLACE}/include/foretorque.h\nexample: {}",
        toolchain::elf("libforetorque_capi.a").display(),
        toolchain::elf("capi-example").display()
    );
    Ok(())
}

/// Builds the static library, whose link proves that nothing in it panics, and the example.
pub(crate) fn build(tools: Tools) -> Result<()> {
    let mut library = tools.board.tool("cargo");
    library.args(["rustc", "--profile", PROFILE, "--target", TARGET]);
    library.args(["-p", "foretorque-capi", "--lib"]);
    library.args(["--crate-type", "staticlib"]);
    shell::run(&mut library)?;

    let place = shell::root().join(PLACE);
    let example = place.join("example");
    let mut compiler = command(COMPILER);
    compiler
        .args(["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard"])
        .args(["-mfpu=fpv4-sp-d16", "-std=c11", "-O2", "-Wall", "-Wextra"])
        // The example compares bits with another machine: no fused operations.
        .args(["-Werror", "-ffp-contract=off"])
        .args(["-ffreestanding", "-nostdlib"])
        .arg("-I")
        .arg(place.join("include"))
        .arg(example.join("main.c"))
        .arg(example.join("startup.c"))
        .arg(toolchain::elf("libforetorque_capi.a"))
        .arg("-T")
        .arg(example.join("link.ld"))
        .args(["-Wl,--gc-sections", "-Wl,-z,noexecstack", "-o"])
        .arg(toolchain::elf("capi-example"));
    shell::run(&mut compiler).context("the example in C does not build")
}
