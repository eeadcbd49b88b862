//! Every gate in one command. A failing gate does not hide the ones after it.

use std::io::{BufRead as _, BufReader};
use std::panic::resume_unwind;
use std::process::{Command, Stdio};
use std::thread;
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use foretorque_cost as cost;

use crate::circles;
use crate::flash;
use crate::outside;
use crate::runs;
use crate::setup::{self, Way};
use crate::shell::{self, Tools, command, line};
use crate::words;

/// Result of a gate.
struct Outcome {
    name: &'static str,
    passed: bool,
    seconds: f64,
}

/// Numbers of tests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    passed: u32,
    failed: u32,
}

impl Counts {
    fn plus(self, more: Self) -> Self {
        Self {
            passed: self.passed + more.passed,
            failed: self.failed + more.failed,
        }
    }
}

/// Sets up, passes every gate, and ends with a table of the gates and the counts of the tests.
pub(crate) fn run(forced: Option<Way>) -> Result<()> {
    let start = Instant::now();
    let tools = setup::run(forced)?;
    let mut outcomes = vec![Outcome {
        name: "set-up",
        passed: true,
        seconds: start.elapsed().as_secs_f64(),
    }];

    // Each lane has directories of its own, so that no build waits for another one.
    outcomes.extend(side_by_side([host_builds(tools), board_builds(tools)]));
    // Linking an image takes one core: the other one has the crates outside and the docs.
    outcomes.extend(side_by_side([images(tools), public(tools)]));
    // After the builds, because the tests run the board's ELF files.
    let (mut counts, mut skips) = (Counts::default(), Vec::new());
    outcomes.push(pass("tests", || {
        let (seen, ended_well, skipped) =
            count_tests(&mut command("cargo test --workspace --no-fail-fast"))?;
        (counts, skips) = (attribute(seen, ended_well), skipped);
        if !ended_well {
            bail!("`cargo test` failed");
        }
        Ok(())
    }));
    println!("\n{:<16} {:<7} {:>8}", "gate", "result", "seconds");
    for outcome in &outcomes {
        let (name, seconds) = (outcome.name, outcome.seconds);
        let result = if outcome.passed { "ok" } else { "FAILED" };
        println!("{name:<16} {result:<7} {seconds:>8.1}");
    }
    let seconds = start.elapsed().as_secs_f64();
    println!("{:<16} {:<7} {seconds:>8.1}\n", "all", "");
    let Counts { passed, failed } = counts;
    println!("{passed} passed, {failed} failed, {} not run", skips.len());
    for skip in skips {
        println!("  {skip}");
    }
    let failed = outcomes.iter().filter(|outcome| !outcome.passed);
    let failed: Vec<_> = failed.map(|outcome| outcome.name).collect();
    if !failed.is_empty() {
        bail!("failed: {}", failed.join(", "));
    }
    Ok(())
}

