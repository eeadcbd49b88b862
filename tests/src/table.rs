//! Tables made by outside tools: compressed CSV, a header row, numbers.

use flate2::read::GzDecoder;
use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A table of numbers with named columns.
pub struct Table {
    columns: HashMap<String, usize>,
    rows: Vec<Vec<f64>>,
}

impl Table {
    /// Reads `tests/data/pinocchio/NAME.csv.gz`.
    ///
    /// Panics with the file's name when it is missing, ragged or not numeric: such a table can judge nothing.
    pub fn pinocchio(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/pinocchio");
        let path = folder.join(format!("{name}.csv.gz"));
        let file = File::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut text = String::new();
        let read = GzDecoder::new(file).read_to_string(&mut text);
        read.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut lines = text.lines();
        let header = lines.next().unwrap_or_default().split(',');
        let columns: HashMap<String, usize> = header
            .enumerate()
            .map(|(index, name)| (name.to_owned(), index))
            .collect();
        let number = |cell: &str| -> f64 {
            cell.parse()
                .unwrap_or_else(|_| panic!("{}: not a number: '{cell}'", path.display()))
        };
        let rows: Vec<Vec<f64>> = lines
            .map(|line| line.split(',').map(number).collect())
            .collect();
        assert!(
            rows.iter().all(|row| row.len() == columns.len()),
            "{}: ragged",
            path.display()
        );
        Self { columns, rows }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// The table has no rows.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// One value.
    ///
    /// Panics when there is no such column or row.
    pub fn value(&self, row: usize, column: &str) -> f64 {
        let index = self
            .columns
            .get(column)
            .unwrap_or_else(|| panic!("no column '{column}'"));
        self.rows[row][*index]
    }

    /// One value for each of `N` joints, from the columns `PREFIX1SUFFIX`, `PREFIX2SUFFIX`, …
    pub fn joints<const N: usize>(&self, row: usize, prefix: &str, suffix: &str) -> [f64; N] {
        std::array::from_fn(|joint| self.value(row, &format!("{prefix}{}{suffix}", joint + 1)))
    }
}
