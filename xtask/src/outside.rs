//! Code outside this workspace, as a user has it. Crates: they link, few others come along, and the library can be packaged.
//! The library for C: static library, and the example in C that the tests run in the emulator.

use std::collections::BTreeSet;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail, ensure};

use crate::setup::{self, Way};
use crate::shell::{self, PROFILE, TARGET, Toolchain, Tools, capture, command, run_bounded};

/// Manifest of a user's crate with its own arm and critical section.
const OWN_ARM: &str = "firmware/foretorque/examples/own_arm/Cargo.toml";
/// Manifest of a user's RTIC application.
const RTIC: &str = "firmware/foretorque/examples/rtic/Cargo.toml";
/// Packages that others can depend on, in the order of publication.
const PUBLISHABLE: [&str; 2] = ["foretorque", "foretorque-link"];
/// Cortex-M33 with FPU, which rustup installs on request.
const OTHER_TARGET: &str = "thumbv8m.main-none-eabihf";
/// Crates that the user of the library gets at most, the user's own included.
const MOST_CRATES: usize = 30;
/// Parts of the names of crates that belong to a board or an executor.
const FOREIGN: [&str; 4] = ["cortex-m", "stm32", "rtic", "embassy"];

/// Samples from which the RTIC application learns in the emulator, which takes a second; an application that hangs is ended.
const SAMPLES: usize = 200;
const HANGS_S: u32 = 60;

/// Links both crates for [`TARGET`], the first one for [`OTHER_TARGET`] too where rustup has or brings its core; counts its
/// crates, packages the publishable ones and starts the RTIC application.
pub(crate) fn gate(tools: Tools) -> Result<()> {
    for (manifest, target) in [(OWN_ARM, TARGET), (OWN_ARM, OTHER_TARGET), (RTIC, TARGET)] {
        let mut toolchain = tools.board;
        if target != TARGET {
            // The one that rustup adds a core to.
            toolchain = Toolchain::Host;
            if !installed(toolchain, target)? {
                let add = format!("rustup target add {target}");
                if let Err(reason) = run_bounded(&add, setup::RUSTUP_LIMIT_S) {
                    println!("{reason}");
                }
            }
            if !installed(toolchain, target)? {
                println!("skipped: crate outside for {target}, its core is not installed");
                continue;
            }
        }
        shell::run(&mut toolchain.tool(&format!(
            "cargo build --release --locked --target {target} --target-dir target/outside --manifest-path {manifest}"
        )))?;
    }
    let elf = Path::new("target/outside").join(TARGET);
    starts(&elf.join("release/rtic_joint"))?;
    let tree = capture(&mut tools.board.tool(&format!(
        "cargo tree --locked --target {TARGET} -e normal --prefix none --manifest-path {OWN_ARM}"
    )));
    let tree = tree.context("`cargo tree` failed")?;
    let count = judge(&tree)?;
    println!("a crate outside links with {count} crates");

    let packages = PUBLISHABLE.map(|name| format!(" -p {name}")).concat();
    let line = format!("cargo package --quiet --allow-dirty --no-verify{packages}");
    shell::run(&mut tools.host.tool(&line))
}

/// Runs the RTIC application in the emulator. Its panics reset the board, and a reset ends the emulator.
fn starts(elf: &Path) -> Result<()> {
    let mut emulator = command(&format!(
        "timeout {HANGS_S} qemu-system-arm -machine netduinoplus2 -display none -monitor none -serial none -no-reboot -d int \
         -kernel"
    ));
    emulator
        .arg(elf)
        .stdin(Stdio::null())
        .stderr(Stdio::piped());
    let mut emulator = emulator.spawn().context("cannot start `timeout`")?;
    let log = emulator.stderr.take().context("the emulator has no log")?;
    let (mut samples, mut last_message) = (0, "nothing".to_owned());
    for line in BufReader::new(log).lines() {
        let line = line?;
        // The dispatcher of the learning task is interrupt 7, exception 23.
        samples += usize::from(line.ends_with("previous exception 23"));
        if samples == SAMPLES {
            break;
        }
        if line.contains("qemu") {
            last_message = line;
        }
    }
    // `timeout` hands SIGTERM on to the emulator; killed, it would leave it behind. Fails where both have ended.
    let end = format!("kill {}", emulator.id());
    Command::new("sh").args(["-c", &end]).status()?;
    emulator.wait()?;
    let elf = elf.display();
    ensure!(
        samples == SAMPLES,
        "{elf} learnt from {samples} samples, then: {last_message}"
    );
    println!("the RTIC application runs: {samples} samples learnt");
    Ok(())
}

