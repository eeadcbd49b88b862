//! The tests as judges: which of them reach a mutant, and which fail on it.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};

use crate::tree::Tree;

/// One test of a library.
pub(crate) struct Judge {
    program: PathBuf,
    directory: PathBuf,
    name: String,
    time: Duration,
    /// Numbers of the mutants that it executes.
    reached: Vec<u32>,
    /// Evaluations of switches without a mutant: at least this many, at most twice as many.
    calls: u64,
}

/// Evaluations of switches, in multiples of those without a mutant, after which a mutant loops.
const LOOPS: u64 = 32;

impl Judge {
    fn command(&self, mutant: u32) -> Command {
        let mut command = Command::new(&self.program);
        command
            .args(["--exact", &self.name, "--test-threads=1", "--quiet"])
            .current_dir(&self.directory)
            .env("FORETORQUE_MUTANT", mutant.to_string())
            .env("FORETORQUE_CALLS", (LOOPS * self.calls).to_string())
            // The same inputs for every mutant.
            .env("PROPTEST_RNG_SEED", "1")
            .env("PROPTEST_FAILURE_PERSISTENCE", "off")
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        command
    }

    /// The test passes on a mutant. A mutant that loops fails it by the count of its switches; one that loops without a
    /// switch is stopped some time later, and passes: no verdict depends on time.
    fn passes(&self, mutant: u32) -> Result<bool> {
        let most = self.time * 100 + Duration::from_secs(60);
        let start = Instant::now();
        let mut child = self.command(mutant).spawn()?;
        loop {
            if let Some(status) = child.try_wait()? {
                return Ok(status.success());
            }
            if start.elapsed() > most {
                child.kill()?;
                child.wait()?;
                println!("{mutant} loops without a switch in {}", self.name);
                return Ok(true);
            }
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// All tests, the fastest first. Each has to pass without a mutant.
pub(crate) fn all(tree: &Tree, programs: &[PathBuf]) -> Result<Vec<Judge>> {
    let mut judges = Vec::new();
    let reached = std::env::temp_dir().join(format!("foretorque-mutants-{}", std::process::id()));
    for (number, program) in programs.iter().enumerate() {
        let listed = Command::new(program)
            .args(["--list", "--format=terse"])
            .output()?;
        for line in String::from_utf8(listed.stdout)?.lines() {
            let Some(name) = line.strip_suffix(": test") else {
                continue;
            };
            let mut judge = Judge {
                program: program.clone(),
                directory: tree.directory(number),
                name: name.to_owned(),
                time: Duration::ZERO,
                reached: Vec::new(),
                calls: 0,
            };
            let _ = fs::remove_file(&reached);
            let start = Instant::now();
            let mut command = judge.command(u32::MAX);
            let status = command.env("FORETORQUE_REACHED", &reached).status()?;
            ensure!(status.success(), "{name} fails without a mutant");
            judge.time = start.elapsed();
            for line in fs::read_to_string(&reached).unwrap_or_default().lines() {
                let (mutant, calls) = line.split_once(' ').context("no count")?;
                judge.reached.push(mutant.parse()?);
                judge.calls = calls.parse()?;
            }
            judges.push(judge);
        }
    }
    let _ = fs::remove_file(&reached);
    judges.sort_by_key(|judge| judge.time);
    Ok(judges)
}

/// Name of the first test that fails on a mutant; `None` when it lives.
pub(crate) fn killer(judges: &[Judge], mutant: u32) -> Result<Option<&str>> {
    for judge in judges
        .iter()
        .filter(|judge| judge.reached.contains(&mutant))
    {
        let passes = judge.passes(mutant);
        if !passes.with_context(|| format!("cannot run {}", judge.name))? {
            return Ok(Some(&judge.name));
        }
    }
    Ok(None)
}
