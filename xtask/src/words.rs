//! The rule for words, as far as a program can check it: first lines of doc comments, and lengths of sentences.

use std::fs;

use anyhow::{Context as _, Result, bail};

use crate::shell::root;

/// Beginnings of a doc comment that name no quantity.
const BEGINNINGS: &str = "What,When,How far,How often,How many,The same";

/// Bounds of README.md: words in all, words of a mean sentence.
const README_WORDS: usize = 600;
const README_MEAN: f64 = 18.0;

/// Bound of a page in docs/: words of a mean sentence.
const PAGE_MEAN: f64 = 20.0;

/// Prints one line for each place that breaks the rule; fails if there is one.
pub(crate) fn run() -> Result<()> {
    let mut broken = Vec::new();
    for path in files(".rs")? {
        for (line, first) in bad_first_lines(&read(&path)?) {
            let line = format!("{path}:{line}: a doc comment begins with `{first}`");
            broken.push(line);
        }
    }
    let readme = read("README.md")?;
    let words = readme.split_whitespace().count();
    if words > README_WORDS {
        let line = format!("README.md:1: {words} words, at most {README_WORDS}");
        broken.push(line);
    }
    broken.extend(too_long("README.md", &readme, README_MEAN));
    let pages = files(".md")?;
    for path in pages.iter().filter(|path| path.starts_with("docs/")) {
        broken.extend(too_long(path, &read(path)?, PAGE_MEAN));
    }
    for line in &broken {
        println!("{line}");
    }
    if !broken.is_empty() {
        bail!("the rule for words is broken in {} places", broken.len());
    }
    println!("words: the rule is kept");
    Ok(())
}

/// Sorted paths of the files whose names end in `end`, from the workspace's root; build and hidden directories are left out.
pub(crate) fn files(end: &str) -> Result<Vec<String>> {
    let (mut found, mut open) = (Vec::new(), vec![String::new()]);
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(root().join(&directory))? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let (path, kind) = (format!("{directory}{name}"), entry.file_type()?);
            if kind.is_dir() && name != "target" && !name.starts_with('.') {
                open.push(path + "/");
            } else if kind.is_file() && name.ends_with(end) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

/// Text of a file, given from the workspace's root.
pub(crate) fn read(path: &str) -> Result<String> {
    fs::read_to_string(root().join(path)).with_context(|| format!("cannot read {path}"))
}

/// Number and beginning of every first line of a doc comment that names no quantity.
fn bad_first_lines(text: &str) -> Vec<(usize, &'static str)> {
    let mut found = Vec::new();
    let mut inside = false;
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim_start();
        let doc = line.strip_prefix("///").or(line.strip_prefix("//!"));
        if let (Some(doc), false) = (doc, inside) {
            let doc = doc.trim_start();
            let begins = |words: &&str| {
                let rest = doc.strip_prefix(*words);
                rest.is_some_and(|rest| !rest.starts_with(char::is_alphanumeric))
            };
            let words = BEGINNINGS.split(',').find(begins);
            found.extend(words.map(|words| (number, words)));
        }
        inside = doc.is_some();
    }
    found
}

/// A page whose mean sentence is longer than `limit`, with the line of its longest sentence.
fn too_long(path: &str, text: &str, limit: f64) -> Option<String> {
    let sentences = sentences(text);
    let words: usize = sentences.iter().map(|(_, words)| words).sum();
    let mean = words as f64 / sentences.len().max(1) as f64;
    let (line, longest) = sentences.iter().max_by_key(|(_, words)| words)?;
    (mean > limit).then(|| {
        format!(
            "{path}:{line}: {mean:.1} words in the mean sentence, at most {limit}; the longest begins here, {longest} words"
        )
    })
}

