//! Looking at the machine without changing it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, process};

use anyhow::{Context as _, Result, bail};

use super::facts::{Facts, Kit, Means};
use super::{debian, unpacked};
use crate::shell::{capture, command, line};
use crate::toolchain::{TARGET, Toolchain, linked_name};

/// The oldest compiler this workspace builds with, as (major, minor).
pub(crate) fn oldest_rust() -> (u32, u32) {
    version(env!("CARGO_PKG_RUST_VERSION")).unwrap_or((1, 95))
}

/// (major, minor) of the first `major.minor` in a text such as `rustc 1.95.0 (…)` or `1.96.0+dfsg1-1~deb12u2`.
pub(crate) fn version(text: &str) -> Option<(u32, u32)> {
    let start = text.find(|c: char| c.is_ascii_digit())?;
    let mut parts = text[start..].split(|c: char| !c.is_ascii_digit());
    Some((parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
}

/// What the machine looks like, every means still untried.
pub(crate) fn facts() -> Facts {
    let present = |here: bool| if here { Means::Ready } else { Means::Absent };
    let rustup = capture(command("rustup").arg("--version")).is_some();
    let apt =
        capture(command("apt-get").arg("--version")).is_some() && debian::privilege().is_some();
    let debian_rust = debian::rust_is_here();
    Facts {
        host: kit(Toolchain::Host),
        linked: if rustup {
            kit(Toolchain::Linked)
        } else {
            Kit::default()
        },
        emulator: emulator().is_some(),
        debian_rust,
        rustup: present(rustup),
        apt: present(apt),
        unpack: present(unpacked::possible()),
        build: present(rustup && (apt || debian_rust)),
    }
}

/// One line for each thing looked at.
pub(crate) fn describe(facts: &Facts) -> String {
    let has = |kit: &Kit| {
        let word =
            |name: &str, here: bool| format!("{name} {}", if here { "found" } else { "missing" });
        [
            word("board target", kit.target),
            word("clippy", kit.clippy),
            word("rustfmt", kit.rustfmt),
        ]
        .join(", ")
    };
    let release = |toolchain: Toolchain| {
        capture(toolchain.tool("rustc").arg("--version")).map(|text| text.trim().to_owned())
    };
    let host = release(Toolchain::Host).unwrap_or_else(|| "no rustc".into());
    let linked = match release(Toolchain::Linked) {
        Some(text) => format!("{text}: {}", has(&facts.linked)),
        None => "not there".into(),
    };
    let emulator = emulator()
        .unwrap_or_else(|| "missing (qemu-system-arm with the machine netduinoplus2)".into());
    format!(
        "  host: {host}: {}\n  {}: {linked}\n  emulator: {emulator}",
        has(&facts.host),
        linked_name()
    )
}

/// The emulator's version line when it is here and knows the board's machine.
fn emulator() -> Option<String> {
    let machines = capture(command("qemu-system-arm").args(["-machine", "help"]))?;
    machines
        .lines()
        .any(|line| line.starts_with("netduinoplus2 "))
        .then_some(())?;
    Some(
        capture(command("qemu-system-arm").arg("--version"))?
            .lines()
            .next()?
            .to_owned(),
    )
}

/// What a toolchain can do, found out by using it.
fn kit(toolchain: Toolchain) -> Kit {
    let new_enough = capture(toolchain.tool("rustc").arg("--version"))
        .and_then(|text| version(&text))
        .is_some_and(|found| found >= oldest_rust());
    if !new_enough {
        return Kit::default();
    }
    Kit {
        target: builds_for_board(toolchain.tool("rustc")).is_ok(),
        clippy: capture(toolchain.tool("cargo").args(["clippy", "--version"])).is_some(),
        rustfmt: capture(toolchain.tool("cargo").args(["fmt", "--version"])).is_some(),
    }
}

/// Whether this rustc compiles and links a small whole-program-optimised board program.
///
/// A file that exists proves little: it may belong to another compiler's version after an upgrade, lack the bitcode
/// that link-time optimisation reads, or find no linker. This takes a fifth of a second and proves all three.
pub(crate) fn builds_for_board(mut rustc: Command) -> Result<()> {
    let place = Scratch::new("smoke")?;
    let source = place.0.join("smoke.rs");
    fs::write(&source, include_str!("smoke.rs"))?;
    rustc.args([
        "--edition",
        "2024",
        "--crate-type",
        "bin",
        "--target",
        TARGET,
    ]);
    rustc.args([
        "-C",
        "opt-level=1",
        "-C",
        "panic=abort",
        "-C",
        "lto=fat",
        "-C",
        "codegen-units=1",
        "-o",
    ]);
    rustc.args([
        place.0.join("smoke").as_os_str(),
        OsStr::new("--"),
        source.as_os_str(),
    ]);
    let output = rustc
        .output()
        .with_context(|| format!("cannot start `{}`", line(&rustc)))?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        let reason = text
            .lines()
            .find(|line| line.starts_with("error"))
            .unwrap_or("error: no reason given");
        bail!("a small program for {TARGET} does not build: {reason}");
    }
    Ok(())
}

/// A directory of this process's own, gone when dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Result<Self> {
        let path: PathBuf = env::temp_dir().join(format!("foretorque-{name}-{}", process::id()));
        fs::create_dir_all(&path)
            .with_context(|| format!("cannot write {}", Path::new(&path).display()))?;
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_read_where_they_stand() {
        assert_eq!(
            version("rustc 1.95.0 (59807616e 2026-04-14)"),
            Some((1, 95))
        );
        assert_eq!(version("1.96.0+dfsg1-1~deb12u2"), Some((1, 96)));
        assert_eq!(version("1.95"), Some((1, 95)));
        assert_eq!(version("(none)"), None);
        assert!(version("1.100.0") > version("1.95.0"));
    }
}
