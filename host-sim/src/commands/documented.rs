//! The pages print no command that the program does not have.

use super::CommandLine;
use clap::{Command, CommandFactory};
use std::fs;
use std::path::{Path, PathBuf};

/// README.md and the pages of docs/.
fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let docs = fs::read_dir(root.join("docs")).expect("it is there");
    let docs = docs.map(|entry| entry.expect("it is there").path());
    docs.filter(|path| path.extension().is_some_and(|end| end == "md"))
        .chain([root.join("README.md")])
        .collect()
}

/// Code of a page: lines between fences, and text between two backticks, also across a line end.
fn code(page: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (index, part) in page.split("```").enumerate() {
        if index % 2 == 1 {
            found.extend(part.lines().map(str::to_owned));
        } else {
            found.extend(part.split('`').skip(1).step_by(2).map(str::to_owned));
        }
    }
    found
}

/// The words after the name of the program, as far as they belong to it; the name may be left out before a command with
/// arguments.
fn words<'c>(code: &'c str, program: &Command) -> Option<Vec<&'c str>> {
    let mut words = code.split_whitespace().peekable();
    let own = |word: &&str| program.find_subcommand(word).is_some();
    if !words.peek().is_some_and(own) {
        // `cargo test -p host-sim --test …` is not the program's.
        words
            .by_ref()
            .find(|word| matches!(*word, "host-sim" | "test"))
            .filter(|word| *word == "host-sim")?;
        words.next_if_eq(&"--");
    }
    let ends = |word: &&str| matches!(*word, "#" | "|" | "&&" | ";" | "…");
    Some(words.take_while(|word| !ends(word)).collect())
}

/// Defect of a command line of a page.
fn wrong(words: &[&str], program: &Command) -> Option<String> {
    let mut command = program;
    let mut asked = Vec::new();
    for word in words {
        let word = word.trim_matches(|c| "[]().,;:'\"".contains(c));
        if let Some(option) = word.strip_prefix("--") {
            asked.push(option.split('=').next().unwrap_or_default());
        } else if asked.is_empty() && command.has_subcommands() {
            match command.find_subcommand(word) {
                Some(below) => command = below,
                // `experiment NAME`: any of them.
                None if word.chars().all(|c| c.is_ascii_uppercase()) => return None,
                None => return Some(format!("{} has no command {word}", command.get_name())),
            }
        }
    }
    let known = |option: &&str| {
        ["help", "version", ""].contains(option)
            || command.get_arguments().any(|argument| {
                argument.get_long() == Some(option)
                    || argument
                        .get_all_aliases()
                        .is_some_and(|names| names.contains(option))
            })
    };
    let unknown = asked.into_iter().find(|option| !known(option))?;
    Some(format!("{} has no --{unknown}", command.get_name()))
}

#[test]
fn every_command_of_the_pages_exists_with_its_options() {
    let mut program = CommandLine::command();
    program.build();
    let mut seen = 0;
    for path in pages() {
        let page = fs::read_to_string(&path).expect("it is text");
        for code in code(&page) {
            let Some(words) = words(&code, &program) else {
                continue;
            };
            let wrong = wrong(&words, &program);
            assert_eq!(wrong, None, "{}: `{code}`", path.display());
            seen += 1;
        }
    }
    assert!(seen > 60, "only {seen} commands were found");
}

#[test]
fn a_command_that_is_none_is_noticed() {
    let mut program = CommandLine::command();
    program.build();
    let judged = |code| wrong(&words(code, &program).expect("it is a command"), &program);
    for sound in [
        "cargo run --release -p host-sim -- experiment soak --out DIR      # ten million --ticks",
        "host-sim run --board serial:PORT …",
        "experiment NAME --out DIR",
        "simulate --seed",
    ] {
        assert_eq!(judged(sound), None, "{sound}");
    }
    for (code, named) in [
        ("host-sim frobnicate", "frobnicate"),
        ("experiment learnign --out DIR", "learnign"),
        ("host-sim generate --urdf FILE [--bsae LINK]", "--bsae"),
        ("experiment demo --quick", "--quick"),
    ] {
        assert!(judged(code).expect(code).contains(named), "{code}");
    }
    assert_eq!(words("cargo test -p host-sim --test cli", &program), None);
}
