//! Brings what building and running need: the board's Rust target, clippy, rustfmt and the emulator.
//!
//! rustup comes first; on Debian and its relatives `debian.sh` brings the rest.

use std::fs::{self, File};
use std::path::PathBuf;
use std::time::Instant;
use std::{env, fmt, process};

use anyhow::{Context as _, Result, anyhow, bail};

use crate::shell::{
    self, LINKED_NAME, TARGET, Toolchain, Tools, capture, command, run_bounded, timed,
};

/// Bound on rustup if other ways are left, and if it is the only one.
pub(crate) const RUSTUP_LIMIT_S: u32 = 60;
const RUSTUP_LIMIT_FORCED_S: u32 = 600;

/// A way to a toolchain that builds for the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// One that is installed already.
    Installed,
    /// `rustup target add`.
    Rustup,
    /// Built from Debian's packages and linked.
    Debian,
}

impl std::str::FromStr for Way {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "installed" => Ok(Way::Installed),
            "rustup" => Ok(Way::Rustup),
            "debian" => Ok(Way::Debian),
            other => Err(format!(
                "unknown way `{other}`: choose installed, rustup or debian"
            )),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    Target,
    Lints,
    Emulator,
}

impl fmt::Display for Need {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Need::Target => {
                "the Rust target thumbv7em-none-eabihf (`rustup target add thumbv7em-none-eabihf`; where rustup cannot \
                 reach its server, the packages rustc-web rust-web-src rust-web-clippy rustfmt-web of Debian's \
                 security archive)"
            }
            Need::Lints => "clippy and rustfmt (`rustup component add clippy rustfmt`)",
            Need::Emulator => {
                "qemu-system-arm with the machine netduinoplus2 (the package qemu-system-arm or qemu-arm)"
            }
        })
    }
}

/// Everything set-up depends on.
#[derive(Clone, Debug)]
struct Machine {
    /// rustup's toolchain compiles and links a small program for the board.
    host_target: bool,
    /// rustup's toolchain has clippy and rustfmt.
    host_lints: bool,
    /// The linked toolchain has all three.
    linked: bool,
    /// Version of `qemu-system-arm`, if it has the board's machine.
    emulator: Option<String>,
}

impl Machine {
    /// Looks without changing anything.
    fn look() -> Self {
        Self {
            host_target: builds_for_board(Toolchain::Host),
            host_lints: lints(Toolchain::Host),
            linked: builds_for_board(Toolchain::Linked) && lints(Toolchain::Linked),
            emulator: emulator(),
        }
    }

    /// The toolchain of each role, or all that is missing. The forced way is about the board alone.
    fn tools(&self, forced: Option<Way>) -> Result<Tools, Vec<Need>> {
        let linked = self.linked && forced != Some(Way::Rustup);
        let target = self.host_target && forced != Some(Way::Debian);
        let first = |host: bool| match (host, linked) {
            (true, _) => Some(Toolchain::Host),
            (false, true) => Some(Toolchain::Linked),
            (false, false) => None,
        };
        let (board, host) = (first(target && self.host_lints), first(self.host_lints));
        match (board, host, &self.emulator) {
            (Some(board), Some(host), Some(_)) => Ok(Tools { board, host }),
            _ => Err([
                (target || board.is_some(), Need::Target),
                (host.is_some(), Need::Lints),
                (self.emulator.is_some(), Need::Emulator),
            ]
            .into_iter()
            .filter_map(|(here, need)| (!here).then_some(need))
            .collect()),
        }
    }

    /// Everything looked at, and what is missing, if anything is.
    fn print(&self, needs: &[Need]) {
        let found = |here| if here { "found" } else { "missing" };
        let version = |toolchain: Toolchain| {
            let line = capture(&mut toolchain.tool("rustc --version"));
            line.map_or("no rustc".into(), |line| line.trim().to_owned())
        };
        println!(
            "  host: {}: board target {}, clippy and rustfmt {}\n  {}: {}: {}\n  emulator: {}",
            version(Toolchain::Host),
            found(self.host_target),
            found(self.host_lints),
            LINKED_NAME,
            version(Toolchain::Linked),
            found(self.linked),
            self.emulator.as_deref().unwrap_or("missing"),
        );
        if !needs.is_empty() {
            println!("missing:");
        }
        for need in needs {
            println!("  - {need}");
        }
    }
}

