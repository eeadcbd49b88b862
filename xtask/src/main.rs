//! Set-up, demo, bench and test of foretorque in one command each.

mod circles;
mod flash;
mod fuzz;
mod outside;
mod runs;
mod setup;
mod shell;
mod test;
mod words;

use std::num::NonZeroU64;
use std::process::ExitCode;

use anyhow::Result;
use lexopt::prelude::*;

use setup::Way;

const HELP: &str = "\
Set-up, demo, bench and test of foretorque in one command each.

Usage: cargo xtask <COMMAND> [OPTIONS]

Commands:
  setup    Install what the other commands need: the board's Rust target, the emulator, clippy, rustfmt, a C compiler
  demo     Set up, build, run the demo in the emulator, write target/foretorque/demo/report.html
  test     Set up, run every gate (format, lints, builds, tests, docs), print a table and counts
  bench    Set up, measure the cost of the firmware, compare with docs/budget.md, write target/foretorque/bench.json
  faults   Set up, inject every fault into every board, write target/foretorque/faults.json
  fuzz     Set up, fuzz decoder, bank loader, session, store and drives, write target/foretorque/fuzz.json
  flash    Set up, build, write .bin and .hex to target/foretorque/flash, flash the ELF by probe-rs
  arm      Set up, describe an arm, build its firmware into target/foretorque/arms/NAME, print the sizes
  capi     Set up, write the header for C, build the static library and its example
  words    Check the first lines of doc comments and the lengths of sentences
  circles  List import circles between source files
  mutants  Change limits, checks and a sample of all code that limits torque, one place at a time; tests must fail

Options:
      --toolchain <WAY>  Source of the board's toolchain. Default: the first of these that works
                           installed  a toolchain that is already here and builds for the board
                           rustup     `rustup target add`, bounded in time
                           debian     core built from Debian's Rust packages and linked as a toolchain
      --check            setup: change nothing, list what is installed and missing, fail if anything is missing
      --board <BOARD>    flash: odrive (default), pyboard, drive or can
      --image            flash: write the images, flash nothing
      --urdf <FILE>      arm: URDF, MJCF or TOML
      --name <NAME>      arm: name of the arm; --base, --tip, --link-mass VALUE, --weld and --repair as of host-sim
      --accept           bench: write docs/budget.md anew; limits go down, never up
                         faults: write the counts into tests/snapshots/faults.txt instead of comparing them
      --runs <N>         fuzz: executions in all (default 100000000); mutants: size of the sample (default 320)
  -h, --help             Print this help

The debian way links a rustup toolchain named foretorque-arm. It lies in $XDG_DATA_HOME/foretorque
(~/.local/share/foretorque). If the emulator cannot be installed as a package, it is unpacked into the same directory; a
script qemu-system-arm beside cargo starts it. To remove everything: `rustup toolchain uninstall foretorque-arm`, then
delete the directory and the script.
";

/// Commands and the options each takes, separated by spaces; all take `--toolchain`.
const COMMANDS: [(&str, &str); 13] = [
    ("help", ""),
    ("setup", "check"),
    ("demo", ""),
    ("test", ""),
    ("bench", "accept"),
    ("faults", "accept"),
    ("fuzz", "runs"),
    ("flash", "board image"),
    ("arm", "urdf name base tip link-mass weld repair"),
    ("capi", ""),
    ("words", ""),
    ("circles", ""),
    ("mutants", "runs"),
];

/// The command line.
#[derive(Debug, Default, PartialEq)]
struct Request {
    command: String,
    toolchain: Option<Way>,
    check: bool,
    accept: bool,
    image: bool,
    /// Binary of the board to flash.
    binary: Option<&'static str>,
    runs: Option<u64>,
    urdf: Option<String>,
    name: Option<String>,
    /// Options of `arm` for host-sim.
    selection: Vec<String>,
}