/// The core of `target` is there.
fn installed(toolchain: Toolchain, target: &str) -> Result<bool> {
    let sysroot = capture(&mut toolchain.tool("rustc --print sysroot"));
    let sysroot = sysroot.context("`rustc` failed")?;
    let libraries = Path::new(sysroot.trim()).join("lib/rustlib").join(target);
    Ok(libraries.join("lib").is_dir())
}

/// Number of the crates in `tree`; an error if there are too many, or foreign ones.
fn judge(tree: &str) -> Result<usize> {
    let names = tree.lines().filter_map(|line| line.split(' ').next());
    let crates: BTreeSet<&str> = names.filter(|name| !name.is_empty()).collect();
    ensure!(crates.contains("foretorque"), "no foretorque in:\n{tree}");
    if crates.len() > MOST_CRATES {
        bail!("{} crates, more than {MOST_CRATES}:\n{tree}", crates.len());
    }
    let foreign = |name: &&&str| FOREIGN.iter().any(|part| name.contains(part));
    if let Some(name) = crates.iter().find(foreign) {
        bail!("`{name}` comes along with foretorque");
    }
    Ok(crates.len())
}

/// C's own half of the example, from the workspace's root.
const PLACE: &str = "firmware/capi";
/// The compiler of the example in C.
const COMPILER: &str = "arm-none-eabi-gcc";

/// Installs the compiler, unless it is here.
pub(crate) fn bring_compiler() -> Result<()> {
    setup::bring_program(COMPILER, "gcc-arm-none-eabi")
}

/// Sets up, compiler for C included, writes the header, and builds both.
pub(crate) fn capi(forced: Option<Way>) -> Result<()> {
    let tools = setup::run(forced)?;
    bring_compiler()?;
    let line = "cargo test --quiet -p foretorque-capi --test interface the_header";
    let mut header = tools.host.tool(line);
    shell::run(header.env("UPDATE_HEADER", "1"))?;
    build_capi(tools)?;
    println!(
        "library: {}\nheader:  {PLACE}/include/foretorque.h\nexample: {}",
        shell::elf("libforetorque_capi.a").display(),
        shell::elf("capi-example").display()
    );
    Ok(())
}

/// Builds the static library, whose link proves that nothing in it panics, and the example.
pub(crate) fn build_capi(tools: Tools) -> Result<()> {
    shell::run(&mut tools.board.tool(&format!(
        "cargo rustc --profile {PROFILE} --target {TARGET} -p foretorque-capi --lib --crate-type staticlib"
    )))?;
    let example = format!("{PLACE}/example");
    // The example compares bits with another machine: no fused operations.
    let mut compiler = command(&format!(
        "{COMPILER} -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16 -std=c11 -O2 -Wall -Wextra -Werror \
         -ffp-contract=off -ffreestanding -nostdlib -I {PLACE}/include {example}/main.c {example}/startup.c"
    ));
    compiler.arg(shell::elf("libforetorque_capi.a"));
    compiler.args(["-T", &format!("{example}/link.ld")]);
    compiler.args(["-Wl,--gc-sections", "-Wl,-z,noexecstack", "-o"]);
    shell::run(compiler.arg(shell::elf("capi-example"))).context("the example in C does not build")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crate_counts_once() {
        let tree = "own_arm v0.1.0 (/x)\nforetorque v0.1.0 (/y)\nlibm v0.2.16\nlibm v0.2.16 (*)\n";
        assert_eq!(judge(tree).unwrap(), 3);
    }

    #[test]
    fn too_many_and_foreign_crates_are_refused() {
        let many: String = (0..MOST_CRATES).map(|n| format!("a{n} v1.0.0\n")).collect();
        assert!(judge(&format!("{many}foretorque v0.1.0\n")).is_err());
        assert!(judge("foretorque v0.1.0\ncortex-m-rt v0.7.5\n").is_err());
        assert!(judge("own_arm v0.1.0\n").is_err());
    }
}
