//! Import circles between the source files of a crate, found in the text of their paths.
//!
//! A path counts for the file that defines its item: `super::X` for the sibling that `X` is re-exported from. The parts of
//! a module, re-exports and tests do not count.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Result, bail};

use crate::words::{files, read};

/// Prints the imports of every circle; fails if there is one.
pub(crate) fn run() -> Result<()> {
    let packages = files("Cargo.toml")?;
    let mut crates = BTreeMap::<String, Vec<(String, String)>>::new();
    for path in files(".rs")? {
        let homes = packages
            .iter()
            .map(|package| package.trim_end_matches("Cargo.toml"));
        let home = homes
            .filter(|home| path.starts_with(home))
            .max_by_key(|home| home.len());
        let Some(inner) = path[home.unwrap_or_default().len()..].strip_prefix("src/") else {
            continue;
        };
        // A directory of `bin` is a crate of its own.
        let bin = inner
            .strip_prefix("bin/")
            .and_then(|inner| inner.split_once('/'));
        let file = bin.map_or(inner, |(_, file)| file);
        if !file.ends_with("tests.rs") && !file.contains("tests/") {
            let text = read(&path)?;
            let home = path.trim_end_matches(file).to_owned();
            let sources = crates.entry(home).or_default();
            sources.push((file.to_owned(), text));
        }
    }
    let mut count = 0;
    for (home, sources) in crates {
        for circle in Crate::new(sources).circles() {
            count += 1;
            println!("circle in {home}");
            for import in circle {
                println!("  {home}{import}");
            }
        }
    }
    if count > 0 {
        bail!("{count} import circles");
    }
    println!("circles: none");
    Ok(())
}

type Path = Vec<String>;

/// A path in the text of a file.
struct Import {
    line: usize,
    path: Path,
    /// Name in the file, `*` for all of a module; nothing if the path is used in place.
    name: Option<String>,
    public: bool,
}

struct Module {
    file: String,
    text: String,
    imports: Vec<Import>,
}

/// The files of a crate by their modules.
struct Crate(BTreeMap<Path, Module>);

impl Crate {
    fn new(files: Vec<(String, String)>) -> Self {
        let modules = files.into_iter().map(|(file, text)| {
            let parts = file.trim_end_matches(".rs").split('/');
            let mut path: Path = parts.map(str::to_owned).collect();
            path.pop_if(|last| matches!(last.as_str(), "mod" | "lib" | "main"));
            let imports = imports(&text);
            let module = Module {
                file,
                text,
                imports,
            };
            (path, module)
        });
        Self(modules.collect())
    }

    /// A path from the root of the crate; nothing if it leaves the crate.
    fn absolute(&self, module: &[String], path: &[String], depth: usize) -> Option<Path> {
        let (first, rest) = path.split_first()?;
        let parent = module.split_last().map(|(_, parent)| parent);
        let start = match first.as_str() {
            "crate" => Path::new(),
            "self" => module.to_vec(),
            "super" if rest.first()? == "super" => return self.absolute(parent?, rest, depth),
            "super" => parent?.to_vec(),
            _ if self.0.contains_key(&[module, &path[..1]].concat()) => {
                [module, &path[..1]].concat()
            }
            name => {
                let mut imports = self.0.get(module)?.imports.iter();
                let import = imports.find(|import| import.name.as_deref() == Some(name))?;
                self.absolute(module, &import.path, depth.checked_sub(1)?)?
            }
        };
        Some([&start, rest].concat())
    }

    /// The module whose file defines the item of an absolute path, and whether the path is that of the module itself.
    fn defining(&self, path: &[String], depth: usize) -> Option<(&Path, bool)> {
        let mut prefixes = (0..=path.len()).rev().map(|length| path.split_at(length));
        let (module, item) = prefixes.find(|(module, _)| self.0.contains_key(*module))?;
        let (path, module) = self.0.get_key_value(module)?;
        let Some(item) = item.first() else {
            return Some((path, true));
        };
        let exports = module
            .imports
            .iter()
            .filter(|import| import.public && depth > 0);
        let mut through = exports.filter_map(|export| {
            let mut target = self.absolute(path, &export.path, 8)?;
            let all = export.name.as_deref() == Some("*");
            if all {
                target.push(item.clone());
            } else if export.name.as_ref() != Some(item) {
                return None;
            }
            let found = self.defining(&target, depth - 1)?;
            (!all || self.0[found.0].declares(item)).then_some(found)
        });
        through.next().or(Some((path, false)))
    }

    /// The imports between the files of each circle.
    fn circles(&self) -> Vec<Vec<String>> {
        let mut edges = BTreeMap::<&Path, BTreeMap<&Path, String>>::new();
        for (path, module) in &self.0 {
            for import in module.imports.iter().filter(|import| !import.public) {
                let absolute = self.absolute(path, &import.path, 8);
                let found = absolute.and_then(|absolute| self.defining(&absolute, 8));
                // A module that is imported by name counts where its items are used.
                let Some((to, whole)) = found else { continue };
                if !to.starts_with(path) && (!whole || import.name.as_deref() == Some("*")) {
                    let (line, item, of) = (import.line, import.path.join("::"), &self.0[to].file);
                    let text = format!("{}:{line}: {item} of {of}", module.file);
                    edges.entry(path).or_default().entry(to).or_insert(text);
                }
            }
        }
        let reach = |from| {
            let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
            while let Some(next) = open.pop() {
                let targets = edges.get(next).into_iter().flat_map(BTreeMap::keys);
                open.extend(targets.filter(|target| reached.insert(**target)));
            }
            reached
        };
        let reached: BTreeMap<_, _> = self.0.keys().map(|path| (path, reach(path))).collect();
        let mut circles = BTreeMap::<Vec<&Path>, Vec<String>>::new();
        for (from, targets) in &edges {
            let members = reached[from]
                .iter()
                .filter(|other| reached[*other].contains(from));
            let members: Vec<&Path> = members.copied().collect();
            let inside = targets.iter().filter(|(to, _)| members.contains(to));
            let inside: Vec<String> = inside.map(|(_, text)| text.clone()).collect();
            if !inside.is_empty() {
                circles.entry(members).or_default().extend(inside);
            }
        }
        circles.into_values().collect()
    }
}

