//! What to do next, as a pure function of what the machine looks like.

use std::fmt;
use std::str::FromStr;

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

/// What a toolchain can do; all false when it is absent or broken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Kit {
    /// Compiles and links a small program for the board.
    pub(crate) target: bool,
    /// Has clippy.
    pub(crate) clippy: bool,
    /// Has rustfmt.
    pub(crate) rustfmt: bool,
}

/// Whether a means of getting things can still be tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Means {
    /// Not on this machine, or not allowed.
    Absent,
    /// Here and untried.
    Ready,
    /// Tried in this run; once is enough.
    Tried,
}

/// What the machine looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Facts {
    pub(crate) host: Kit,
    pub(crate) linked: Kit,
    /// `qemu-system-arm` knows the board's machine.
    pub(crate) emulator: bool,
    /// Debian's compiler, its sources, clippy and rustfmt are installed and new enough.
    pub(crate) debian_rust: bool,
    pub(crate) rustup: Means,
    pub(crate) apt: Means,
    /// Building and linking a toolchain from Debian's packages; needs rustup to link it.
    pub(crate) build: Means,
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
/// The caller marks the means of a step as tried, so that planning and doing in turn ends after three steps at most.
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
mod tests {
    use super::*;

    const ALL: Kit = Kit {
        target: true,
        clippy: true,
        rustfmt: true,
    };
    const NO_TARGET: Kit = Kit {
        target: false,
        clippy: true,
        rustfmt: true,
    };
    const NONE: Kit = Kit {
        target: false,
        clippy: false,
        rustfmt: false,
    };

    /// rustup's stable on Debian, and nothing else.
    const FRESH: Facts = Facts {
        host: NO_TARGET,
        linked: NONE,
        emulator: false,
        debian_rust: false,
        rustup: Means::Ready,
        apt: Means::Ready,
        build: Means::Ready,
    };

    fn ready(board: Toolchain, clippy: Toolchain) -> Plan {
        Plan::Ready(Tools {
            board,
            board_clippy: board,
            clippy,
            fmt: clippy,
        })
    }

