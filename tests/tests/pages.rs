//! Targets of README.md, CHANGELOG.md, CONTRIBUTING.md and of the pages of docs/ exist: files, headings, tests.

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Every page with its text, the licences of others apart.
fn pages() -> Vec<(PathBuf, String)> {
    let docs = fs::read_dir(root().join("docs")).expect("it is there");
    let docs = docs.map(|entry| entry.expect("it is there").path());
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).expect("it is text");
        (path, text)
    };
    docs.filter(|path| path.extension().is_some_and(|end| end == "md"))
        .chain(["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(|name| root().join(name)))
        .map(read)
        .collect()
}

/// Name of a heading in a link.
fn anchor(heading: &str) -> String {
    let kept = heading
        .trim_start_matches('#')
        .trim()
        .chars()
        .filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    let name: String = kept.flat_map(char::to_lowercase).collect();
    name.replace(' ', "-")
}

#[test]
fn every_link_leads_to_a_file_and_its_heading() {
    let mut seen = 0;
    for (path, text) in pages() {
        for part in text.split("](").skip(1) {
            let target = part.split(')').next().unwrap_or_default();
            if target.starts_with("http") {
                continue;
            }
            let (file, heading) = target.split_once('#').unwrap_or((target, ""));
            let page = match file {
                "" => path.clone(),
                file => path.with_file_name(file),
            };
            assert!(page.exists(), "{}: {target}", path.display());
            if !heading.is_empty() {
                let text = fs::read_to_string(&page).expect("a page");
                let mut headings = text.lines().filter(|line| line.starts_with('#'));
                let found = headings.any(|line| anchor(line) == heading);
                assert!(found, "{}: {target}", path.display());
            }
            seen += 1;
        }
    }
    assert!(seen > 20, "only {seen} links were found");
}

#[test]
fn every_file_of_the_tree_that_a_page_names_is_there() {
    let mut seen = 0;
    for (path, text) in pages() {
        for name in text.split('`').skip(1).step_by(2) {
            let tree = ["firmware/", "host-sim/", "tests/", "xtask/", "docs/"];
            let plain = !name.contains(|c: char| " *{<…".contains(c));
            if plain && name.contains('.') && tree.iter().any(|top| name.starts_with(top)) {
                assert!(root().join(name).exists(), "{}: {name}", path.display());
                seen += 1;
            }
        }
    }
    assert!(seen > 10, "only {seen} files were found");
}

#[test]
fn every_test_that_a_page_names_is_there() {
    let mut seen = 0;
    for (path, text) in pages() {
        for command in text.split("cargo test -p ").skip(1) {
            // `PACKAGE --test NAME`, or `PACKAGE NAME` where one test crate holds all files.
            let command = command.split(['`', '\n']).next().unwrap_or_default();
            let mut words = command.split_whitespace();
            let package = words.next().unwrap_or_default();
            let name = words.find(|word| *word != "--test").unwrap_or_default();
            let directory = match package {
                "foretorque-capi" => "firmware/capi/tests",
                "foretorque-workbench" => "host-sim/workbench/tests",
                "host-sim" => "host-sim/tests",
                _ => "tests/tests",
            };
            if name.is_empty() || name.starts_with("--") {
                continue;
            }
            let name = name.trim_matches(|c: char| !c.is_alphanumeric() && c != '_');
            let place = root().join(directory).join(name);
            let there = place.with_extension("rs").exists() || place.join("main.rs").exists();
            assert!(there, "{}: {}", path.display(), place.display());
            seen += 1;
        }
    }
    assert!(seen > 5, "only {seen} tests were found");
}
