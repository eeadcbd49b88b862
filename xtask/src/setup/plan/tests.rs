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
    unpack: Means::Ready,
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
    use Step::{Apt, Build, Rustup, Unpack};
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
                unpack: Absent,
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
            "packages came but not the emulator: unpack it",
            Facts {
                host: ALL,
                apt: Tried,
                ..FRESH
            },
            None,
            Plan::Do(Unpack),
        ),
        (
            "no root: unpack the emulator",
            Facts {
                host: ALL,
                apt: Absent,
                ..FRESH
            },
            None,
            Plan::Do(Unpack),
        ),
        (
            "no emulator in any way",
            Facts {
                host: ALL,
                apt: Tried,
                unpack: Tried,
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
        for _ in 0..5 {
            match plan(&facts, forced) {
                Plan::Do(Step::Rustup(_)) => facts.rustup = Means::Tried,
                Plan::Do(Step::Apt { .. }) => facts.apt = Means::Tried,
                Plan::Do(Step::Unpack) => facts.unpack = Means::Tried,
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