type Gate = (&'static str, Box<dyn FnOnce() -> Result<()> + Send>);

fn gate(name: &'static str, work: impl FnOnce() -> Result<()> + Send + 'static) -> Gate {
    (name, Box::new(work))
}

/// A gate that is one command.
fn runs(name: &'static str, mut command: Command) -> Gate {
    gate(name, move || shell::run(&mut command))
}

/// Passes the gates of both lanes at the same time, those of a lane in their order.
fn side_by_side(lanes: [Vec<Gate>; 2]) -> Vec<Outcome> {
    let passed = |lane: Vec<Gate>| -> Vec<Outcome> {
        let gates = lane.into_iter();
        gates.map(|(name, work)| pass(name, work)).collect()
    };
    thread::scope(|scope| {
        let lanes = lanes.map(|lane| scope.spawn(move || passed(lane)));
        let outcomes = lanes.map(|lane| lane.join().unwrap_or_else(|panic| resume_unwind(panic)));
        outcomes.into_iter().flatten().collect()
    })
}

/// Checks of the source, and builds in the host's directory, the cheapest first.
fn host_builds(tools: Tools) -> Vec<Gate> {
    let clippy = "cargo clippy --workspace --all-targets -- -D warnings";
    vec![
        runs("format", tools.host.tool("cargo fmt --all --check")),
        gate("words", words::run),
        gate("circles", circles::run),
        runs("clippy, host", tools.host.tool(clippy)),
        runs("tests, built", command("cargo test --workspace --no-run")),
    ]
}

/// Builds in the board's directory. The libraries without a log are linted for the host, and built for the board with the
/// library for C.
fn board_builds(tools: Tools) -> Vec<Gate> {
    let mut clippy = tools.board.board_cargo("clippy --lib --bins");
    clippy.args(["--", "-D", "warnings"]);
    vec![runs("clippy, board", clippy)]
}

/// The board's images, with a `host-sim` that was built with the tests.
fn images(tools: Tools) -> Vec<Gate> {
    vec![
        gate("7 and 8 joints", move || {
            runs::larger(tools.board, "target/debug/host-sim", &[cost::JOINT]).map(|_| ())
        }),
        // After those of other arms, for the images of the UR5 to be the ones that need no rebuild.
        runs("firmware", tools.board.board_cargo("build --bins")),
        gate("linked firmware", || {
            cost::check_firmware(&shell::elf_dir(), &flash::BOARDS.map(|(_, binary)| binary))?;
            cost::check_bench(&shell::elf_dir(), &shell::root())
        }),
        gate("library for C", move || {
            outside::bring_compiler()?;
            outside::build_capi(tools)
        }),
    ]
}

/// Packages as a user has them, and the documentation of every package.
fn public(tools: Tools) -> Vec<Gate> {
    // With the examples the features of the dependencies are those of clippy, so nothing is built twice. On the
    // host the board's images are mains that say what they are: nothing to document.
    let mut docs =
        command("cargo doc --workspace --no-deps --lib --bin host-sim --bin xtask --examples");
    docs.env("RUSTDOCFLAGS", "-D warnings");
    vec![
        runs("docs", docs),
        gate("crate outside", move || outside::gate(tools)),
    ]
}

fn pass(name: &'static str, gate: impl FnOnce() -> Result<()>) -> Outcome {
    println!("\n== {name}");
    let start = Instant::now();
    let outcome = gate();
    if let Err(error) = &outcome {
        println!("== {name}: {error:#}");
    }
    Outcome {
        name,
        passed: outcome.is_ok(),
        seconds: start.elapsed().as_secs_f64(),
    }
}

/// Runs `cargo test` with its output shown; returns the sum of its result lines, whether it ended well, and the lines of tests
/// that this machine cannot run.
fn count_tests(cargo: &mut Command) -> Result<(Counts, bool, Vec<String>)> {
    let mut child = cargo
        .stdout(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start `{}`", line(cargo)))?;
    let pipe = child
        .stdout
        .take()
        .context("cargo has no standard output")?;
    let (mut seen, mut skips) = (Counts::default(), Vec::new());
    for bytes in BufReader::new(pipe).split(b'\n') {
        let bytes = bytes?;
        let text = String::from_utf8_lossy(&bytes);
        println!("{text}");
        seen = seen.plus(parse_result(&text).unwrap_or_default());
        // Beside the name of another test, where several run at once.
        skips.extend(text.find("skipped: ").map(|place| text[place..].to_owned()));
    }
    Ok((seen, child.wait()?.success(), skips))
}

/// The counts of one line such as `test result: ok. 3 passed; 0 failed; 1 ignored; …`.
fn parse_result(line: &str) -> Option<Counts> {
    let (_, rest) = line
        .trim()
        .strip_prefix("test result: ")?
        .split_once(". ")?;
    let number = |word: &str| {
        rest.split("; ")
            .find_map(|part| part.trim().strip_suffix(word)?.trim().parse().ok())
    };
    Some(Counts {
        passed: number("passed")?,
        failed: number("failed")?,
    })
}

/// A test program that crashed or did not compile prints no result line: it counts as one failure all the same.
fn attribute(seen: Counts, ended_well: bool) -> Counts {
    let failed = seen.failed.max(u32::from(!ended_well));
    Counts { failed, ..seen }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn result_lines_add_up_and_other_lines_do_not() {
        let output = "
running 3 tests
test a ... ok
test test result: ok. 9 passed; 9 failed ... ok
test result: ok. 3 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.01s
test result: FAILED. 12 passed; 2 failed; 0 ignored; 0 measured; 0 filtered out; finished in 1.20s
all doctests ran in 0.31s; merged doctests compilation took 0.20s
test result: nonsense";
        let results = output.lines().filter_map(parse_result);
        let (passed, failed) = (15, 2);
        let sum = results.fold(Counts::default(), Counts::plus);
        assert_eq!(sum, Counts { passed, failed });
    }

    #[test]
    fn a_test_program_that_dies_without_a_result_line_is_a_failure() {
        for (failed, ended_well, expected) in [(0, false, 1), (0, true, 0), (2, false, 2)] {
            let passed = 7;
            let counts = attribute(Counts { passed, failed }, ended_well);
            assert_eq!((counts.passed, counts.failed), (7, expected));
        }
    }
}