fn lints(toolchain: Toolchain) -> bool {
    ["cargo clippy --version", "cargo fmt --version"]
        .into_iter()
        .all(|line| capture(&mut toolchain.tool(line)).is_some())
}

fn emulator() -> Option<String> {
    let machines = capture(&mut command("qemu-system-arm -machine help"))?;
    let mut names = machines.lines();
    names.find(|line| line.starts_with("netduinoplus2 "))?;
    let version = capture(&mut command("qemu-system-arm --version"))?;
    version.lines().next().map(str::to_owned)
}

/// Whether a toolchain compiles and links a small whole-program-optimised program for the board.
///
/// The library's file alone proves little: it may belong to another compiler, lack the bitcode of link-time
/// optimisation, or find no linker. The trial takes a fifth of a second.
fn builds_for_board(toolchain: Toolchain) -> bool {
    let place = env::temp_dir().join(format!("foretorque-smoke-{}", process::id()));
    let mut rustc = toolchain.tool(&format!(
        "rustc --edition=2024 --target {TARGET} -Cpanic=abort -Copt-level=1 -Clto=fat -Ccodegen-units=1 \
         xtask/smoke.rs --out-dir"
    ));
    let built = capture(rustc.arg(&place)).is_some();
    let _ = fs::remove_dir_all(&place);
    built
}

/// Lists what is installed and what is missing; fails if anything is missing.
pub(crate) fn check(forced: Option<Way>) -> Result<()> {
    let machine = Machine::look();
    let needs = machine.tools(forced).err().unwrap_or_default();
    machine.print(&needs);
    let compiler = "arm-none-eabi-gcc";
    if !has(compiler) {
        println!("  {compiler}: missing; only `capi` and `test` need it");
    }
    match needs.len() {
        0 => println!("nothing is missing"),
        1 => bail!("one thing is missing; `cargo xtask setup` brings it if it can"),
        count => bail!("{count} things are missing; `cargo xtask setup` brings what it can"),
    }
    Ok(())
}

/// Brings what is missing and returns which toolchain does what. A second run changes nothing.
pub(crate) fn run(forced: Option<Way>) -> Result<Tools> {
    let start = Instant::now();
    let machine = Machine::look();
    println!("set-up: this machine has");
    machine.print(&[]);
    let tools = machine.tools(forced).or_else(|_| bring(forced))?;
    let seconds = start.elapsed().as_secs_f64();
    let board = tools.board;
    println!("set-up: ready in {seconds:.1} s; the board is built by `{board}`");
    Ok(tools)
}

/// Takes one step after the other until nothing is missing.
fn bring(forced: Option<Way>) -> Result<Tools> {
    let _lock = lock()?;
    for step in [ask_rustup, install_emulator, build_toolchain] {
        // Another set-up may have finished while this one waited for the lock.
        let Err(needs) = Machine::look().tools(forced) else {
            break;
        };
        if let Err(error) = step(&needs, forced) {
            println!("set-up: {error:#}");
        }
    }
    let machine = Machine::look();
    machine.tools(forced).map_err(|needs| {
        machine.print(&needs);
        anyhow!("set-up could not bring everything: install what is listed above")
    })
}

/// Adds the target and the components by rustup, bounded in time.
fn ask_rustup(needs: &[Need], forced: Option<Way>) -> Result<()> {
    let limit = match forced {
        Some(Way::Rustup) => RUSTUP_LIMIT_FORCED_S,
        None => RUSTUP_LIMIT_S,
        Some(_) => return Ok(()),
    };
    for need in needs {
        let line = match need {
            Need::Target => format!("rustup target add {TARGET}"),
            Need::Lints => "rustup component add clippy rustfmt".to_owned(),
            Need::Emulator => continue,
        };
        let task = format!("{line} (at most {limit} s)");
        timed(&task, || run_bounded(&line, limit))?;
    }
    Ok(())
}

