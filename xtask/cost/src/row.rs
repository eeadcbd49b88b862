//! The measured rows: two runs of one ELF, counted and traced, that must agree call by call.

use std::path::Path;

use anyhow::{Context as _, Result, ensure};

use crate::emulator::{self, Counts, Spread};
use crate::firmware;
use crate::image::Image;
use crate::trace::Call;

/// Calls of each row that are counted, and that are traced: enough for the turn of every joint.
const COUNTED: u32 = 96;
const TRACED: u32 = 13;

/// One measured row.
pub(crate) struct Row {
    pub(crate) name: String,
    /// Mean over the counted calls.
    pub(crate) instructions: f64,
    /// Most in any counted call.
    pub(crate) worst: u32,
    /// Estimated cycles at zero wait states, mean.
    pub(crate) cycles: f64,
    /// Most estimated cycles in any traced call.
    pub(crate) worst_cycles: u64,
    /// Bound of the stack below the caller's, from the code.
    pub(crate) stack_bytes: u32,
    /// Deepest stack in a traced call.
    pub(crate) stack_seen: u32,
}

impl Row {
    /// Names of instructions and cycles in the budget.
    pub(crate) fn quantities(&self) -> [String; 2] {
        ["instructions", "est. cycles"].map(|unit| format!("{}, {unit}", self.name))
    }

    fn new(image: &Image, counts: &Counts, calls: &[Call], bracket: u32) -> Result<Self> {
        let name = &counts.name;
        let counted = counts.calls.iter();
        let counted: Vec<u32> = counted.map(|n| n.saturating_sub(bracket)).collect();
        ensure!(
            calls.len() == TRACED as usize,
            "`{name}` was traced {} times",
            calls.len()
        );
        for (number, (counted, traced)) in counted.iter().zip(calls).enumerate() {
            ensure!(
                *counted == traced.instructions,
                "call {number} of `{name}`: {counted} instructions counted and {} traced",
                traced.instructions
            );
        }
        let function = image.function(&format!("rows::{name}"));
        let function = function.context("a row without a function")?;
        let stack_bytes = firmware::bounded_depth(image, function.code.start)?.bytes;
        let stack_seen = calls.iter().map(|call| call.stack_bytes).max().unwrap_or(0);
        ensure!(
            stack_seen <= stack_bytes,
            "`{name}` was seen {stack_seen} B deep, beyond its bound of {stack_bytes} B: the walk is wrong"
        );
        // The budget's means leave the first call out.
        let steady = calls.get(1..).unwrap_or_default();
        let cycles: u64 = steady.iter().map(|call| call.cycles).sum();
        let sum: f64 = counted.iter().map(|&n| f64::from(n)).sum();
        Ok(Self {
            name: name.clone(),
            instructions: sum / counted.len().max(1) as f64,
            worst: counted.iter().copied().max().unwrap_or(0),
            cycles: cycles as f64 / steady.len().max(1) as f64,
            worst_cycles: calls.iter().map(|call| call.cycles).max().unwrap_or(0),
            stack_bytes,
            stack_seen,
        })
    }
}

/// Counts and traces every row, compares both runs, and counts the long run.
pub(crate) fn measure(path: &Path) -> Result<(Vec<Row>, Spread)> {
    let image = Image::read(path)?;
    let (counts, spread) = emulator::count(path, COUNTED)?;
    let traces = emulator::trace(path, &image, TRACED, &counts)?;
    let mut pairs = counts.iter().zip(&traces);
    // The first row returns at once: its count beyond its own instructions is the bracket.
    let (empty, own) = pairs.next().context("the bench program has no rows")?;
    let own = own.first().context("the first row was not traced")?;
    let most = empty.calls.iter().copied().max().unwrap_or(0);
    let bracket = most.saturating_sub(own.instructions);
    let rows = pairs.map(|(counts, calls)| Row::new(&image, counts, calls, bracket));
    Ok((rows.collect::<Result<_>>()?, spread.without(bracket)))
}
