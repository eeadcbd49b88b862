//! Snapshots: readable files of measured figures, so that a change of a figure is a visible difference.

use crate::files::{at, write_whole};
use std::io;
use std::path::Path;

/// Writes `text` to the snapshot if `accept`, compares them otherwise.
///
/// Errors: the file's; the first line that differs.
pub fn keep(path: &Path, text: &str, accept: bool) -> io::Result<()> {
    if accept {
        return write_whole(path, text.as_bytes());
    }
    let kept = std::fs::read_to_string(path).map_err(|error| at(path, error))?;
    let count = kept.lines().count().max(text.lines().count());
    let lines = |text: &str, line: usize| text.lines().nth(line).unwrap_or_default().to_owned();
    for line in 0..count {
        let (kept, measured) = (lines(&kept, line), lines(text, line));
        if kept != measured {
            let (path, line) = (path.display(), line + 1);
            let problem = format!("{path}:{line}: kept {kept:?}, measured {measured:?}");
            return Err(io::Error::other(problem));
        }
    }
    Ok(())
}

/// A table as lines of text with aligned columns: numbers to the right, words to the left.
///
/// * `header` headings, separated by ` | `
pub fn aligned<R: IntoIterator<Item = String>>(
    header: &str,
    rows: impl IntoIterator<Item = R>,
) -> String {
    let rows = rows.into_iter().map(|row| row.into_iter().collect());
    let rows: Vec<Vec<String>> = rows.collect();
    let header: Vec<String> = header.split(" | ").map(str::to_owned).collect();
    let column = |k: usize| rows.iter().filter_map(move |row| row.get(k));
    let is_number = |text: &String| text == "never" || text.parse::<f64>().is_ok();
    let width = |k: usize| {
        let cells = column(k).chain([&header[k]]);
        let width = cells.map(|cell| cell.chars().count()).max();
        (width.unwrap_or(0), column(k).all(is_number))
    };
    let widths: Vec<(usize, bool)> = (0..header.len()).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths);
        let cells = cells.map(|(cell, &(width, right))| match right {
            true => format!("{cell:>width$}"),
            false => format!("{cell:<width$}"),
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    std::iter::once(&header).chain(&rows).map(line).collect()
}

/// `value` with so many significant digits, at most six of them behind the point; `never` if it is not finite.
pub fn significant(value: f64, digits: i32) -> String {
    if !value.is_finite() {
        return "never".to_owned();
    }
    if value == value.round() && value.abs() < 1e7 {
        return format!("{value:.0}");
    }
    let decimals = (f64::from(digits - 1) - value.abs().log10().floor()).clamp(0.0, 6.0);
    format!("{value:.*}", decimals as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_that_differs_is_named_until_it_is_accepted() {
        let here = tempfile::tempdir().expect("it can be created");
        let path = here.path().join("snapshot");
        keep(&path, "", false).expect_err("no file");
        keep(&path, "a 1\nb 2\n", true).expect("writes");
        keep(&path, "a 1\nb 2\n", false).expect("equal");
        let differs = |text| keep(&path, text, false).expect_err("differs").to_string();
        assert!(differs("a 1\nb 3\n").ends_with(":2: kept \"b 2\", measured \"b 3\""));
        assert!(differs("a 1\n").ends_with(":2: kept \"b 2\", measured \"\""));
        keep(&path, "a 1\n", true).expect("writes");
        keep(&path, "a 1\n", false).expect("equal");
    }

    #[test]
    fn columns_of_numbers_stand_to_the_right() {
        let rows = [["a", "10", "met"], ["longer", "2.5", ""]];
        let rows = rows.map(|row| row.map(str::to_owned));
        let text = "name     n²\na        10  met\nlonger  2.5\n";
        assert_eq!(aligned("name | n² | ", rows), text);
        assert_eq!(significant(0.123_456, 4), "0.1235");
        assert_eq!(significant(1234.0, 3), "1234");
        assert_eq!(significant(f64::NAN, 3), "never");
    }
}