fn install_emulator(needs: &[Need], _: Option<Way>) -> Result<()> {
    if !needs.contains(&Need::Emulator) {
        return Ok(());
    }
    timed("installing the emulator (about 80 MB)", || {
        debian("emulator", &[&home()?.to_string_lossy()])
    })
}

/// Builds the board's core from Debian's packaged sources and links the result as a toolchain.
fn build_toolchain(needs: &[Need], forced: Option<Way>) -> Result<()> {
    if needs == [Need::Emulator] || !matches!(forced, None | Some(Way::Debian)) {
        return Ok(());
    }
    timed(
        "building core for the board by Debian's Rust (about 120 MB)",
        || {
            let (home, oldest) = (home()?, env!("CARGO_PKG_RUST_VERSION"));
            let home = home.to_string_lossy();
            debian("toolchain", &[&home, LINKED_NAME, TARGET, oldest])
        },
    )
}

/// Installs a package for its program, unless the program is here.
pub(crate) fn bring_program(program: &str, package: &str) -> Result<()> {
    if !has(program) {
        let _lock = lock()?;
        timed(&format!("installing {package}"), || {
            debian("packages", &[package])
        })?;
    }
    if !has(program) {
        bail!("{program} is missing: install the package {package}");
    }
    Ok(())
}

fn has(program: &str) -> bool {
    capture(&mut command(&format!("{program} --version"))).is_some()
}

/// Runs one task of `debian.sh`.
fn debian(task: &str, arguments: &[&str]) -> Result<()> {
    if !has("apt-get") {
        bail!("there is no apt-get here");
    }
    shell::run(command("xtask/debian.sh").arg(task).args(arguments))
}

/// Directory of built toolchains: outside the workspace, so that neither `cargo clean` nor a second clone breaks them.
fn home() -> Result<PathBuf> {
    let base = match env::var_os("XDG_DATA_HOME").map(PathBuf::from) {
        Some(path) if path.is_absolute() => path,
        _ => env::home_dir()
            .context("there is no home directory for the toolchain")?
            .join(".local/share"),
    };
    let home = base.join("foretorque");
    fs::create_dir_all(&home).with_context(|| format!("cannot write {}", home.display()))?;
    Ok(home)
}

/// One set-up at a time; closing the file releases the lock, however this process ends.
fn lock() -> Result<File> {
    let path = home()?.join("setup.lock");
    let file = File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
    if file.try_lock().is_err() {
        println!("set-up: another set-up is running; waiting for it");
        // A file system without locks is no reason to stop.
        let _ = file.lock();
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_go_to_the_first_toolchain_that_is_allowed_and_able() {
        use Need::{Emulator, Lints, Target};
        use Toolchain::{Host, Linked};
        type Expected = Result<[Toolchain; 2], &'static [Need]>;
        // Target, clippy and rustfmt of the host; the linked toolchain.
        let cases: [([bool; 3], Option<Way>, Expected); 11] = [
            ([false, true, false], None, Err(&[Target])),
            ([false, false, false], None, Err(&[Target, Lints])),
            ([true, false, false], None, Err(&[Lints])),
            ([true, true, true], None, Ok([Host, Host])),
            ([false, true, true], None, Ok([Linked, Host])),
            ([true, false, true], None, Ok([Linked, Linked])),
            ([false, true, false], Some(Way::Installed), Err(&[Target])),
            ([false, true, true], Some(Way::Rustup), Err(&[Target])),
            ([true, true, true], Some(Way::Rustup), Ok([Host, Host])),
            ([true, true, false], Some(Way::Debian), Err(&[Target])),
            ([true, true, true], Some(Way::Debian), Ok([Linked, Host])),
        ];
        for ([host_target, host_lints, linked], forced, expected) in cases {
            let mut machine = Machine {
                host_target,
                host_lints,
                linked,
                emulator: Some("QEMU".to_owned()),
            };
            let tools = machine.tools(forced).map(|tools| [tools.board, tools.host]);
            let expected = expected.map_err(<[Need]>::to_vec);
            assert_eq!(tools, expected, "{machine:?} {forced:?}");
            machine.emulator = None;
            let needs = [expected.err().unwrap_or_default(), vec![Emulator]].concat();
            assert_eq!(machine.tools(forced).unwrap_err(), needs);
        }
    }
}
