use super::terminal::show;
use super::{Failure, bail, not_over, text_of, unusable};
use clap::Args;
use foretorque_workbench::files::write_whole;
use foretorque_workbench::report::page::{Page, Section, figure};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Put the figures of two reports side by side
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// First report: report.json, or the directory that holds it
    a: PathBuf,
    /// Second report
    b: PathBuf,
    /// Show figures that are the same, too
    #[arg(long)]
    all: bool,
    /// Write the comparison as a page
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Longest list that is compared value by value: curves are left out.
const LONGEST: usize = 16;

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let files = [&arguments.a, &arguments.b].map(|path| report(path));
    not_over(files, arguments.out.clone())?;
    let (a, b) = (read(&arguments.a)?, read(&arguments.b)?);
    let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    let [one, other] = &[&arguments.a, &arguments.b].map(|path| path.display().to_string());
    // A robot and a seed are in every report.
    let is_figure = |value: &Value| value.is_number();
    let mut common = a
        .iter()
        .filter(|(key, value)| *key != "seed" && is_figure(value));
    if !common.any(|(key, _)| b.get(key).is_some_and(is_figure)) {
        bail!("{one} and {other} have no figure in common");
    }
    let keys = keys.into_iter();
    let shown = keys.filter(|key| arguments.all || a.get(*key) != b.get(*key));
    let rows: Vec<[String; 4]> = shown.map(|key| row(key, a.get(key), b.get(key))).collect();
    let width = rows.iter().map(|row| row[0].len()).max().unwrap_or(0);
    for [key, a, b, ratio] in &rows {
        show!("{key:<width$} {a:>14} {b:>14} {ratio:>10}")?;
    }
    if rows.is_empty() {
        show!("no figure differs")?;
    }
    if let Some(out) = &arguments.out {
        let caption = "Values of both reports, and the second over the first.";
        let section = Section::new("Figures that differ", caption);
        let section = section.table(format!("figure | {one} | {other} | ratio"), rows);
        let page = Page::new(format!("{one} and {other}"), "Two reports side by side.");
        write_whole(out, page.sections([section]).html()?.as_bytes())?;
    }
    Ok(())
}

fn report(path: &Path) -> PathBuf {
    match path.is_dir() {
        true => path.join("report.json"),
        false => path.to_owned(),
    }
}

/// Figures and words of a report by their path in the file.
fn read(path: &Path) -> Result<BTreeMap<String, Value>, Failure> {
    let file = report(path);
    let report: Value = serde_json::from_str(&text_of(&file)?)
        .map_err(|error| unusable(format!("{}: no report: {error}", file.display())))?;
    let mut figures = BTreeMap::new();
    flatten(String::new(), &report, &mut figures);
    Ok(figures)
}

fn flatten(key: String, value: &Value, into: &mut BTreeMap<String, Value>) {
    let below = |name: &str| match key.is_empty() {
        true => name.to_owned(),
        false => format!("{key}.{name}"),
    };
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                flatten(below(name), value, into);
            }
        }
        Value::Array(values) if values.len() <= LONGEST || values.iter().all(Value::is_object) => {
            let mut named: BTreeMap<String, usize> = BTreeMap::new();
            for (number, value) in (1..).zip(values) {
                let name = entry_name(number, value);
                let count = named.entry(name.clone()).or_default();
                *count += 1;
                match count {
                    1 => flatten(below(&name), value, into),
                    count => flatten(below(&format!("{name}#{count}")), value, into),
                }
            }
        }
        // Of a curve every point would be a line.
        Value::Array(_) | Value::Null => {}
        figure => {
            into.insert(key, figure.clone());
        }
    }
}

/// Name of an entry in a list: by what tells it from the others, else its number.
fn entry_name(number: usize, value: &Value) -> String {
    let fields = [
        "name", "path", "arm", "scenario", "seed", "limit", "of", "figure",
    ];
    let named = fields.iter().filter_map(|field| match value.get(field)? {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    });
    match named.collect::<Vec<_>>().join("/") {
        none if none.is_empty() => number.to_string(),
        named => named,
    }
}

/// Key, both values, and the second over the first.
fn row(key: &str, a: Option<&Value>, b: Option<&Value>) -> [String; 4] {
    let shown = |value: Option<&Value>| match value {
        None => "–".to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(value) => match value.as_f64().filter(|_| value.is_f64()) {
            Some(number) => figure(number, 6),
            None => value.to_string(),
        },
    };
    let numbers = a.and_then(Value::as_f64).zip(b.and_then(Value::as_f64));
    let ratio = numbers
        .filter(|(a, _)| *a != 0.0)
        .map_or(String::new(), |(a, b)| format!("× {:.3}", b / a));
    [key.to_owned(), shown(a), shown(b), ratio]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_called_by_their_way_through_the_report() {
        let report = serde_json::json!({
            "rank": 52, "none": null, "curve": vec![0; 40],
            "runs": (0..17).map(|seed| serde_json::json!({"arm": "a", "seed": seed, "error": 0.5})).collect::<Vec<_>>(),
            "methods": {"wls": {"parameters": [{"name": "Ia1", "value": 0.5}], "rmse_nm": [1.0, null]}},
            "twice": [{"name": "flips", "lost": 1}, {"name": "flips", "lost": 2}],
        });
        let mut figures = BTreeMap::new();
        flatten(String::new(), &report, &mut figures);
        assert_eq!(figures.get("runs.a/16.error"), Some(&0.5.into()));
        figures.retain(|key, _| !key.starts_with("runs"));
        let lost = ["twice.flips.lost", "twice.flips#2.lost"].map(|key| figures.get(key).cloned());
        assert_eq!(lost, [Some(1.into()), Some(2.into())]);
        figures.retain(|key, _| !key.starts_with("twice"));
        let keys: Vec<&str> = figures.keys().map(String::as_str).collect();
        let expected = [
            "methods.wls.parameters.Ia1.name",
            "methods.wls.parameters.Ia1.value",
            "methods.wls.rmse_nm.1",
            "rank",
        ];
        assert_eq!(keys, expected);
        let found = row("x", Some(&2.0.into()), Some(&3.0.into()));
        assert_eq!(found, ["x", "2.000000", "3.000000", "× 1.500"]);
    }
}