/// Reads the command line; the error is one line for the user.
fn parse(mut args: lexopt::Parser) -> Result<Request, lexopt::Error> {
    let mut request = Request::default();
    let mut options = Vec::new();
    while let Some(arg) = args.next()? {
        if let Long(name) = arg {
            options.push(name.to_owned());
        }
        match arg {
            Short('h') | Long("help") => {
                request.command = "help".into();
                return Ok(request);
            }
            Long("toolchain") => request.toolchain = Some(args.value()?.parse()?),
            Long("check") => request.check = true,
            Long("accept") => request.accept = true,
            Long("image") => request.image = true,
            Long("board") => request.binary = Some(args.value()?.parse_with(flash::binary)?),
            Long("runs") => {
                let number = args.value()?.parse::<NonZeroU64>();
                request.runs = Some(number.map_err(|error| format!("--runs: {error}"))?.get());
            }
            Long("urdf") => request.urdf = Some(args.value()?.string()?),
            Long("name") => request.name = Some(args.value()?.string()?),
            Long(flag @ ("weld" | "repair")) => request.selection.push(format!("--{flag}")),
            Long(option @ ("base" | "tip" | "link-mass")) => {
                let option = format!("--{option}");
                request.selection.extend([option, args.value()?.string()?]);
            }
            Value(name) if request.command.is_empty() => request.command = name.string()?,
            other => return Err(other.unexpected()),
        }
    }
    if request.command.is_empty() {
        request.command = "help".into();
    }
    let command = COMMANDS.iter().find(|(name, _)| *name == request.command);
    let Some((name, taken)) = command else {
        return Err(format!("there is no command `{}`", request.command).into());
    };
    let mut options = options.iter().map(String::as_str);
    let taken = taken.split(' ').chain(["toolchain"]);
    match options.find(|option| !taken.clone().any(|one| one == *option)) {
        Some(option) => Err(format!("`cargo xtask {name}` takes no --{option}").into()),
        None => Ok(request),
    }
}

fn run(request: &Request) -> Result<()> {
    let forced = request.toolchain;
    match request.command.as_str() {
        "setup" if request.check => setup::check(forced),
        "setup" => setup::run(forced).and_then(|_| outside::bring_compiler()),
        "demo" => runs::demo(forced),
        "test" => test::run(forced),
        "bench" => runs::bench(forced, request.accept),
        "faults" => runs::faults(forced, request.accept),
        "fuzz" => fuzz::run(forced, request.runs.unwrap_or(fuzz::RUNS)),
        "flash" => flash::run(forced, request.binary, request.image),
        "arm" => match (&request.urdf, &request.name) {
            (Some(urdf), Some(name)) => runs::arm(forced, urdf, name, &request.selection),
            _ => anyhow::bail!("`cargo xtask arm` needs --urdf FILE and --name NAME"),
        },
        "capi" => outside::capi(forced),
        "words" => words::run(),
        "circles" => circles::run(),
        // A package of its own: the parser of Rust must not delay the other commands.
        "mutants" => {
            let line = "cargo run --quiet --release -p foretorque-mutants --";
            let mut mutants = shell::command(line);
            shell::run(mutants.args(request.runs.map(|runs| runs.to_string())))
        }
        _ => {
            print!("{HELP}");
            Ok(())
        }
    }
}

fn main() -> ExitCode {
    let request = match parse(lexopt::Parser::from_env()) {
        Ok(request) => request,
        Err(error) => {
            eprintln!("error: {error} (see cargo xtask --help)");
            return ExitCode::from(2);
        }
    };
    match run(&request) {
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
        let command = |name: &str| Request {
            command: name.into(),
            ..Request::default()
        };
        let mut setup = command("setup");
        (setup.toolchain, setup.check) = (Some(Way::Debian), true);
        assert_eq!(request("setup --toolchain debian --check"), Ok(setup));
        let mut demo = command("demo");
        demo.toolchain = Some(Way::Debian);
        assert_eq!(request("--toolchain=debian demo"), Ok(demo));
        let mut flash = command("flash");
        (flash.binary, flash.image) = (Some("joint-pyboard"), true);
        assert_eq!(request("flash --image --board pyboard"), Ok(flash));
        let mut fuzz = command("fuzz");
        fuzz.runs = Some(7);
        assert_eq!(request("fuzz --runs 7"), Ok(fuzz));
        let arm = request("arm --urdf a.urdf --tip hand --name a --weld").unwrap();
        assert_eq!(arm.selection, ["--tip", "hand", "--weld"]);
        assert!(request("bench --accept").unwrap().accept);
        assert_eq!(request(""), Ok(command("help")));
        assert_eq!(request("test --help"), Ok(command("help")));
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
            ("flash --board nucleo", "odrive, pyboard, drive or can"),
            ("test --image", "--image"),
            ("demo --urdf a", "--urdf"),
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
        for path in pages.chain(["README.md", "CONTRIBUTING.md"].map(|page| root.join(page))) {
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