/// Line and words of every sentence of a page. Headings, tables, code blocks and comments are left out; an item of a list
/// ends a sentence.
fn sentences(text: &str) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    // The sentence being read.
    let mut open: Option<(usize, usize)> = None;
    let (mut code, mut comment) = (false, false);
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        let fence = line.starts_with("```");
        code ^= fence;
        comment |= line.starts_with("<!--");
        let skipped = code || fence || comment || line.starts_with(['#', '|', '<']);
        comment &= !line.contains("-->");
        let item = line.starts_with(['-', '*', '>']) || numbered(line);
        if skipped || item || line.is_empty() {
            found.extend(open.take());
        }
        if skipped {
            continue;
        }
        let prose = without_links(line);
        let words: Vec<&str> = prose.split_whitespace().collect();
        for (place, word) in words.iter().enumerate() {
            if !word.contains(char::is_alphanumeric) || place == 0 && numbered(line) {
                continue;
            }
            let (start, count) = open.unwrap_or((number, 0));
            open = Some((start, count + 1));
            if ends(word, words.get(place + 1)) {
                found.extend(open.take());
            }
        }
    }
    found.extend(open);
    found
}

/// The line is an item such as `1. First`.
fn numbered(line: &str) -> bool {
    let rest = line.trim_start_matches(|c: char| c.is_ascii_digit());
    rest.len() < line.len() && rest.starts_with(". ")
}

/// Whether `word` ends a sentence: a full stop that is no abbreviation's and is not followed by a small letter.
fn ends(word: &str, next: Option<&&str>) -> bool {
    const ABBREVIATIONS: [&str; 7] = ["e.g.", "i.e.", "eq.", "Eq.", "fig.", "Fig.", "vs."];
    let bare = word.trim_end_matches([')', '*', '_', '"', '`', '”', ']']);
    let small = next.is_some_and(|next| next.starts_with(char::is_lowercase));
    let word = bare.trim_start_matches(['(', '*', '"', '[']);
    bare.ends_with(['.', '!', '?']) && !small && !ABBREVIATIONS.contains(&word)
}

/// The line with the text of its links alone, without pictures, and with code in backticks as one word.
fn without_links(line: &str) -> String {
    let mut prose = String::new();
    let mut code = false;
    let mut rest = line;
    while let Some(c) = rest.chars().next() {
        // The target of a link, or a picture.
        let inside = rest.strip_prefix("](").or(rest.strip_prefix("!["));
        if let (false, Some(inside)) = (code, inside) {
            rest = inside.split_once(')').map_or("", |(_, behind)| behind);
            continue;
        }
        code ^= c == '`';
        match c {
            '[' if !code => {}
            ' ' if code => prose.push('_'),
            c => prose.push(c),
        }
        rest = &rest[c.len_utf8()..];
    }
    prose
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_of_a_doc_comment_names_a_quantity() {
        let text = "//! What it is.\n\n/// Torque, N·m.\n/// What follows is no first line.\nfn a();\n    /// How far it is.\nfn b();\n\
                    // What a plain comment names.\nfn c();\n/// The same of b.\nfn d();\n/// Whatever.\n";
        assert_eq!(
            bad_first_lines(text),
            [(1, "What"), (6, "How far"), (10, "The same")]
        );
    }

    #[test]
    fn sentences_are_counted_in_prose_alone() {
        let text = "# A heading of four words\n\nOne two\nthree. Four, e.g. five (see eq. 17) at 0.5 N·m.\n\n\
                    - an item without a stop\n- [one](a_b.md) `two words` ![no word](x.svg)\n\n\
                    | a | table. |\n\n```sh\ncode. Code.\n```\n1. First item. Second sentence!\n\
                    <!-- a comment\nof two lines. -->\nLast";
        let expected = [(3, 3), (4, 9), (6, 5), (7, 2), (14, 2), (14, 2), (17, 1)];
        assert_eq!(sentences(text), expected);
        let page = "Two words. Four words are here.";
        assert_eq!(too_long("a.md", page, 3.0), None);
        let line = too_long("a.md", page, 2.5).unwrap();
        assert!(line.starts_with("a.md:1: 3.0 words"), "{line}");
    }
}
