//! Copy of the workspace in which all mutants of a campaign are compiled at once, each behind a switch, and its tests as judges:
//! which of them reach a mutant, and which fail on it.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::Value;

use crate::places::{self, Place};

/// Packages whose library tests judge, and their root modules.
const PACKAGES: [(&str, &str); 2] = [
    ("foretorque", "firmware/foretorque/src"),
    ("foretorque-link", "firmware/foretorque-link/src"),
];

/// The switch, a module of the first package in the copy.
const SWITCH: &str = r#"//! Switch of the mutants.
extern crate std;
use std::io::Write as _;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

static ACTIVE: OnceLock<(u32, u64)> = OnceLock::new();
static CALLS: AtomicU64 = AtomicU64::new(0);
static REACHED: [AtomicU32; 1024] = [const { AtomicU32::new(0) }; 1024];

fn number(name: &str) -> u64 {
    std::env::var(name).ok().and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// Whether a mutant acts. Its process ends after FORETORQUE_CALLS calls: it loops. The number `u32::MAX` writes the
/// mutants reached and the powers of two among the calls to a file.
pub fn on(mutant: u32) -> bool {
    let (active, most) =
        *ACTIVE.get_or_init(|| (number("FORETORQUE_MUTANT") as u32, number("FORETORQUE_CALLS")));
    // Not locked: the tests spend their time here, and a lost count is no harm.
    let calls = CALLS.load(Ordering::Relaxed) + 1;
    CALLS.store(calls, Ordering::Relaxed);
    if active == u32::MAX {
        let bit = 1 << (mutant % 32);
        let first = REACHED[mutant as usize / 32].fetch_or(bit, Ordering::Relaxed) & bit == 0;
        if first || calls.is_power_of_two() {
            let path = std::env::var("FORETORQUE_REACHED").unwrap();
            let file = std::fs::OpenOptions::new().append(true).create(true).open(path);
            writeln!(file.unwrap(), "{mutant} {calls}").unwrap();
        }
    } else if active != 0 && calls > most {
        std::process::exit(1);
    }
    active == mutant
}
"#;

/// Most mutants of one campaign: bits of the switch.
pub(crate) const MOST: usize = 32_000;

/// A mutant: its file and its place there. The number of its switch is its index and 1.
#[derive(Clone, Debug)]
pub(crate) struct Mutant {
    pub(crate) file: String,
    pub(crate) place: Place,
}

pub(crate) struct Tree {
    root: PathBuf,
    copy: PathBuf,
}

/// Number of a mutant, and its place in the file.
type Numbered = (u32, Range<usize>);

impl Tree {
    /// Copies every tracked file that differs, so that what has not changed is not compiled again.
    pub(crate) fn new(root: &Path) -> Result<Self> {
        let copy = root.join("target/mutants");
        let listed = Command::new("git")
            .args(["ls-files", "-z", "--cached", "--others"])
            .arg("--exclude-standard")
            .current_dir(root)
            .output()?;
        ensure!(listed.status.success(), "`git ls-files` failed");
        for path in String::from_utf8(listed.stdout)?.split_terminator('\0') {
            if let Ok(bytes) = fs::read(root.join(path)) {
                write(&copy.join(path), &bytes)?;
            }
        }
        Ok(Self {
            root: root.to_owned(),
            copy,
        })
    }

    /// Writes the mutants that compile into the copy; the others are dropped.
    pub(crate) fn plant(&self, mutants: &mut [Option<Mutant>]) -> Result<()> {
        ensure!(mutants.len() < MOST, "more than {MOST} mutants");
        let (_, sources) = PACKAGES[0];
        let copy = self.copy.join(sources);
        write(&copy.join("mutation.rs"), SWITCH.as_bytes())?;
        let lib = fs::read_to_string(self.root.join(sources).join("lib.rs"))?;
        let lib = lib + "\npub mod mutation;\n";
        write(&copy.join("lib.rs"), lib.as_bytes())?;
        let check = ["check", "--lib", "--message-format=json"];
        self.until_it_compiles(&check, mutants).map(|_| ())
    }

    /// Builds the library tests, without the mutants that do not compile in them; the programs.
    pub(crate) fn build(&self, mutants: &mut [Option<Mutant>]) -> Result<Vec<PathBuf>> {
        let test = ["test", "--lib", "--no-run", "--message-format=json"];
        let programs = messages(&self.until_it_compiles(&test, mutants)?)
            .filter_map(|message| message["executable"].as_str().map(PathBuf::from))
            .collect::<Vec<_>>();
        ensure!(programs.len() == PACKAGES.len(), "{programs:?}");
        Ok(programs)
    }

    /// Calls cargo, and drops the mutants at its errors, until there are none.
    fn until_it_compiles(&self, args: &[&str], mutants: &mut [Option<Mutant>]) -> Result<Vec<u8>> {
        for _ in 0..20 {
            let ranges = self.write_mutants(mutants)?;
            let mut cargo = self.cargo(args);
            let output = cargo.stderr(Stdio::null()).output()?;
            if output.status.success() {
                return Ok(output.stdout);
            }
            let errors = errors(&output.stdout);
            let mut dropped = 0;
            for (file, at) in &errors {
                let inside = ranges.get(file).into_iter().flatten();
                let inside = inside.filter(|(_, range)| range.contains(&at.start));
                if let Some((number, _)) = inside.min_by_key(|(_, range)| range.len()) {
                    let mutant = &mut mutants[*number as usize - 1];
                    dropped += usize::from(mutant.take().is_some());
                }
            }
            ensure!(dropped > 0, "the copy does not compile: {errors:?}");
        }
        bail!("the copy does not compile after 20 rounds");
    }

    /// Writes every file with mutants; the place of each in it, by file.
    fn write_mutants(&self, mutants: &[Option<Mutant>]) -> Result<BTreeMap<String, Vec<Numbered>>> {
        let mut files: BTreeMap<&str, Vec<(u32, &Place)>> = BTreeMap::new();
        for (number, mutant) in (1..).zip(mutants) {
            if let Some(Mutant { file, place }) = mutant {
                files.entry(file).or_default().push((number, place));
            }
        }
        let mut ranges = BTreeMap::new();
        for (file, places) in files {
            let text = fs::read_to_string(self.root.join(file))?;
            let (text, places) = places::apply(&text, &places);
            write(&self.copy.join(file), text.as_bytes())?;
            ranges.insert(file.to_owned(), places);
        }
        Ok(ranges)
    }

    /// Working directory of a test program.
    pub(crate) fn directory(&self, program: usize) -> PathBuf {
        let (_, sources) = PACKAGES[program];
        self.copy.join(sources).join("..")
    }

    fn cargo(&self, args: &[&str]) -> Command {
        let mut cargo = Command::new("cargo");
        cargo.current_dir(&self.copy).args(args);
        cargo.arg("--target-dir").arg(self.copy.join("target"));
        for (package, _) in PACKAGES {
            cargo.args(["-p", package]);
        }
        cargo
    }
}

/// Writes a file unless it has this content.
fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if fs::read(path).is_ok_and(|old| old == bytes) {
        return Ok(());
    }
    if let Some(directory) = path.parent() {
        fs::create_dir_all(directory)?;
    }
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

fn messages(output: &[u8]) -> impl Iterator<Item = Value> {
    let lines = output.split(|&byte| byte == b'\n');
    lines.filter_map(|line| serde_json::from_slice(line).ok())
}

/// File and bytes of every error of the compiler.
fn errors(output: &[u8]) -> Vec<(String, Range<usize>)> {
    let mut found = Vec::new();
    for message in messages(output) {
        let message = &message["message"];
        if message["level"] != "error" {
            continue;
        }
        let spans = message["spans"].as_array().into_iter().flatten();
        for span in spans.filter(|span| span["is_primary"] == true) {
            let at = |key: &str| span[key].as_u64().unwrap_or(0) as usize;
            let file = span["file_name"].as_str().unwrap_or_default();
            found.push((file.to_owned(), at("byte_start")..at("byte_end")));
        }
    }
    found
}

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
pub(crate) fn judges(tree: &Tree, programs: &[PathBuf]) -> Result<Vec<Judge>> {
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
    let reaching = |judge: &&Judge| judge.reached.contains(&mutant);
    for judge in judges.iter().filter(reaching) {
        let passes = judge.passes(mutant);
        if !passes.with_context(|| format!("cannot run {}", judge.name))? {
            return Ok(Some(&judge.name));
        }
    }
    Ok(None)
}