    #[test]
    fn the_next_step_follows_from_the_facts() {
        use Means::{Absent, Tried};
        use Step::{Apt, Build, Rustup};
        use Toolchain::{Host, Linked};
        let target = || Plan::Do(Rustup(vec![Need::Target]));
        let cases: &[(&str, Facts, Option<Way>, Plan)] = &[
            ("fresh machine asks rustup first", FRESH, None, target()),
            (
                "rustup refused: packages for both at once",
                Facts {
                    rustup: Tried,
                    ..FRESH
                },
                None,
                Plan::Do(Apt {
                    emulator: true,
                    rust: true,
                }),
            ),
            (
                "rustup worked: only the emulator is left",
                Facts {
                    host: ALL,
                    rustup: Tried,
                    ..FRESH
                },
                None,
                Plan::Do(Apt {
                    emulator: true,
                    rust: false,
                }),
            ),
            (
                "packages are here: build",
                Facts {
                    emulator: true,
                    debian_rust: true,
                    rustup: Tried,
                    apt: Tried,
                    ..FRESH
                },
                None,
                Plan::Do(Build),
            ),
            (
                "built and linked",
                Facts {
                    linked: ALL,
                    emulator: true,
                    rustup: Tried,
                    build: Tried,
                    ..FRESH
                },
                None,
                ready(Linked, Host),
            ),
            (
                "linked earlier: rustup is not asked again",
                Facts {
                    linked: ALL,
                    emulator: true,
                    ..FRESH
                },
                None,
                ready(Linked, Host),
            ),
            (
                "host before linked",
                Facts {
                    host: ALL,
                    linked: ALL,
                    emulator: true,
                    ..FRESH
                },
                None,
                ready(Host, Host),
            ),
            (
                "a minimal host also lacks clippy and rustfmt",
                Facts {
                    host: NONE,
                    ..FRESH
                },
                None,
                Plan::Do(Rustup(vec![Need::Target, Need::Clippy, Need::Rustfmt])),
            ),
            (
                "what a minimal host lacks comes from the linked one",
                Facts {
                    host: NONE,
                    linked: ALL,
                    emulator: true,
                    rustup: Tried,
                    ..FRESH
                },
                None,
                ready(Linked, Linked),
            ),
            (
                "a linked toolchain that cannot lint is built again",
                Facts {
                    linked: Kit {
                        target: true,
                        ..NONE
                    },
                    emulator: true,
                    debian_rust: true,
                    rustup: Tried,
                    ..FRESH
                },
                None,
                Plan::Do(Build),
            ),
            (
                "the build failed: say what is missing",
                Facts {
                    emulator: true,
                    debian_rust: true,
                    rustup: Tried,
                    build: Tried,
                    ..FRESH
                },
                None,
                Plan::Stuck(vec![Need::Target]),
            ),
            (
                "unknown system: list everything",
                Facts {
                    rustup: Absent,
                    apt: Absent,
                    build: Absent,
                    host: NONE,
                    ..FRESH
                },
                None,
                Plan::Stuck(vec![
                    Need::Target,
                    Need::Clippy,
                    Need::Rustfmt,
                    Need::Emulator,
                ]),
            ),
            (
                "packages came but not the emulator",
                Facts {
                    host: ALL,
                    apt: Tried,
                    ..FRESH
                },
                None,
                Plan::Stuck(vec![Need::Emulator]),
            ),
            (
                "forced on to installed: nothing is fetched for the toolchain",
                Facts {
                    emulator: true,
                    ..FRESH
                },
                Some(Way::Installed),
                Plan::Stuck(vec![Need::Target]),
            ),
            (
                "forced on to rustup: a linked toolchain does not count",
                Facts {
                    linked: ALL,
                    emulator: true,
                    ..FRESH
                },
                Some(Way::Rustup),
                target(),
            ),
            (
                "forced on to rustup and refused: no other way",
                Facts {
                    emulator: true,
                    debian_rust: true,
                    rustup: Tried,
                    ..FRESH
                },
                Some(Way::Rustup),
                Plan::Stuck(vec![Need::Target]),
            ),
            (
                "forced on to debian: the host's target does not count",
                Facts {
                    host: ALL,
                    emulator: true,
                    debian_rust: true,
                    ..FRESH
                },
                Some(Way::Debian),
                Plan::Do(Build),
            ),
            (
                "forced on to debian: linked for the board, host for itself",
                Facts {
                    host: ALL,
                    linked: ALL,
                    emulator: true,
                    ..FRESH
                },
                Some(Way::Debian),
                ready(Linked, Host),
            ),
        ];
        for (name, facts, forced, expected) in cases {
            assert_eq!(plan(facts, *forced), *expected, "{name}");
        }
    }

    #[test]
    fn planning_ends_on_a_machine_where_nothing_works() {
        for forced in [
            None,
            Some(Way::Installed),
            Some(Way::Rustup),
            Some(Way::Debian),
        ] {
            let mut facts = Facts {
                debian_rust: true,
                ..FRESH
            };
            for _ in 0..4 {
                match plan(&facts, forced) {
                    Plan::Do(Step::Rustup(_)) => facts.rustup = Means::Tried,
                    Plan::Do(Step::Apt { .. }) => facts.apt = Means::Tried,
                    Plan::Do(Step::Build) => facts.build = Means::Tried,
                    Plan::Stuck(needs) => {
                        assert_eq!(needs, [Need::Target, Need::Emulator]);
                        break;
                    }
                    Plan::Ready(_) => panic!("nothing worked, yet {forced:?} is ready"),
                }
            }
            assert!(
                matches!(plan(&facts, forced), Plan::Stuck(_)),
                "{forced:?} goes round in circles"
            );
        }
    }
}
