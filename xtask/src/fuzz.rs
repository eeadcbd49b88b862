//! Coverage-guided fuzzing: libFuzzer with the stable compiler, whose coverage pass needs only flags.

use std::fs;
use std::path::PathBuf;
use std::process::Stdio;
use std::thread;

use anyhow::{Context as _, Result, anyhow, bail};

use crate::setup::{self, Way};
use crate::shell::{self, capture, command, root};

/// Executions in all by default.
pub(crate) const RUNS: u64 = 100_000_000;
/// Instrumentation for libFuzzer: counters of edges, a table of their places, and the operands of comparisons.
const COVERAGE: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
                        -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
                        -Cllvm-args=-sanitizer-coverage-pc-table \
                        -Cllvm-args=-sanitizer-coverage-trace-compares";
/// Corpora, logs and crashes, from the workspace's root.
const HOME: &str = "target/foretorque/fuzz";

/// A fuzzed part of the firmware: its name, the longest input (a frame or two, the largest bank, an upload, a store with a bank
/// in it), and its part of all executions, percent.
type Target = (&'static str, u32, u64);

/// Two at a time, for two cores.
const LANES: [&[Target]; 2] = [
    &[("decoder", 128, 45), ("session", 1024, 2)],
    &[("bank", 2048, 40), ("store", 4096, 3), ("drives", 80, 10)],
];

struct Outcome {
    name: &'static str,
    executions: u64,
    per_second: u64,
    /// The input that broke a promise or took too long.
    found: Option<String>,
}

/// Sets up, fuzzes, prints a table and writes target/foretorque/fuzz.json.
pub(crate) fn run(forced: Option<Way>, runs: u64) -> Result<()> {
    setup::run(forced)?;
    let outcomes = fuzz(runs)?;
    println!("{:<10} {:>12} {:>12}", "target", "executions", "per second");
    let targets = outcomes.iter().map(|outcome| {
        let (name, executions, per_second) = (outcome.name, outcome.executions, outcome.per_second);
        println!("{name:<10} {executions:>12} {per_second:>12}");
        let crashes = u8::from(outcome.found.is_some());
        format!(
            "{{\"name\": \"{name}\", \"executions\": {executions}, \"executions_per_s\": {per_second}, \
             \"crashes\": {crashes}}}"
        )
    });
    let targets = targets.collect::<Vec<_>>().join(", ");
    let json = format!("{{\"targets\": [{targets}]}}\n");
    fs::write(root().join("target/foretorque/fuzz.json"), json)?;
    let sum: u64 = outcomes.iter().map(|outcome| outcome.executions).sum();
    println!("{:<10} {sum:>12}", "all");
    let found = outcomes.iter().filter_map(|it| it.found.as_deref());
    let found: Vec<&str> = found.collect();
    if !found.is_empty() {
        bail!("inputs that break a promise: {}", found.join("; "));
    }
    Ok(())
}

/// Committed inputs, one archive of the directory `corpus` with a directory for each target.
///
/// Packed by `tar --sort=name --mtime=@0 --owner=0 --group=0 --numeric-owner --format=ustar -c corpus | gzip -9n`, so that
/// the same inputs are the same bytes.
const CORPUS: &str = "tests/fuzz/corpus.tar.gz";

/// Unpacks the committed inputs; the directory of a target is [`corpus`].
fn unpack() -> Result<()> {
    let home = root().join(HOME);
    // Inputs of an older archive.
    let _ = fs::remove_dir_all(home.join("corpus"));
    fs::create_dir_all(&home)?;
    shell::run(&mut command(&format!("tar -xzf {CORPUS} -C {HOME}")))?;
    // A target may have seeds only.
    for (name, ..) in LANES.iter().copied().flatten() {
        fs::create_dir_all(corpus(name))?;
    }
    Ok(())
}

fn corpus(name: &str) -> PathBuf {
    root().join(HOME).join("corpus").join(name)
}

/// Builds the targets and fuzzes all of them, `runs` executions in all.
fn fuzz(runs: u64) -> Result<Vec<Outcome>> {
    setup::bring_program("c++", "g++").context("libFuzzer needs a C++ compiler")?;
    unpack()?;
    let host = capture(&mut command("rustc -vV")).context("rustc reports no version")?;
    let host = host.lines().find_map(|line| line.strip_prefix("host: "));
    let host = host.context("rustc reports no host")?.to_owned();
    // With a target named, the flags are for the code that is fuzzed and not for what builds it.
    let mut build = command(&format!(
        "cargo build --release --bins --manifest-path tests/fuzz/engine/Cargo.toml --target-dir target/fuzz --target {host}"
    ));
    shell::run(build.env("RUSTFLAGS", COVERAGE))?;
    let lanes = LANES.each_ref().map(|lane| {
        let programs = format!("target/fuzz/{host}/release");
        thread::spawn(move || {
            let outcomes = lane.iter().map(|target| attack(*target, &programs, runs));
            outcomes.collect::<Result<Vec<_>>>()
        })
    });
    let mut outcomes = Vec::new();
    for lane in lanes {
        let done = lane.join();
        outcomes.extend(done.map_err(|_| anyhow!("a fuzzing thread panicked"))??);
    }
    Ok(outcomes)
}

/// Fuzzes one target, of the directory `programs`, with its share of `runs`, and reads the report of libFuzzer.
fn attack((name, max_len, share): Target, programs: &str, runs: u64) -> Result<Outcome> {
    let runs = runs / 100 * share + runs % 100 * share / 100;
    let home = root().join(HOME).join(name);
    let (found, seeds) = (home.join("found"), home.join("seeds"));
    for directory in [&found, &seeds] {
        fs::create_dir_all(directory)?;
    }
    let log = home.join("log");
    let line = format!(
        "{programs}/{name} -runs={runs} -max_len={max_len} -seed=1 -timeout=10 -print_final_stats=1"
    );
    let output = command(&line)
        // New inputs go to the first directory; the others are only read.
        .args([&found, &corpus(name), &seeds])
        .arg(format!("-artifact_prefix={}/", home.display()))
        .env("FORETORQUE_SEEDS", &seeds)
        .stdout(Stdio::null())
        .stderr(fs::File::create(&log)?)
        .status()
        .with_context(|| format!("cannot start the fuzzer of `{name}`"))?;
    let report = String::from_utf8_lossy(&fs::read(&log)?).into_owned();
    let number = |key: &str| {
        let line = report.lines().find_map(|line| line.strip_prefix(key));
        line.and_then(|value| value.trim().parse().ok())
            .unwrap_or(0)
    };
    let artifact = report.lines().find_map(|line| {
        line.split_once("Test unit written to ")
            .map(|(_, file)| file)
    });
    let found = match (output.success(), artifact) {
        (true, _) => None,
        (false, Some(file)) => Some(format!("{name}: {file}")),
        (false, None) => Some(format!("{name}: see {}", log.display())),
    };
    Ok(Outcome {
        name,
        executions: number("stat::number_of_executed_units:"),
        per_second: number("stat::average_exec_per_sec:"),
        found,
    })
}
