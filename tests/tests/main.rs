//! Requirements that hold across the crates of foretorque: test arms beside the shipped ones, tables made by outside tools
//! (compressed CSV, a header row), and the studies in small. One test crate: it links the code that the studies have compiled
//! for the arms.

mod described_arms;
mod dynamics;
mod faults;
mod oracle;
mod pages;
mod studies;

use foretorque_test_arms as arms;

use flate2::read::GzDecoder;
use foretorque::arm::Arm;
use foretorque_workbench::board::{Client, Native};
use foretorque_workbench::robot::Robot;
use std::collections::HashMap;
use std::fs::File;
use std::path::Path;
use std::time::Duration;

/// A table of numbers with named columns.
struct Table {
    columns: HashMap<String, usize>,
    rows: Vec<Vec<f64>>,
}

impl Table {
    /// Reads `tests/data/pinocchio/NAME.csv.gz`.
    ///
    /// Panics with the file's name if it is missing, ragged or not numeric: such a table can test nothing.
    fn pinocchio(name: &str) -> Self {
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

    fn len(&self) -> usize {
        self.rows.len()
    }

    /// One value. Panics if there is no such column or row.
    fn value(&self, row: usize, column: &str) -> f64 {
        let index = self.columns.get(column);
        self.rows[row][*index.unwrap_or_else(|| panic!("no column '{column}'"))]
    }

    /// One value for each of `N` joints, from the columns `PREFIX1SUFFIX`, `PREFIX2SUFFIX`, …
    fn joints<const N: usize>(&self, row: usize, prefix: &str, suffix: &str) -> [f64; N] {
        std::array::from_fn(|joint| self.value(row, &format!("{prefix}{}{suffix}", joint + 1)))
    }
}

/// Calls `check::<Arm, N, P>()`, with arguments if there are any, for the UR5, the Panda and the ten random arms.
macro_rules! each_arm {
    ($check:ident $(, $argument:expr)*) => {
        $check::<foretorque::arm::ur5::Ur5, 6, 40>($($argument),*);
        $check::<foretorque::arm::panda::Panda, 7, 48>($($argument),*);
        $check::<crate::arms::random_1_a::Random1A, 1, 3>($($argument),*);
        $check::<crate::arms::random_1_b::Random1B, 1, 3>($($argument),*);
        $check::<crate::arms::random_2_a::Random2A, 2, 11>($($argument),*);
        $check::<crate::arms::random_2_b::Random2B, 2, 11>($($argument),*);
        $check::<crate::arms::random_4_a::Random4A, 4, 27>($($argument),*);
        $check::<crate::arms::random_4_b::Random4B, 4, 27>($($argument),*);
        $check::<crate::arms::random_6_a::Random6A, 6, 43>($($argument),*);
        $check::<crate::arms::random_6_b::Random6B, 6, 43>($($argument),*);
        $check::<crate::arms::random_7_a::Random7A, 7, 51>($($argument),*);
        $check::<crate::arms::random_7_b::Random7B, 7, 51>($($argument),*);
    };
}
use each_arm;

/// A board of `A` in this process.
fn native<A: Arm<N, P> + 'static, const N: usize, const P: usize>() -> Client<N> {
    let board = Box::new(Native::<A, N, P>::new().expect("boots"));
    Client::connect::<A, P>(board, Duration::from_secs(1)).expect("hello")
}

/// The description of an arm of [`each_arm`], of [`arms::oblique`] or of [`arms::ur5_calibrated`].
///
/// Panics if it cannot be read: without it there is nothing to test.
fn description(name: &str) -> Robot {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/data");
    let loaded = match name {
        "ur5" | "panda" => Robot::load(name),
        "ur5_calibrated" => Robot::load(&format!("{data}/{name}.toml")),
        "oblique" => Robot::load(&format!("{data}/pinocchio/arms/{name}.urdf")),
        _ => Robot::load(&format!("{data}/pinocchio/arms/{name}.toml")),
    };
    loaded.unwrap_or_else(|error| panic!("{error}"))
}
