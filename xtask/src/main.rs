//! Set-up, demo, bench and test of foretorque in one command each.

mod bench;
mod capi;
mod demo;
mod faults;
mod flash;
mod fuzz;
mod outside;
mod setup;
mod shell;
mod test;
mod toolchain;

use std::num::NonZeroU64;
use std::process::ExitCode;

use anyhow::Result;
use lexopt::prelude::*;

use flash::Board;
use setup::Way;

const HELP: &str = "\
Set-up, demo, bench and test of foretorque in one command each.

Usage: cargo xtask <COMMAND> [OPTIONS]

Commands:
  setup   Bring what the other commands need: the board's Rust target, the emulator, clippy, rustfmt, a compiler for C
  demo    Set up, build, run the main job in the emulator and write target/foretorque/demo/report.html
  bench   Set up, measure what the firmware costs, compare with docs/budget.md, write target/foretorque/bench.json
  faults  Set up, break everything that can break on every board, and write target/foretorque/faults.json
  fuzz    Set up, fuzz decoder, bank loader, session and store, and write target/foretorque/fuzz.json
  flash   Set up, build, write .bin and .hex into target/foretorque/flash, and flash the ELF by probe-rs
  capi    Set up, build the static library for C and its example
  test    Set up, pass every gate (format, lints, builds, tests, docs) and end with counts

Options:
      --toolchain <WAY>  How the board's toolchain is had; without it the first of these that works:
                           installed  a toolchain already here that builds for the board
                           rustup     `rustup target add`, bounded in time
                           debian     Debian's rustc and sources: core is built once and linked as a toolchain
      --check            setup only: change nothing, list what is here and what is missing, fail if anything is
      --board <BOARD>    flash only: odrive (without it), pyboard or drive
      --image            flash only: write the images, flash nothing
      --accept           bench: write docs/budget.md anew; limits may go down, never up
                         faults: write the counts into docs/reliability.md instead of comparing them
      --runs <N>         fuzz only: executions in all (100000000)
  -h, --help             Print this help

The debian way leaves a rustup toolchain named foretorque-arm that points into one directory,
$XDG_DATA_HOME/foretorque (~/.local/share/foretorque). Where the emulator cannot be installed as a package, it is unpacked
into that directory, and a script qemu-system-arm beside cargo starts it. To remove all of it: `rustup toolchain uninstall
foretorque-arm`, then delete the directory and the script.
";

/// What the command line asks for.
#[derive(Debug, PartialEq)]
enum Request {
    Help,
    Setup {
        forced: Option<Way>,
        check: bool,
    },
    Demo {
        forced: Option<Way>,
    },
    Test {
        forced: Option<Way>,
    },
    Bench {
        forced: Option<Way>,
        accept: bool,
    },
    Capi {
        forced: Option<Way>,
    },
    Flash {
        forced: Option<Way>,
        board: Board,
        image: bool,
    },
    Faults {
        forced: Option<Way>,
        accept: bool,
    },
    Fuzz {
        forced: Option<Way>,
        runs: u64,
    },
}

/// Reads the command line; the error is one line fit for the user.
fn parse(mut args: lexopt::Parser) -> Result<Request, lexopt::Error> {
    let (mut command, mut forced) = (None, None);
    let (mut check, mut accept, mut image) = (false, false, false);
    let mut board = None;
    let mut runs = None;
    while let Some(arg) = args.next()? {
        match arg {
            Short('h') | Long("help") => return Ok(Request::Help),
            Long("toolchain") => forced = Some(args.value()?.parse::<Way>()?),
            Long("check") => check = true,
            Long("accept") => accept = true,
            Long("runs") => {
                let number = args.value()?.parse::<NonZeroU64>();
                runs = Some(number.map_err(|error| format!("--runs: {error}"))?.get());
            }
            Long("image") => image = true,
            Long("board") => board = Some(args.value()?.parse::<Board>()?),
            Value(name) if command.is_none() => command = Some(name.string()?),
            other => return Err(other.unexpected()),
        }
    }
    let request = match command.as_deref() {
        None | Some("help") => Request::Help,
        Some("setup") => Request::Setup { forced, check },
        Some("demo") => Request::Demo { forced },
        Some("bench") => Request::Bench { forced, accept },
        Some("faults") => Request::Faults { forced, accept },
        Some("fuzz") => Request::Fuzz {
            forced,
            runs: runs.unwrap_or(fuzz::RUNS),
        },
        Some("test") => Request::Test { forced },
        Some("capi") => Request::Capi { forced },
        Some("flash") => Request::Flash {
            forced,
            board: board.unwrap_or(Board::Odrive),
            image,
        },
        Some(other) => return Err(format!("there is no command `{other}`").into()),
    };
    if check && !matches!(request, Request::Setup { .. }) {
        return Err("--check belongs to `cargo xtask setup`".into());
    }
    if (image || board.is_some()) && !matches!(request, Request::Flash { .. }) {
        return Err("--image and --board belong to `cargo xtask flash`".into());
    }
    if accept && !matches!(request, Request::Bench { .. } | Request::Faults { .. }) {
        return Err("--accept belongs to `cargo xtask bench` and `cargo xtask faults`".into());
    }
    if runs.is_some() && !matches!(request, Request::Fuzz { .. }) {
        return Err("--runs belongs to `cargo xtask fuzz`".into());
    }
    Ok(request)
}

