//! The Debian way: packages by apt, and a toolchain built from the packaged compiler and its sources.

use std::fs::{self, File};
use std::io::Write as _;
use std::os::unix::fs::{OpenOptionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::{self, Command};

use anyhow::{Context as _, Result, bail, ensure};

use super::probe::{builds_for_board, oldest_rust, version};
use super::unpacked;
use crate::shell::{capture, command, run};
use crate::toolchain::{TARGET, linked_name};

/// Debian's compiler: never the one of the same name that rustup puts in front of it on the path.
const RUSTC: &str = "/usr/bin/rustc";

/// Compiler, its sources, clippy and rustfmt, under the two names Debian gives them. The `-web` set is the newer
/// compiler that a stable release carries for its browsers.
const PACKAGE_SETS: [[&str; 4]; 2] = [
    [
        "rustc-web",
        "rust-web-src",
        "rust-web-clippy",
        "rustfmt-web",
    ],
    ["rustc", "rust-src", "rust-clippy", "rustfmt"],
];

/// Whether Debian's compiler, its sources, clippy and rustfmt are installed and new enough.
pub(crate) fn rust_is_here() -> bool {
    let release = capture(command(RUSTC).arg("--version")).and_then(|text| version(&text));
    let files = [
        "/usr/bin/cargo-clippy",
        "/usr/bin/rustfmt",
        "/usr/bin/cargo-fmt",
    ];
    release.is_some_and(|release| release >= oldest_rust())
        && library_sources().is_some_and(|path| path.is_dir())
        && files.iter().all(|path| Path::new(path).exists())
}

fn sysroot() -> Option<PathBuf> {
    capture(command(RUSTC).args(["--print", "sysroot"])).map(|text| PathBuf::from(text.trim()))
}

fn library_sources() -> Option<PathBuf> {
    Some(sysroot()?.join("lib/rustlib/src/rust/library/core"))
}

/// The words that make a command run as root: none for root itself, `None` when it cannot be had without asking.
pub(crate) fn privilege() -> Option<&'static [&'static str]> {
    if capture(command("id").arg("-u"))?.trim() == "0" {
        return Some(&[]);
    }
    capture(command("sudo").args(["-n", "true"])).map(|_| ["sudo", "-n"].as_slice())
}

fn as_root(args: &[&str]) -> Result<Command> {
    let mut words = privilege()
        .context("neither root nor `sudo -n` works")?
        .to_vec();
    words.extend(["env", "DEBIAN_FRONTEND=noninteractive"]);
    words.extend(args);
    let mut command = command(words[0]);
    command.args(&words[1..]);
    Ok(command)
}

/// Waits for other installers and slow archives, but not for ever.
pub(crate) const PATIENCE: [&str; 7] = [
    "-qq",
    "-o",
    "DPkg::Lock::Timeout=120",
    "-o",
    "Acquire::Retries=2",
    "-o",
    "Acquire::http::Timeout=30",
];

/// Installs the emulator, the compiler set, or both.
pub(crate) fn install(emulator: bool, rust: bool) -> Result<()> {
    refresh()?;
    let mut packages = Vec::new();
    if rust {
        packages.extend(rust_packages()?);
    }
    let compilers = packages.clone();
    if emulator {
        packages.push(unpacked::PACKAGE);
    }
    match install_packages(&packages) {
        // The emulator may be what cannot be installed, and it has another way.
        Err(error) if emulator && rust => {
            println!("set-up: {error:#}; going on with the compiler alone");
            install_packages(&compilers)
        }
        outcome => outcome,
    }
}

/// Makes the installer's state sound and its lists new.
pub(crate) fn refresh() -> Result<()> {
    // An earlier run may have been stopped in the middle of dpkg; on a sound machine this does nothing.
    run(&mut as_root(&["dpkg", "--configure", "-a"])?)?;
    // One broken source among many fails the update; the lists of the others may still suffice.
    if let Err(error) = run(as_root(&["apt-get", "update"])?.args(PATIENCE)) {
        println!("set-up: {error:#}; going on with the lists that are here");
    }
    Ok(())
}

/// Installs packages from the lists that are here.
pub(crate) fn install_packages(packages: &[&str]) -> Result<()> {
    println!("set-up: apt-get install {}", packages.join(" "));
    // Never at the price of what is installed: Debian's two compilers exclude each other.
    let mut install = as_root(&[
        "apt-get",
        "install",
        "--yes",
        "--no-install-recommends",
        "--no-remove",
    ])?;
    run(install
        .args(PATIENCE)
        .args(["-o", "Dpkg::Use-Pty=0"])
        .args(packages))
}