impl Module {
    fn declares(&self, item: &str) -> bool {
        ["struct", "enum", "fn", "const", "static", "type", "trait"]
            .iter()
            .any(|kind| self.text.contains(&format!("{kind} {item}")))
    }
}

/// The paths of a formatted file, tests and comments left out.
fn imports(text: &str) -> Vec<Import> {
    let mut found = Vec::new();
    let mut lines = (1..).zip(text.lines());
    while let Some((line, text)) = lines.next() {
        let code = text.trim_start();
        let indent = text.len() - code.len();
        let tree = code
            .split_once("use ")
            .filter(|(visible, _)| ["", "pub ", "pub(crate) ", "pub(super) "].contains(visible));
        if code == "#[cfg(test)]" {
            if lines.next().is_some_and(|(_, item)| item.ends_with('{')) {
                let end = format!("{:indent$}}}", "");
                let _ = lines.find(|(_, item)| *item == end);
            }
        } else if let Some((visible, tree)) = tree {
            let mut tree = tree.to_owned();
            while !tree.contains(';') {
                tree.push_str(lines.next().map_or(";", |(_, more)| more.trim()));
            }
            let public = !visible.is_empty();
            let paths = expand(tree.trim_end_matches(';'), &[]).into_iter();
            found.extend(paths.map(|(path, name)| Import {
                line,
                path,
                name,
                public,
            }));
        } else if !code.starts_with("//") {
            let words = code.split(|c: char| !c.is_alphanumeric() && c != '_' && c != ':');
            for word in words.filter(|word| word.contains("::") && !word.starts_with(':')) {
                let parts = word.trim_end_matches(':').split("::");
                found.push(Import {
                    line,
                    path: parts.map(str::to_owned).collect(),
                    name: None,
                    public: false,
                });
            }
        }
    }
    found
}

/// The paths of the tree of a `use`, each with its name; `*` is the name of all of a module.
fn expand(tree: &str, prefix: &[String]) -> Vec<(Path, Option<String>)> {
    let join = |path: &str| {
        let names = path.split("::").map(|name| name.trim().to_owned());
        [prefix, &names.collect::<Path>()].concat()
    };
    if let Some((head, inner)) = tree.split_once("::{") {
        let (head, mut depth) = (join(head), 0);
        let inner = inner.rsplit_once('}').map_or(inner, |(inner, _)| inner);
        let parts = inner.split(|c: char| {
            depth += i32::from(c == '{') - i32::from(c == '}');
            c == ',' && depth == 0
        });
        let parts = parts.filter(|part| !part.trim().is_empty());
        return parts.flat_map(|part| expand(part, &head)).collect();
    }
    let (path, alias) = tree.split_once(" as ").unwrap_or((tree, ""));
    let mut path = join(path);
    let last = path.pop_if(|last| matches!(last.as_str(), "*" | "self"));
    let name = match (alias.trim(), last) {
        ("", Some(all)) if all == "*" => Some(all),
        ("", _) => path.last().cloned(),
        (alias, _) => Some(alias.to_owned()),
    };
    vec![(path, name)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circles(files: &[(&str, &str)]) -> Vec<Vec<String>> {
        let files = files
            .iter()
            .map(|(file, text)| ((*file).into(), (*text).into()));
        Crate::new(files.collect()).circles()
    }

    const ROOT: (&str, &str) = (
        "lib.rs",
        "mod a;\nmod b;\npub use a::A;\npub use b::*;\nuse a::f;\n",
    );

    #[test]
    fn a_path_counts_for_the_file_of_its_item() {
        let a = ("a.rs", "use super::{B, c as other};\npub struct A(B);\n");
        let b = ("b.rs", "pub struct B;\nfn b() { crate::A::new() }\n");
        let expected = ["a.rs:1: super::B of b.rs", "b.rs:2: crate::A::new of a.rs"];
        assert_eq!(circles(&[ROOT, a, b]), [expected]);
        let b = (
            "b.rs",
            "pub struct B;\n// crate::A\n#[cfg(test)]\nmod tests {\n    use crate::A;\n}\n",
        );
        assert!(circles(&[ROOT, a, b]).is_empty());
    }

    #[test]
    fn a_module_imported_by_name_counts_where_it_is_used() {
        let a = ("a.rs", "use super::b;\nfn a() { b::b() }\n");
        let b = ("b.rs", "use crate::{\n    a::{self, C},\n};\n");
        let expected = ["a.rs:2: b::b of b.rs", "b.rs:1: crate::a::C of a.rs"];
        assert_eq!(circles(&[ROOT, a, b]), [expected]);
        assert!(circles(&[ROOT, ("a.rs", "use super::b;\n"), b]).is_empty());
    }

    #[test]
    fn a_module_may_use_its_parts() {
        let part = ("a/part.rs", "use super::A;\n");
        assert!(circles(&[ROOT, ("a/mod.rs", "use part::P;\npub struct A;\n"), part]).is_empty());
    }
}