fn main() -> ExitCode {
    let request = match parse(lexopt::Parser::from_env()) {
        Ok(request) => request,
        Err(error) => {
            eprintln!("error: {error} (see cargo xtask --help)");
            return ExitCode::from(2);
        }
    };
    let outcome = match request {
        Request::Help => {
            print!("{HELP}");
            Ok(())
        }
        Request::Setup {
            forced,
            check: true,
        } => setup::check(forced),
        Request::Setup {
            forced,
            check: false,
        } => setup::run(forced).and_then(|_| capi::bring_compiler()),
        Request::Demo { forced } => demo::run(forced),
        Request::Bench { forced, accept } => bench::run(forced, accept),
        Request::Faults { forced, accept } => faults::run(forced, accept),
        Request::Fuzz { forced, runs } => fuzz::run(forced, runs),
        Request::Test { forced } => test::run(forced),
        Request::Capi { forced } => capi::run(forced),
        Request::Flash {
            forced,
            board,
            image,
        } => flash::run(forced, board, image),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::Path;

    fn request(line: &str) -> Result<Request, String> {
        parse(lexopt::Parser::from_args(line.split_whitespace())).map_err(|error| error.to_string())
    }

    #[test]
    fn a_command_takes_its_options_on_either_side() {
        let forced = Some(Way::Debian);
        assert_eq!(
            request("setup --toolchain debian --check"),
            Ok(Request::Setup {
                forced,
                check: true
            })
        );
        assert_eq!(
            request("--toolchain=debian demo"),
            Ok(Request::Demo { forced })
        );
        assert_eq!(request("test"), Ok(Request::Test { forced: None }));
        assert_eq!(
            request("bench --accept"),
            Ok(Request::Bench {
                forced: None,
                accept: true
            })
        );
        assert_eq!(
            request("fuzz --runs 7"),
            Ok(Request::Fuzz {
                forced: None,
                runs: 7
            })
        );
        assert_eq!(
            request("flash --image --board pyboard"),
            Ok(Request::Flash {
                forced: None,
                board: Board::Pyboard,
                image: true
            })
        );
        assert_eq!(request(""), Ok(Request::Help));
        assert_eq!(request("test --help"), Ok(Request::Help));
    }

    #[test]
    fn a_mistyped_line_is_refused_by_name() {
        for (line, named) in [
            ("tset", "tset"),
            ("test setup", "setup"),
            ("setup --tolchain rustup", "tolchain"),
            ("setup --toolchain nix", "installed, rustup or debian"),
            ("demo --check", "--check"),
            ("test --accept", "--accept"),
            ("test --runs 3", "--runs"),
            ("fuzz --runs some", "some"),
            ("fuzz --runs 0", "zero"),
            ("flash --board nucleo", "odrive, pyboard or drive"),
            ("test --image", "--image"),
        ] {
            let error = request(line).unwrap_err();
            assert!(error.contains(named), "`{line}` gave `{error}`");
        }
    }

    #[test]
    fn every_command_of_the_pages_is_understood() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let docs = fs::read_dir(root.join("docs")).unwrap();
        let pages = docs.map(|entry| entry.unwrap().path());
        let mut seen = 0;
        for path in pages.chain([root.join("README.md")]) {
            let Ok(page) = fs::read_to_string(&path) else {
                continue; // A picture.
            };
            for line in page.lines() {
                for command in line.split("cargo xtask ").skip(1) {
                    let command = command.split(['`', '#']).next().unwrap_or_default();
                    if let Err(error) = request(command) {
                        panic!("{}: `cargo xtask {command}`: {error}", path.display());
                    }
                    seen += 1;
                }
            }
        }
        assert!(seen > 20, "only {seen} commands were found");
    }
}
