//! Compilation of the board's code: cargo, target, profile, packages.

use std::path::PathBuf;
use std::process::Command;
use std::{env, fmt};

use crate::shell::{command, root};

/// The board's Rust target: Cortex-M4 with its single-precision FPU.
pub(crate) const TARGET: &str = "thumbv7em-none-eabihf";

/// The board's cargo profile.
pub(crate) const PROFILE: &str = "firmware";

/// Name under which set-up links the toolchain it builds. The variable lets a trial run keep clear of the real one.
pub(crate) fn linked_name() -> String {
    env::var("FORETORQUE_TOOLCHAIN_NAME").unwrap_or_else(|_| "foretorque-arm".into())
}

/// The linked ELF of a binary of the board.
pub(crate) fn elf(binary: &str) -> PathBuf {
    elves().join(binary)
}

/// Directory of the linked ELF files of the board.
pub(crate) fn elves() -> PathBuf {
    let target = root().join("target");
    target.join(TARGET).join(PROFILE)
}

/// A Rust toolchain that set-up found or made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Toolchain {
    /// The one `cargo xtask` itself runs in.
    Host,
    /// The one set-up built from Debian's packages.
    Linked,
}

/// The cargo command as one types it.
impl fmt::Display for Toolchain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Toolchain::Host => write!(f, "cargo"),
            Toolchain::Linked => write!(f, "cargo +{}", linked_name()),
        }
    }
}

impl Toolchain {
    /// One of its programs, run in the workspace's root.
    pub(crate) fn tool(self, program: &str) -> Command {
        match self {
            Toolchain::Host => command(program),
            Toolchain::Linked => {
                let mut command = command("rustup");
                command.args(["run", &linked_name(), program]);
                command
            }
        }
    }

    /// `cargo SUBCOMMAND` for the board and every image, in target and profile of the board.
    pub(crate) fn board_cargo(self, subcommand: &str) -> Command {
        let mut command = self.tool("cargo");
        command.args([subcommand, "--profile", PROFILE, "--target", TARGET]);
        command.args(["-p", "foretorque-f405", "-p", "foretorque-images"]);
        command
    }
}

/// Which toolchain does what in this workspace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tools {
    /// Compiles, links and lints for the board.
    pub(crate) board: Toolchain,
    /// Lints the host's code and formats everything.
    pub(crate) host: Toolchain,
}
