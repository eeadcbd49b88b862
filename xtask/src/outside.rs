//! A crate outside this workspace, as a user has one: it links for two cores, and what comes along stays little.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};

use crate::shell;
use crate::toolchain::{TARGET, Toolchain, Tools};

/// Folder of the crate.
const CRATE: &str = "tests/outside";
/// Cortex-M33 with FPU, which rustup installs on request.
const OTHER_TARGET: &str = "thumbv8m.main-none-eabihf";
/// Crates that the user of the library gets at most, the user's own included.
const MOST_CRATES: usize = 30;
/// Parts of the names of crates that belong to a board or an executor.
const FOREIGN: [&str; 4] = ["cortex-m", "stm32", "rtic", "embassy"];

/// Links the crate for [`TARGET`], and for [`OTHER_TARGET`] where its core is installed; counts its crates.
pub(crate) fn gate(tools: Tools) -> Result<()> {
    for target in [TARGET, OTHER_TARGET] {
        if target != TARGET && !installed(tools.board, target)? {
            println!("skipped for {target}: `rustup target add {target}` installs its core");
            continue;
        }
        let mut build = tools.board.tool("cargo");
        build.args(["build", "--release", "--locked", "--target", target]);
        build.args(["--target-dir", "target/outside"]);
        shell::run(
            build
                .arg("--manifest-path")
                .arg(format!("{CRATE}/Cargo.toml")),
        )?;
    }
    let mut tree = tools.board.tool("cargo");
    tree.args([
        "tree", "--locked", "--target", TARGET, "-e", "normal", "--prefix", "none",
    ]);
    tree.arg("--manifest-path")
        .arg(format!("{CRATE}/Cargo.toml"));
    let output = tree.output().context("cannot start `cargo tree`")?;
    ensure!(output.status.success(), "`cargo tree` failed");
    let count = judge(&String::from_utf8_lossy(&output.stdout))?;
    println!("a crate outside links with {count} crates");
    Ok(())
}

/// The core of `target` is there.
fn installed(toolchain: Toolchain, target: &str) -> Result<bool> {
    let output = toolchain
        .tool("rustc")
        .args(["--print", "sysroot"])
        .output();
    let sysroot = output.context("cannot start `rustc`")?.stdout;
    let sysroot = String::from_utf8_lossy(&sysroot);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crate_counts_once() {
        let tree = "outside v0.1.0 (/x)\nforetorque v0.1.0 (/y)\nlibm v0.2.16\nlibm v0.2.16 (*)\n";
        assert_eq!(judge(tree).unwrap(), 3);
    }

    #[test]
    fn too_many_and_foreign_crates_are_refused() {
        let many: String = (0..MOST_CRATES).map(|n| format!("a{n} v1.0.0\n")).collect();
        assert!(judge(&format!("{many}foretorque v0.1.0\n")).is_err());
        assert!(judge("foretorque v0.1.0\ncortex-m-rt v0.7.5\n").is_err());
        assert!(judge("outside v0.1.0\n").is_err());
    }
}