fn rust_packages() -> Result<[&'static str; 4]> {
    let names = PACKAGE_SETS.iter().map(|set| set[0]);
    let policy = capture(command("apt-cache").arg("policy").args(names))
        .context("`apt-cache policy` failed")?;
    let (major, minor) = oldest_rust();
    choose_packages(&policy, (major, minor)).with_context(|| {
        format!("this Debian has no Rust compiler of version {major}.{minor} or later")
    })
}

/// The first set whose compiler's candidate version suffices, from the text of `apt-cache policy`.
fn choose_packages(policy: &str, oldest: (u32, u32)) -> Option<[&'static str; 4]> {
    let candidate = |package: &str| {
        let mut lines = policy
            .lines()
            .skip_while(|line| line.strip_suffix(':') != Some(package));
        lines
            .find_map(|line| line.trim().strip_prefix("Candidate:"))
            .and_then(version)
    };
    PACKAGE_SETS
        .into_iter()
        .find(|set| candidate(set[0]).is_some_and(|found| found >= oldest))
}

/// Builds the board's core and alloc once from the packaged sources and links the result as a rustup toolchain.
///
/// Everything is made and tried in a directory beside the final one and renamed at the end, so that an interrupted run
/// leaves no toolchain, or the old one. The caller holds the lock on `home`.
pub(crate) fn build_toolchain(home: &Path) -> Result<()> {
    sweep(home)?;
    let guard = Stage(home.join(format!("{STAGE_PREFIX}{}", process::id())));
    let stage = guard.0.as_path();
    let built = stage.join("toolchain");
    let place = home.join(linked_name());
    compile_core(stage)?;
    assemble(stage, &built, &place)?;
    let mut rustc = command(RUSTC);
    rustc.arg("--sysroot").arg(&built);
    builds_for_board(rustc)?;

    if place.exists() {
        fs::rename(&place, stage.join("old"))?;
    }
    fs::rename(&built, &place)
        .with_context(|| format!("cannot move the toolchain to {}", place.display()))?;
    run(command("rustup")
        .args(["toolchain", "link", &linked_name()])
        .arg(&place))
}

const STAGE_PREFIX: &str = ".building-";

/// Where a toolchain is made; gone when dropped, whether the making worked or not.
struct Stage(PathBuf);

