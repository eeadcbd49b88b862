//! Mutation campaign over the code that limits torque.
//!
//! All mutants are compiled at once, each behind a switch, in a copy of the workspace. A test that does not reach a mutant
//! cannot fail on it, so only those run that do, the fastest first, until one fails. A mutant loops when it passes many times
//! as many switches as the test without one; no verdict depends on time. Two campaigns: the named mutants of
//! `named.txt`, and a sample of all changes of expressions and statements in the modules that limit torque. Constants and
//! `const` functions take no switch; the named mutants change constants where they are used.

mod places;
mod tree;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};

use places::Place;
use tree::{Mutant, Tree};

/// Modules of the sample: files and directories below `firmware`.
const MODULES: [&str; 6] = [
    "foretorque-link/src/safety",
    "foretorque-link/src/session",
    "foretorque-link/src/wire",
    "foretorque/src/limits.rs",
    "foretorque/src/feedforward",
    "foretorque/src/learning/supervisor",
];
/// Test code in them, and names for reports.
const LEFT_OUT: [&str; 5] = ["tests", "tests.rs", "simulation", "promises.rs", "error.rs"];
/// Mutants of the sample by default.
const COUNT: usize = 320;
/// Part of the sample that has to be killed, percent.
const REQUIRED: f64 = 92.0;
/// Report, from the workspace's root: counts, and every live mutant with the reason given for it.
const REPORT: &str = "tests/snapshots/mutants.txt";
/// Text in place of a missing reason.
const NO_REASON: &str = "no reason given";

fn main() -> ExitCode {
    let count = std::env::args().nth(1).map(|count| count.parse());
    let run = || campaign(count.transpose()?.unwrap_or(COUNT));
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn campaign(count: usize) -> Result<()> {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = manifest.ancestors().nth(2).context("no workspace")?;
    let (names, named) = named(root)?;
    let sampled = sample(root, 2 * count)?;
    let taken = sampled.into_iter().map(Some);
    let mut mutants: Vec<_> = named.into_iter().map(Some).chain(taken).collect();
    let tree = Tree::new(root)?;
    let start = Instant::now();
    tree.plant(&mut mutants)?;
    // Twice as many were sampled, because not all of them compile.
    let surplus = mutants.iter_mut().skip(names.len());
    for extra in surplus.filter(|mutant| mutant.is_some()).skip(count) {
        *extra = None;
    }
    let programs = tree.build(&mut mutants)?;
    for (mutant, name) in mutants.iter().zip(&names) {
        ensure!(mutant.is_some(), "mutant `{name}` does not compile");
    }
    let judges = tree::judges(&tree, &programs)?;
    println!(
        "{} tests, ready after {:.0} s",
        judges.len(),
        start.elapsed().as_secs_f64()
    );
    let mut report = Report::read(root)?;
    for (number, mutant) in (1..).zip(&mutants) {
        let Some(mutant) = mutant else { continue };
        let name = names.get(number as usize - 1);
        let label = name.map_or_else(|| mutant.label(), String::clone);
        let killer = tree::killer(&judges, number)?;
        println!(
            "{:>6.0} s {number:>4} {:<40} {label}",
            start.elapsed().as_secs_f64(),
            killer.unwrap_or("LIVES")
        );
        report.note(name.is_some(), killer.is_some(), &label);
    }
    report.conclude((count == COUNT).then(|| root.join(REPORT)))
}

impl Mutant {
    fn label(&self) -> String {
        let file = self.file.trim_start_matches("firmware/");
        format!("{file} {}, {}", self.place.function, self.place.change)
    }
}

/// Names and mutants of `named.txt`.
fn named(root: &Path) -> Result<(Vec<String>, Vec<Mutant>)> {
    let text = include_str!("../named.txt");
    let (mut names, mut mutants) = (Vec::new(), Vec::new());
    for entry in text.split("\n\n").skip(1) {
        let mut lines = entry.trim().lines();
        let mut line = || lines.next().with_context(|| format!("named.txt: {entry}"));
        let (name, file, from, to) = (line()?, line()?, line()?, line()?);
        let file = format!("firmware/{file}");
        let source = fs::read_to_string(root.join(&file))?;
        let from = from.trim_start_matches("- ");
        let place = Place::named(&source, from, to.trim_start_matches('+'));
        let place = place.with_context(|| format!("named.txt: {name}: {file}"))?;
        names.push(name.to_owned());
        mutants.push(Mutant { file, place });
    }
    Ok((names, mutants))
}

/// The first `count` places of the modules in a pseudorandom order that new places hardly change.
fn sample(root: &Path, count: usize) -> Result<Vec<Mutant>> {
    let mut files = Vec::new();
    for module in MODULES {
        sources(&root.join("firmware").join(module), &mut files)?;
    }
    let mut mutants = Vec::new();
    for path in files {
        let text = fs::read_to_string(&path)?;
        let file = path.strip_prefix(root)?.display().to_string();
        let found = places::of(&text).with_context(|| format!("cannot parse {file}"))?;
        let of_file = found.into_iter().map(|place| Mutant {
            file: file.clone(),
            place,
        });
        mutants.extend(of_file);
    }
    println!("{} places in the modules", mutants.len());
    mutants.sort_by_cached_key(|mutant| hash(&mutant.label()));
    // The order of the file tells equal changes of one function apart.
    let mut seen = BTreeMap::new();
    for mutant in &mut mutants {
        let number = seen.entry(mutant.label()).or_insert(0);
        *number += 1;
        if *number > 1 {
            mutant.place.change += &format!(" ({number})");
        }
    }
    mutants.truncate(count);
    Ok(mutants)
}

/// FNV-1a, mixed.
fn hash(text: &str) -> u64 {
    let mixed = text.bytes().fold(0xCBF2_9CE4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
    });
    (mixed ^ mixed >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9)
}

