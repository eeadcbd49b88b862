//! A table of measured figures that a page keeps between two marks.

use super::{Failure, unusable};
use clap::Args;
use foretorque_workbench::files::{at, write_whole};
use std::path::{Path, PathBuf};

/// Where the table is kept, and whether it is renewed or compared.
#[derive(Debug, Args)]
pub(super) struct KeptTable {
    /// Put the table of what was measured between its marks in this file
    #[arg(long = "table", value_name = "FILE")]
    file: Option<PathBuf>,
    /// Compare with the table in that file instead, and fail where a figure differs
    #[arg(long, requires = "file")]
    check: bool,
}

impl KeptTable {
    /// Looks whether the file has the marks of the table `name`, before the work.
    ///
    /// Errors: the file's, or that it has them not.
    pub(super) fn look(&self, name: &str) -> Result<(), Failure> {
        match &self.file {
            Some(file) => with_table(file, name, "").map(drop),
            None => Ok(()),
        }
    }

    /// Writes `table` into the file, or compares it with the one there.
    ///
    /// Errors: the file's, or the first line that differs.
    pub(super) fn keep(&self, name: &str, table: &str) -> Result<(), Failure> {
        let Some(file) = &self.file else {
            return Ok(());
        };
        let (text, renewed) = with_table(file, name, table)?;
        if !self.check {
            return Ok(write_whole(file, renewed.as_bytes())?);
        }
        let mut lines = text.lines().zip(renewed.lines());
        match lines.find(|(kept, new)| kept != new) {
            Some((kept, new)) => Err(unusable(format!(
                "{}: says {kept}, measured {new}",
                file.display()
            ))),
            None => Ok(()),
        }
    }
}

/// The text of the file, and that text with `table` between the marks of the table `name`.
fn with_table(file: &Path, name: &str, table: &str) -> Result<(String, String), Failure> {
    let text = std::fs::read_to_string(file).map_err(|error| at(file, error))?;
    let renewed = renewed(&text, name, table).ok_or_else(|| {
        let (begin, end) = marks(name);
        unusable(format!(
            "{}: has not the two marks {begin} and {end}",
            file.display()
        ))
    })?;
    Ok((text, renewed))
}

/// What stands on the lines before and after the table `name`.
fn marks(name: &str) -> (String, String) {
    (
        format!("<!-- {name} table begins -->"),
        format!("<!-- {name} table ends -->"),
    )
}

/// `text` with `table` between the marks; `None` if it has not both of them.
fn renewed(text: &str, name: &str, table: &str) -> Option<String> {
    let (begin, end) = marks(name);
    let (before, rest) = text.split_once(&begin)?;
    let (_, after) = rest.split_once(&end)?;
    Some(format!("{before}{begin}\n{table}{end}{after}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_put_between_its_marks_and_nowhere_else() {
        let text = "before\n<!-- a table begins -->\nold\n<!-- a table ends -->\nafter\n";
        let new = renewed(text, "a", "| new |\n").expect("has marks");
        assert_eq!(
            new,
            "before\n<!-- a table begins -->\n| new |\n<!-- a table ends -->\nafter\n"
        );
        assert_eq!(renewed(&new, "a", "| new |\n").as_ref(), Some(&new));
        assert_eq!(renewed(text, "b", "| new |\n"), None);
    }

    #[test]
    fn a_figure_that_differs_is_named() {
        let file = std::env::temp_dir().join(format!("foretorque-kept-{}", std::process::id()));
        std::fs::write(
            &file,
            "<!-- a table begins -->\n| 1 |\n<!-- a table ends -->\n",
        )
        .unwrap();
        let kept = KeptTable {
            file: Some(file.clone()),
            check: true,
        };
        assert!(kept.look("a").is_ok() && kept.look("b").is_err());
        assert!(kept.keep("a", "| 1 |\n").is_ok());
        let said = |table| kept.keep("a", table).expect_err("differs").to_string();
        assert!(said("| 2 |\n").contains("says | 1 |, measured | 2 |"));
        assert!(said("| 1 |\n| 2 |\n").contains("measured | 2 |"));
        std::fs::remove_file(&file).unwrap();
    }
}
