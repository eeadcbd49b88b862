//! Requirements that hold across the crates of foretorque, and tables made by outside tools: compressed CSV, a header row.

pub mod arms;

use flate2::read::GzDecoder;
use std::collections::HashMap;
use std::fs::File;
use std::path::Path;

/// A table of numbers with named columns.
pub struct Table {
    columns: HashMap<String, usize>,
    rows: Vec<Vec<f64>>,
}

impl Table {
    /// Reads `tests/data/pinocchio/NAME.csv.gz`.
    ///
    /// Panics with the file's name if it is missing, ragged or not numeric: such a table can test nothing.
    pub fn pinocchio(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/pinocchio");
        let path = folder.join(format!("{name}.csv.gz"));
        Self::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    fn read(path: &Path) -> csv::Result<Self> {
        let mut reader = csv::Reader::from_reader(GzDecoder::new(File::open(path)?));
        let columns = reader.headers()?.iter().map(str::to_owned);
        Ok(Self {
            columns: columns.zip(0..).collect(),
            rows: reader.deserialize().collect::<csv::Result<_>>()?,
        })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// The table has no rows.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// One value. Panics if there is no such column or row.
    pub fn value(&self, row: usize, column: &str) -> f64 {
        let index = self.columns.get(column);
        self.rows[row][*index.unwrap_or_else(|| panic!("no column '{column}'"))]
    }

    /// One value for each of `N` joints, from the columns `PREFIX1SUFFIX`, `PREFIX2SUFFIX`, …
    pub fn joints<const N: usize>(&self, row: usize, prefix: &str, suffix: &str) -> [f64; N] {
        std::array::from_fn(|joint| self.value(row, &format!("{prefix}{}{suffix}", joint + 1)))
    }
}