fn sources(path: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    let name = path.file_name().unwrap_or_default();
    if LEFT_OUT.iter().any(|left_out| name == *left_out) {
        return Ok(());
    }
    if path.is_dir() {
        let entries = fs::read_dir(path)?.collect::<Result<Vec<_>, _>>()?;
        let mut paths: Vec<_> = entries.iter().map(|entry| entry.path()).collect();
        paths.sort();
        for path in paths {
            sources(&path, files)?;
        }
    } else {
        files.push(path.to_owned());
    }
    Ok(())
}

struct Report {
    /// Reasons of the report before, by mutant.
    reasons: BTreeMap<String, String>,
    /// Mutants, and those of them that are killed: named and sampled.
    counts: [(usize, usize); 2],
    live: Vec<String>,
}

impl Report {
    fn read(root: &Path) -> Result<Self> {
        let text = fs::read_to_string(root.join(REPORT)).unwrap_or_default();
        let reasons = text.lines().filter_map(|line| line.split_once(" | "));
        let reasons = reasons.map(|(label, reason)| (label.into(), reason.into()));
        Ok(Self {
            reasons: reasons.collect(),
            counts: [(0, 0); 2],
            live: Vec::new(),
        })
    }

    fn note(&mut self, named: bool, killed: bool, label: &str) {
        let (all, dead) = &mut self.counts[usize::from(!named)];
        *all += 1;
        *dead += usize::from(killed);
        if !killed {
            self.live.push(label.to_owned());
        }
    }

    /// Prints the report, and writes it to `file`: that of a smaller sample would lose reasons.
    ///
    /// Errors: the file's, mutants that live beyond the bounds or without a reason.
    fn conclude(&mut self, file: Option<PathBuf>) -> Result<()> {
        let [(named, named_killed), (sampled, killed)] = self.counts;
        let share = 100.0 * killed as f64 / sampled as f64;
        let mut text = format!(
            "cargo xtask mutants\n\nnamed: {named_killed} of {named} killed\nsampled: {killed} of {sampled} killed, {share:.1} %\n\nlive, with the reason:\n"
        );
        self.live.sort();
        let mut unexplained = 0;
        for label in &self.live {
            let reason = self.reasons.get(label).map_or(NO_REASON, |reason| reason);
            unexplained += usize::from(reason == NO_REASON);
            writeln!(text, "{label} | {reason}")?;
        }
        if let Some(file) = file {
            fs::write(file, &text)?;
        }
        println!("\n{text}");
        ensure!(named_killed == named, "a named mutant lives");
        // Not so of a sample of which nothing compiles.
        let enough = share >= REQUIRED;
        ensure!(enough, "less than {REQUIRED} % of the sample are killed");
        ensure!(
            unexplained == 0,
            "{unexplained} live mutants without a reason: kill them by a test, or write the reason into {REPORT}"
        );
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn root() -> &'static Path {
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .ancestors()
            .nth(2)
            .unwrap()
    }

    #[test]
    fn every_named_mutant_changes_one_place_under_a_name_of_its_own() {
        let (names, mutants) = named(root()).unwrap();
        let different: BTreeSet<_> = names.iter().collect();
        assert_eq!((different.len(), mutants.len()), (names.len(), names.len()));
        assert!(names.len() >= 39, "the list of the audit");
    }

    #[test]
    fn a_campaign_that_finds_too_little_fails() {
        for (counts, live, passes) in [
            ([(1, 1), (100, 92)], "a", true),
            ([(1, 1), (100, 92)], "b", false),
            ([(1, 1), (100, 91)], "a", false),
            ([(2, 1), (100, 92)], "a", false),
            ([(1, 1), (0, 0)], "a", false),
        ] {
            let mut report = Report {
                reasons: BTreeMap::from([("a".to_owned(), "a reason".to_owned())]),
                counts,
                live: vec![live.to_owned()],
            };
            assert_eq!(report.conclude(None).is_ok(), passes, "{counts:?} {live}");
        }
    }

    #[test]
    fn all_mutants_of_a_file_at_once_are_rust() {
        let mut files = BTreeMap::new();
        for mutant in sample(root(), usize::MAX).unwrap() {
            files
                .entry(mutant.file)
                .or_insert_with(Vec::new)
                .push(mutant.place);
        }
        for module in MODULES {
            assert!(files.keys().any(|file| file.contains(module)), "{module}");
        }
        for (file, places) in files {
            let text = fs::read_to_string(root().join(&file)).unwrap();
            let numbered: Vec<_> = (1..).zip(&places).collect();
            let (mutated, ranges) = places::apply(&text, &numbered);
            assert!(syn::parse_file(&mutated).is_ok(), "{file}");
            assert_eq!(ranges.len(), places.len());
        }
    }
}