impl Drop for Stage {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Removes what interrupted runs left: whoever holds the lock knows that nobody works there any more.
fn sweep(home: &Path) -> Result<()> {
    for entry in fs::read_dir(home)? {
        let entry = entry?;
        if entry
            .file_name()
            .to_string_lossy()
            .starts_with(STAGE_PREFIX)
        {
            fs::remove_dir_all(entry.path())?;
        }
    }
    Ok(())
}

fn compile_core(stage: &Path) -> Result<()> {
    let package = stage.join("empty");
    fs::create_dir_all(package.join("src"))?;
    fs::write(
        package.join("Cargo.toml"),
        "[package]\nname = \"empty\"\nedition = \"2024\"\n\n[workspace]\n\n[profile.release]\npanic = \"abort\"\n",
    )?;
    fs::write(package.join("src/lib.rs"), "#![no_std]\n")?;
    let mut cargo = command("cargo");
    cargo.current_dir(&package).args([
        "build",
        "--quiet",
        "--release",
        "-Zbuild-std=core,alloc",
        "--target",
        TARGET,
    ]);
    cargo.arg("--target-dir").arg(stage.join("target"));
    // Building core takes unstable flags that only a nightly or a bootstrapping compiler accepts. Fat link-time
    // optimisation later reads the bitcode, which cargo leaves out unless told.
    cargo
        .env("RUSTC", RUSTC)
        .env("RUSTC_BOOTSTRAP", "1")
        .env("RUSTFLAGS", "-C embed-bitcode=yes");
    cargo.env_remove("CARGO_ENCODED_RUSTFLAGS");
    run(&mut cargo)
}

/// Lays out the toolchain in `built`, with scripts that know it will live in `place`.
fn assemble(stage: &Path, built: &Path, place: &Path) -> Result<()> {
    let (bin, rustlib) = (built.join("bin"), built.join("lib/rustlib"));
    let libraries = rustlib.join(TARGET).join("lib");
    fs::create_dir_all(&bin)?;
    fs::create_dir_all(&libraries)?;
    for name in ["core", "alloc", "compiler_builtins"] {
        copy_rlib(
            &stage.join("target").join(TARGET).join("release/deps"),
            &libraries,
            name,
        )?;
    }

    // Build scripts and procedural macros run on the host: Debian's own libraries. The linker for the board is the
    // host toolchain's rust-lld, which rustc looks for beside them.
    let version = capture(command(RUSTC).arg("-vV")).context("Debian's rustc does not run")?;
    let host = version
        .lines()
        .find_map(|line| line.strip_prefix("host: "))
        .context("rustc -vV names no host")?;
    let host_sysroot = capture(command("rustc").args(["--print", "sysroot"]))
        .context("the host's rustc does not run")?;
    let here = |sysroot: PathBuf, sub: &str| sysroot.join("lib/rustlib").join(host).join(sub);
    fs::create_dir_all(rustlib.join(host))?;
    symlink(
        here(sysroot().context("Debian's rustc does not run")?, "lib"),
        rustlib.join(host).join("lib"),
    )?;
    symlink(
        here(PathBuf::from(host_sysroot.trim()), "bin"),
        rustlib.join(host).join("bin"),
    )?;

    // Left to itself rustup would lend it the cargo of any toolchain it has, nightly first.
    let cargo = capture(command("rustup").args(["which", "cargo"]))
        .context("`rustup which cargo` failed")?;
    symlink(cargo.trim(), bin.join("cargo"))?;
    for tool in ["cargo-fmt", "rustfmt"] {
        symlink(Path::new("/usr/bin").join(tool), bin.join(tool))?;
    }
    let place = quoted(place)?;
    script(
        &bin.join("rustc"),
        &format!("exec {RUSTC} --sysroot {place} \"$@\""),
    )?;
    script(
        &bin.join("cargo-clippy"),
        &format!("SYSROOT={place} exec /usr/bin/cargo-clippy \"$@\""),
    )
}

fn copy_rlib(from: &Path, to: &Path, name: &str) -> Result<()> {
    let prefix = format!("lib{name}-");
    let mut copied = 0;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let file = entry.file_name();
        let file = file.to_string_lossy();
        if file.starts_with(&prefix) && file.ends_with(".rlib") {
            fs::copy(entry.path(), to.join(&*file))?;
            copied += 1;
        }
    }
    ensure!(
        copied == 1,
        "{} holds {copied} rlibs of {name} where one is expected",
        from.display()
    );
    Ok(())
}

/// A path as one word of a shell script.
pub(crate) fn quoted(path: &Path) -> Result<String> {
    match path.to_str() {
        Some(text) if !text.contains(['\'', '\n']) => Ok(format!("'{text}'")),
        _ => bail!("{} cannot be written into a shell script", path.display()),
    }
}

fn script(path: &Path, line: &str) -> Result<()> {
    let mut file: File = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o755)
        .open(path)?;
    Ok(write!(file, "#!/bin/sh\n{line}\n")?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_set_with_a_new_enough_compiler_is_chosen() {
        let policy = |web: &str, plain: &str| {
            let entry = |name: &str, candidate: &str| match candidate {
                "" => String::new(),
                _ => format!(
                    "{name}:\n  Installed: (none)\n  Candidate: {candidate}\n  Version table:\n     1.99.0 500\n"
                ),
            };
            entry("rustc-web", web) + &entry("rustc", plain)
        };
        let cases = [
            (
                policy("1.96.0+dfsg1-1~deb12u2", "1.63.0+dfsg1-2"),
                Some("rustc-web"),
            ),
            (policy("", "1.97.0+dfsg1-1"), Some("rustc")),
            (policy("1.85.0+dfsg3-1", "1.97.0+dfsg1-1"), Some("rustc")),
            (policy("(none)", "1.85.0+dfsg3-1"), None),
            (String::new(), None),
        ];
        for (policy, expected) in cases {
            assert_eq!(
                choose_packages(&policy, (1, 95)).map(|set| set[0]),
                expected,
                "{policy}"
            );
        }
    }

    #[test]
    fn a_path_that_would_end_its_quotes_is_refused() {
        assert_eq!(quoted(Path::new("/home/a b/$x")).unwrap(), "'/home/a b/$x'");
        assert!(quoted(Path::new("/home/o'neil")).is_err());
    }
}
