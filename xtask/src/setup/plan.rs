//! What to do next, as a pure function of what the machine looks like.

use std::fmt;
use std::str::FromStr;

use super::facts::{Facts, Kit, Means};
use crate::toolchain::{TARGET, Toolchain, Tools};

/// A way to a toolchain that builds for the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// One that is here already.
    Installed,
    /// `rustup target add`.
    Rustup,
    /// Built from Debian's packages and linked.
    Debian,
}

impl FromStr for Way {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "installed" => Ok(Way::Installed),
            "rustup" => Ok(Way::Rustup),
            "debian" => Ok(Way::Debian),
            other => Err(format!(
                "unknown way `{other}`: it is one of installed, rustup or debian"
            )),
        }
    }
}

/// Something that is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Need {
    Target,
    Clippy,
    Rustfmt,
    Emulator,
}

impl fmt::Display for Need {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Need::Target => write!(
                f,
                "the Rust target {TARGET} (`rustup target add {TARGET}`; where rustup cannot reach its server, \
                 the packages rustc-web rust-web-src rust-web-clippy rustfmt-web of Debian's security archive)"
            ),
            Need::Clippy => write!(f, "clippy (`rustup component add clippy`)"),
            Need::Rustfmt => write!(f, "rustfmt (`rustup component add rustfmt`)"),
            Need::Emulator => write!(
                f,
                "qemu-system-arm with the machine netduinoplus2 (the package qemu-system-arm or qemu-arm)"
            ),
        }
    }
}

/// One change to the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Ask rustup for what the host toolchain lacks.
    Rustup(Vec<Need>),
    /// Install packages.
    Apt { emulator: bool, rust: bool },
    /// Unpack the emulator's packages where they cannot be installed.
    Unpack,
    /// Build the board's core from Debian's sources and link the result as a toolchain.
    Build,
}

/// The next thing to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Plan {
    /// Everything is here.
    Ready(Tools),
    /// Do this, look again, plan again.
    Do(Step),
    /// Nothing left to try.
    Stuck(Vec<Need>),
}

/// The next thing to do on a machine with these facts, by the forced way or by the first that works.
///
/// The caller marks the means of a step as tried, so that planning and doing in turn ends after four steps at most.
pub(crate) fn plan(facts: &Facts, forced: Option<Way>) -> Plan {
    let roles = roles(facts, forced);
    let needs = roles.needs();
    let may_rustup = matches!(forced, None | Some(Way::Rustup));
    let may_debian = matches!(forced, None | Some(Way::Debian));

    if !needs.is_empty() && may_rustup && facts.rustup == Means::Ready {
        return Plan::Do(Step::Rustup(lacks(&facts.host)));
    }
    let wants_debian = !needs.is_empty() && may_debian && facts.build == Means::Ready;
    let lacks_packages = wants_debian && !facts.debian_rust;
    // One call for both: apt reads its lists once.
    if (!facts.emulator || lacks_packages) && facts.apt == Means::Ready {
        return Plan::Do(Step::Apt {
            emulator: !facts.emulator,
            rust: lacks_packages,
        });
    }
    if !facts.emulator && facts.unpack == Means::Ready {
        return Plan::Do(Step::Unpack);
    }
    if wants_debian && facts.debian_rust {
        return Plan::Do(Step::Build);
    }
    match roles.tools() {
        Some(tools) if facts.emulator => Plan::Ready(tools),
        _ => Plan::Stuck(missing(facts, forced)),
    }
}

/// Everything that is missing, in the order it is reported.
pub(crate) fn missing(facts: &Facts, forced: Option<Way>) -> Vec<Need> {
    let mut needs = roles(facts, forced).needs();
    if !facts.emulator {
        needs.push(Need::Emulator);
    }
    needs
}

/// What a toolchain would have to be given to do everything.
fn lacks(kit: &Kit) -> Vec<Need> {
    [
        (kit.target, Need::Target),
        (kit.clippy, Need::Clippy),
        (kit.rustfmt, Need::Rustfmt),
    ]
    .into_iter()
    .filter_map(|(has, need)| (!has).then_some(need))
    .collect()
}

/// `Tools` with the gaps still open.
struct Roles {
    board: Option<Toolchain>,
    board_clippy: Option<Toolchain>,
    clippy: Option<Toolchain>,
    fmt: Option<Toolchain>,
}

/// Casts each role with the first toolchain that can do it and that the forced way allows.
fn roles(facts: &Facts, forced: Option<Way>) -> Roles {
    let linked = if forced == Some(Way::Rustup) {
        Kit::default()
    } else {
        facts.linked
    };
    let board_host = if forced == Some(Way::Debian) {
        Kit::default()
    } else {
        facts.host
    };
    let first = |host: &Kit, can: fn(&Kit) -> bool| match (can(host), can(&linked)) {
        (true, _) => Some(Toolchain::Host),
        (false, true) => Some(Toolchain::Linked),
        (false, false) => None,
    };
    Roles {
        board: first(&board_host, |kit| kit.target),
        board_clippy: first(&board_host, |kit| kit.target && kit.clippy),
        // The forced way is about the board: for its own code the host's tools come first all the same.
        clippy: first(&facts.host, |kit| kit.clippy),
        fmt: first(&facts.host, |kit| kit.rustfmt),
    }
}

impl Roles {
    fn tools(&self) -> Option<Tools> {
        Some(Tools {
            board: self.board?,
            board_clippy: self.board_clippy?,
            clippy: self.clippy?,
            fmt: self.fmt?,
        })
    }

    fn needs(&self) -> Vec<Need> {
        // Without a target there is nothing to lint for the board: only the target is reported then.
        let unlinted_board = self.board.is_some() && self.board_clippy.is_none();
        lacks(&Kit {
            target: self.board.is_some(),
            clippy: self.clippy.is_some() && !unlinted_board,
            rustfmt: self.fmt.is_some(),
        })
    }
}

#[cfg(test)]
mod tests;
