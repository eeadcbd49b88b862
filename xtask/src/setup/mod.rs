//! Brings what building and running need: look, plan, do one step, look again.

mod debian;
mod facts;
mod plan;
mod probe;
mod unpacked;

use std::fs::{self, File, TryLockError};
use std::path::PathBuf;
use std::time::{Duration, Instant};
use std::{env, io};

use anyhow::{Context as _, Result, bail};

use facts::{Facts, Means};
pub(crate) use plan::Way;
use plan::{Need, Plan, Step, missing, plan};

use crate::shell::{capture, command, run_bounded, timed};
use crate::toolchain::{TARGET, Toolchain, Tools, linked_name};

/// Bound on rustup when other ways are left to try, and when it is the only one.
const RUSTUP_LIMIT: Duration = Duration::from_secs(60);
const RUSTUP_LIMIT_FORCED: Duration = Duration::from_secs(600);

/// Lists what is here and what is missing; fails when anything is.
pub(crate) fn check(forced: Option<Way>) -> Result<()> {
    let facts = probe::facts();
    println!("{}", probe::describe(&facts));
    let needs = missing(&facts, forced);
    if !has_c_compiler() {
        println!("  {C_COMPILER}: missing; only `capi` and `test` need it");
    }
    if needs.is_empty() {
        println!("nothing is missing");
        return Ok(());
    }
    list(&needs);
    bail!(
        "{} missing; `cargo xtask setup` brings what it can",
        count(&needs)
    );
}

/// Brings what is missing and says which toolchain does what. A second run finds everything and changes nothing.
pub(crate) fn run(forced: Option<Way>) -> Result<Tools> {
    let start = Instant::now();
    let mut facts = probe::facts();
    println!("set-up: this machine has\n{}", probe::describe(&facts));
    let mut held = None;
    loop {
        match plan(&facts, forced) {
            Plan::Ready(tools) => {
                let board = match tools.board {
                    Toolchain::Host => "cargo".to_owned(),
                    Toolchain::Linked => format!("cargo +{}", linked_name()),
                };
                let seconds = start.elapsed().as_secs_f64();
                println!("set-up: ready in {seconds:.1} s; the board is built by `{board}`");
                return Ok(tools);
            }
            Plan::Stuck(needs) => {
                list(&needs);
                bail!(
                    "{} missing and set-up cannot bring it by itself: install what is listed above",
                    count(&needs)
                );
            }
            // Somebody else may have done the step while this run waited for the lock: look again first.
            Plan::Do(_) if held.is_none() => {
                held = Some(lock()?);
                facts = probe::facts();
            }
            Plan::Do(step) => {
                let tried = perform(&step, forced);
                if let Err(error) = tried {
                    println!("set-up: {error:#}");
                }
                facts = after(&step, &facts);
            }
        }
    }
}

/// The compiler of the example in C.
pub(crate) const C_COMPILER: &str = "arm-none-eabi-gcc";

/// Brings the compiler for C, which only the library for C needs.
pub(crate) fn bring_c_compiler() -> Result<()> {
    if has_c_compiler() {
        return Ok(());
    }
    let held = lock()?;
    timed("installing the compiler for C (about 60 MB)", || {
        debian::refresh()?;
        debian::install_packages(&["gcc-arm-none-eabi"])
    })?;
    drop(held);
    if !has_c_compiler() {
        bail!("{C_COMPILER} is missing: install the package gcc-arm-none-eabi");
    }
    Ok(())
}

fn has_c_compiler() -> bool {
    capture(command(C_COMPILER).arg("--version")).is_some()
}

/// The facts after a step, with its means used up.
fn after(step: &Step, before: &Facts) -> Facts {
    let mut facts = Facts {
        rustup: before.rustup,
        apt: before.apt,
        unpack: before.unpack,
        build: before.build,
        ..probe::facts()
    };
    match step {
        Step::Rustup(_) => facts.rustup = Means::Tried,
        Step::Apt { .. } => facts.apt = Means::Tried,
        Step::Unpack => facts.unpack = Means::Tried,
        Step::Build => facts.build = Means::Tried,
    }
    facts
}

/// Brings a C++ compiler, which only fuzzing needs.
pub(crate) fn install_compiler() -> Result<()> {
    timed("installing a C++ compiler", || {
        debian::refresh()?;
        debian::install_packages(&["g++"])
    })
}

fn perform(step: &Step, forced: Option<Way>) -> Result<()> {
    match step {
        Step::Rustup(needs) => {
            let limit = if forced == Some(Way::Rustup) {
                RUSTUP_LIMIT_FORCED
            } else {
                RUSTUP_LIMIT
            };
            needs.iter().try_for_each(|need| {
                let words: &[&str] = match need {
                    Need::Target => &["target", "add", TARGET],
                    Need::Clippy => &["component", "add", "clippy"],
                    Need::Rustfmt => &["component", "add", "rustfmt"],
                    Need::Emulator => return Ok(()),
                };
                let what = format!("rustup {} (at most {} s)", words.join(" "), limit.as_secs());
                timed(&what, || run_bounded(command("rustup").args(words), limit))
            })
        }
        Step::Apt { emulator, rust } => {
            let what = match (emulator, rust) {
                (true, true) => "installing the emulator and Debian's Rust (about 150 MB)",
                (true, false) => "installing the emulator",
                _ => "installing Debian's Rust (about 120 MB)",
            };
            timed(what, || debian::install(*emulator, *rust))
        }
        Step::Unpack => timed(
            "unpacking the emulator beside what is installed (about 80 MB)",
            || unpacked::emulator(&home()?),
        ),
        Step::Build => timed(
            "building core for the board from Debian's sources (about half a minute)",
            || debian::build_toolchain(&home()?),
        ),
    }
}

/// Where built toolchains live: outside the workspace, so that neither `cargo clean` nor a second clone breaks them.
fn home() -> Result<PathBuf> {
    let base = match env::var_os("XDG_DATA_HOME").map(PathBuf::from) {
        Some(path) if path.is_absolute() => path,
        _ => env::home_dir()
            .context("there is no home directory to keep the toolchain in")?
            .join(".local/share"),
    };
    let home = base.join("foretorque");
    fs::create_dir_all(&home).with_context(|| format!("cannot write {}", home.display()))?;
    Ok(home)
}

/// One set-up at a time; the lock falls when the file is closed, however this process ends.
fn lock() -> Result<File> {
    let path = home()?.join("setup.lock");
    let file = File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            println!("set-up: another set-up is at work; waiting for it");
            file.lock()?;
        }
        Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {}
        Err(TryLockError::Error(error)) => return Err(error).context("cannot lock the set-up"),
    }
    Ok(file)
}

fn list(needs: &[Need]) {
    println!("missing:");
    for need in needs {
        println!("  - {need}");
    }
}

fn count(needs: &[Need]) -> String {
    if needs.len() == 1 {
        "one thing is".into()
    } else {
        format!("{} things are", needs.len())
    }
}
